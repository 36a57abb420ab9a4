"""The mechanics as scalar code that numba compiles, from a tooth's pose to the torsion of the whole mesh.

Modules, in the order in which a moment is solved: ``mesh_data`` numbers of a mesh · ``poses`` of teeth near
both lobes · ``contact`` of a flank with the slot's wall, in closed form · ``load_sharing`` one torsion for
all teeth · ``sensitivity`` derivatives of the torsion · ``interpolation`` in a torsion map · ``entry`` what
Python calls, for many moments at once. A ``formula`` also runs on arrays unchanged.

``entry`` imports numba, which takes 0.3 s, at the first computation. The machine code is cached on disk,
because compiling takes half a minute.
"""

from __future__ import annotations

import importlib
from types import ModuleType

STEPS = 32767
"""Steps from zero to the greatest number in the table of a torsion map."""


def __getattr__(name: str) -> ModuleType:
    """Import ``entry`` when it is first used; from then on it is an attribute like any other."""
    if name != "entry":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module(f"{__name__}.entry")
