"""Versions that decide the last bits of the outputs."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib import metadata

import numpy as np
import scipy

import hd_diag

Versions = Mapping[str, str | None]


def running() -> Versions:
    """Versions of this package and of the software that it computes with."""
    return {
        "hd_diag": hd_diag.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "numba": metadata.version("numba"),
    }


def differences(recorded: Versions) -> str:
    """Text on the recorded versions that differ from the running ones; empty if none differs."""
    here = running()
    return ", ".join(
        f"{name} {version or 'absent'} (here {here[name] or 'absent'})"
        for name, version in recorded.items()
        if name in here and here[name] != version
    )
