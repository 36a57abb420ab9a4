"""Examples that are no part of the package: installed under share/hd_diag, or beside it in its sources."""

from __future__ import annotations

import os
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import hd_diag
from hd_diag.cli.options import Problem


def example_path(name: str) -> Path:
    """File or folder of an example; a Problem where it was not installed with the package."""
    package = Path(hd_diag.__file__).parent
    prefixes = [*package.parents, *map(Path, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))]
    places = [package.parent / "examples", *(prefix / "share/hd_diag/examples" for prefix in prefixes)]
    for place in places:
        if (place / name).exists():
            return place / name
    raise Problem(f"examples/{name} is not installed: looked beside {package} and in share/hd_diag/examples")


def load_example(name: str) -> ModuleType:
    """The module that a file among the examples defines."""
    path = example_path(f"{name}.py")
    spec = spec_from_file_location(f"hd_diag_examples.{name}", path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
