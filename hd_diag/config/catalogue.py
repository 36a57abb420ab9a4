"""The catalogue of effects in use: the package's own, those of installed packages, and those of files."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from hd_diag.config.parameters import ConfigError, shown
from hd_diag.effects import CATALOGUE, Catalogue
from hd_diag.effects.effect import Effect

GROUP = "hd_diag.effects"
"""Group of entry points of installed packages; each gives one effect or several."""


def load(files: Sequence[str | Path] = ()) -> Catalogue:
    """Effects of the package, then those of entry points, then those of files.

    Files are Python modules that define EFFECT, or several effects as EFFECTS. Raises ConfigError naming the
    file or package whose effects cannot be used, and the reason.
    """
    found = _installed()
    for path in map(Path, files):
        found = _with(found, str(path), partial(_of_file, path))
    return found


@cache
def _installed() -> Catalogue:
    found = CATALOGUE
    for entry in entry_points(group=GROUP):
        package = entry.dist.name if entry.dist else "installed package"
        found = _with(found, f"{package}: {entry.name}", entry.load)
    return found


def _of_file(path: Path) -> Any:
    name = f"{GROUP}.given.{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{path}: no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look there for the names in their annotations
    try:
        spec.loader.exec_module(module)
    except Exception:
        del sys.modules[name]
        raise
    found = getattr(module, "EFFECTS", getattr(module, "EFFECT", None))
    if found is None:
        raise ConfigError(f"{path}: defines neither EFFECT nor EFFECTS")
    return found


def _with(catalogue: Catalogue, where: str, source: Callable[[], Any]) -> Catalogue:
    """The catalogue extended by one effect or several that `source` gives."""
    try:
        given = source()
    except ConfigError:
        raise
    except Exception as error:  # foreign files and packages may raise anything
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise ConfigError(f"{where}: cannot be loaded: {reason}") from error
    for effect in given if isinstance(given, (list, tuple)) else (given,):
        if not isinstance(effect, Effect):
            raise ConfigError(f"{where}: expected an effect, not {shown(effect)}")
        if effect.name in (one.name for one in catalogue):
            raise ConfigError(f"{where}: the catalogue has an effect '{effect.name}' already")
        catalogue = (*catalogue, effect)
    return catalogue
