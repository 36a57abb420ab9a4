"""The mechanics as scalar code that numba compiles, from a tooth's pose to the torsion of the whole mesh.

In the order in which a moment is solved: ``mesh_data`` numbers of a mesh · ``poses`` of the teeth near both
lobes · ``contact`` of a flank with the slot's wall, in closed form · ``load_sharing`` one torsion for all
teeth · ``sensitivity`` derivatives of the torsion · ``interpolation`` in a torsion map · ``entry`` what
Python calls, for many moments at once. What is a ``formula`` also runs on arrays as it stands.

numba is imported with ``entry``, when something is first computed: 0.3 s. The machine code is kept on disk,
for compiling it takes half a minute.
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
