"""The catalogue of effects: effects.md."""

from __future__ import annotations

from hd_diag.config.model_file import REFITTED
from hd_diag.effects import CATALOGUE
from hd_diag.effects.effect import Effect
from hd_diag.effects.quantity import Quantity
from parts import plain, table

LINKED = {effect.name for effect in CATALOGUE}


def refitted() -> str:
    """Names of the parameters that are refitted before any effect is looked for."""
    return f"Refitted first: {', '.join(f'`{name}`' for name in REFITTED)}."


def effects() -> str:
    """A table of all effects, then a section for each."""
    rows = [[link(one.name), one.kind, one.frame, plain(", ".join(one.needs))] for one in CATALOGUE]
    return "\n\n".join([table(["effect", "kind", "fixed to", "needs"], rows), *map(_section, CATALOGUE)])


def _section(effect: Effect) -> str:
    quantities = table(["parameter", "unit", "from, to", "meaning"], [_row(q) for q in effect.quantities])
    never = ", ".join(map(link, effect.always_confused))
    paragraphs = [
        f"## {plain(effect.name)}",
        plain(effect.cause),
        f"Adds: {plain(formula(effect))}",
        quantities,
        f"**Inspect.** {plain(effect.inspect)}",
        f"**Confused with** {', '.join(map(link, effect.confused_with))} in poor records.",
        f"**Never distinguished from** {never}." if never else "",
        f"Source: {plain(effect.source)}.",
    ]
    return "\n\n".join(filter(None, paragraphs))


def _row(quantity: Quantity) -> list[str]:
    limits = f"{quantity.low:.4g} to {quantity.high:.4g}"
    return [f"`{quantity.name}`", quantity.unit, limits, plain(quantity.meaning)]


def formula(effect: Effect) -> str:
    """An effect's part of the transmission error; the docstring of its class if the effect has no formula."""
    return " ".join((effect.formula or type(effect).__doc__ or "").split())


def link(name: str) -> str:
    """Markdown of a name, linked if it is in the catalogue."""
    return f"[`{name}`](#{name})" if name in LINKED else f"`{name}`"
