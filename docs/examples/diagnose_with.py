"""Diagnose a bag with one effect more than the catalogue has.

python docs/examples/diagnose_with.py EFFECT.py BAG
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import hd_diag.effects


def effect_of(path: str | Path) -> hd_diag.effects.Effect:
    """The effect that a file defines."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module.EFFECT


if __name__ == "__main__":
    # Before anything else imports the catalogue.
    hd_diag.effects.CATALOGUE += (effect_of(sys.argv[1]),)
    from hd_diag.cli import main

    sys.argv[1:] = ["diagnose", sys.argv[2]]
    main()
