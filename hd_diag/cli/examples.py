"""Files outside the package: installed under share/hd_diag, or next to it in the sources."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import hd_diag
from hd_diag.cli.targets import Problem


def load_example(name: str) -> ModuleType:
    """A module among the examples, such as ``demo.run``; a Problem if they are not installed."""
    file = Path(*name.split(".")).with_suffix(".py")
    place = installed("examples", str(file))
    sys.path.insert(0, str(place.parents[len(file.parts) - 1]))
    return import_module(name)


def installed(folder: str, file: str) -> Path:
    """A file of a folder; a Problem if it is not installed."""
    package = Path(hd_diag.__file__).parent
    prefixes = [*package.parents, *map(Path, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))]
    places = [package.parent / folder, *(prefix / "share/hd_diag" / folder for prefix in prefixes)]
    for place in places:
        if (place / file).exists():
            return place / file
    raise Problem(f"{folder}/{file} is not installed: looked beside {package} and in share/hd_diag/{folder}")
