"""Versions on which the last bits of the outputs depend."""

from __future__ import annotations

import functools
import platform
from collections.abc import Mapping

import numpy as np
import scipy

import hd_diag
from hd_diag.model import compiled

Versions = Mapping[str, str | None]


def running() -> Versions:
    """Versions of this package and of what it computes with; None for numba where it is not used."""
    return {
        "hd_diag": hd_diag.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "numba": _numba() if compiled.available() else None,
    }


def differences(recorded: Versions) -> str:
    """Which of the recorded versions are not the running ones, as text; empty where none differs."""
    here = running()
    return ", ".join(
        f"{name} {version or 'absent'} (here {here[name] or 'absent'})"
        for name, version in recorded.items()
        if name in here and here[name] != version
    )


@functools.cache
def _numba() -> str:
    import numba

    return str(numba.__version__)
