"""The catalogue of effects, for people."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hd_diag.config.model_file import REFITTED
from hd_diag.effects import CATALOGUE
from hd_diag.effects.effect import Effect
from hd_diag.effects.quantity import Quantity

LINKED = {effect.name for effect in CATALOGUE}


def content(folder: Path) -> dict[str, Any]:
    """What effects.md is filled with."""
    return {"catalogue": CATALOGUE, "formula": formula, "limits": limits, "link": link, "refitted": REFITTED}


def formula(effect: Effect) -> str:
    """What it adds to the transmission error: where it does not say it, its class does."""
    return " ".join((effect.formula or type(effect).__doc__ or "").split())


def limits(quantity: Quantity) -> str:
    """Values that make sense."""
    return f"{quantity.low:.4g} to {quantity.high:.4g}"


def link(name: str) -> str:
    """Markdown of a name, linked where the catalogue has it."""
    return f"[`{name}`](#{name})" if name in LINKED else f"`{name}`"
