"""How plausible sizes scale with the gear: lengths with its module, torques with its rated torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from hd_diag.drive import Drive
from hd_diag.effects.effect import Effect
from hd_diag.effects.quantity import Quantity

# The gear of size 25 and ratio 100 for which limits and usual sizes are stated:
_MODULE = (0.0302584 + 0.0297404) / 200.0  # sum of the neutral curve's semi-axes over teeth [m]
_RATED_TORQUE = 56.0  # [N m]


def unit_scales(drive: Drive) -> Mapping[str, float]:
    """Factors by unit that scale sizes to a drive: 1 for a gear of size 25, ratio 100 and 56 N m.

    Angles are not scaled: at the rated torque gears of all sizes have nearly the same torsion.
    """
    geometry = drive.mesh.geometry
    return {
        "m": (geometry.semi_major + geometry.semi_minor) / geometry.flexspline_teeth / _MODULE,
        "N m": drive.rated_torque / _RATED_TORQUE,
        "rad/(N m)": _RATED_TORQUE / drive.rated_torque,
    }


def of_drive(effects: Sequence[Effect], drive: Drive) -> tuple[Effect, ...]:
    """Effects with limits and usual sizes scaled to a drive."""
    scales = unit_scales(drive)
    return tuple(
        replace(
            effect, quantities=tuple(_scaled(one, scales.get(one.unit, 1.0)) for one in effect.quantities)
        )
        for effect in effects
    )


def _scaled(one: Quantity, scale: float) -> Quantity:
    names = ("low", "high", "prior_scale", "least", "most")
    return replace(one, **{name: scale * getattr(one, name) for name in names})
