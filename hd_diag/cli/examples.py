"""Examples that are no part of the package: installed under share/hd_diag, or beside it in its sources."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import hd_diag
from hd_diag.cli.targets import Problem


def load_example(name: str) -> ModuleType:
    """A module among the examples, such as ``demo.run``; a Problem where they were not installed."""
    package, file = Path(hd_diag.__file__).parent, Path(*name.split(".")).with_suffix(".py")
    prefixes = [*package.parents, *map(Path, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))]
    places = [package.parent / "examples", *(prefix / "share/hd_diag/examples" for prefix in prefixes)]
    for place in places:
        if (place / file).exists():
            sys.path.insert(0, str(place))
            return import_module(name)
    raise Problem(f"examples/{file} is not installed: looked beside {package} and in share/hd_diag/examples")
