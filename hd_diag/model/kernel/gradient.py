"""Derivatives of the torsion by every parameter of the mesh."""

from __future__ import annotations

import math
from typing import NamedTuple

from hd_diag.arrays import Floats
from hd_diag.model.kernel import inline, part
from hd_diag.model.kernel.load import Flanks, Side
from hd_diag.model.kernel.teeth import MeshData, Teeth
from hd_diag.model.kernel.touch import Constants, close


class Slopes(NamedTuple):
    """What one flank adds to K d beta by its tooth's height, offset and lead, and by the datum radius."""

    height: float
    offset: float
    lead: float
    datum: float


@inline
def slopes(c: Constants, height: float, offset: float, side: float, weight: float, release: float) -> Slopes:
    """``weight`` times db/dp, less ``release`` times the change of half the squared lever arm."""
    touch = close(c, height, side * offset)
    lever = touch.x * touch.normal_y - touch.y * touch.normal_x
    sine, cosine = touch.sine, math.sqrt(1.0 - touch.sine * touch.sine)
    # b falls as the tooth moves along the normal: envelope theorem, the contact's own motion does not count.
    along = -(touch.normal_x * cosine + touch.normal_y * sine) / lever
    across = -(touch.normal_y * cosine - touch.normal_x * sine) / lever
    return Slopes(
        side * (weight * along - release * touch.lever_height),
        weight * across - release * touch.lever_offset,
        -weight,
        side * (weight * touch.datum / lever - release * touch.lever_datum),
    )


@inline
def along(teeth: Teeth, i: int, slopes: Slopes) -> tuple[float, float]:
    """By the eccentricity in the wave generator's frame."""
    x = slopes.height * teeth.cosine[i] - slopes.offset * teeth.sine[i]
    return x, slopes.height * teeth.sine[i] + slopes.offset * teeth.cosine[i]


@part
def _add_tooth(c: Constants, teeth: Teeth, i: int, slopes: Slopes, center: complex, gradient: Floats) -> None:
    """Add a flank's share, eccentricity in the wave generator's frame."""
    along_x, along_y = along(teeth, i, slopes)
    # Along the curve the foot point moves by one across the tooth axis and the axis turns by the curvature.
    turned = slopes.height * teeth.offset[i] - slopes.offset * teeth.height[i] + slopes.lead
    shift = slopes.offset + teeth.curvature[i] * turned
    gradient[0] += along_x
    gradient[1] += along_y
    gradient[2] += slopes.datum
    gradient[4] += shift
    # The wave generator turns about its own centre, and the teeth slide back along its curve.
    slide = c.turn_ratio * c.curve_radius * shift
    gradient[6] += slopes.lead + along_x * center.imag - along_y * center.real - slide


@part
def _add_side(
    mesh: MeshData, teeth: Teeth, flanks: Side, beta: float, side: float, center: complex, gradient: Floats
) -> float:
    """Add the flanks of one side that bear, and give their stiffness."""
    stiffness = 0.0
    for j in range(flanks.start.size):
        overlap = side * (beta - flanks.start[j])
        if overlap > 0.0:
            i = flanks.column[j]
            release = 2.0 * overlap / mesh.compliance
            share = slopes(mesh.constants, teeth.height[i], teeth.offset[i], side, flanks.gain[j], release)
            _add_tooth(mesh.constants, teeth, i, share, center, gradient)
            stiffness += flanks.gain[j]
    return stiffness


@part
def _add_edge(
    mesh: MeshData, teeth: Teeth, flanks: Side, edge: float, side: float, center: complex, gradient: Floats
) -> None:
    """Add one end of a true gap, whose middle is the torsion."""
    for j in range(flanks.start.size):
        if flanks.start[j] == edge:
            i = flanks.column[j]
            share = slopes(mesh.constants, teeth.height[i], teeth.offset[i], side, 0.5, 0.0)
            _add_tooth(mesh.constants, teeth, i, share, center, gradient)
            return


@part
def fill(
    mesh: MeshData,
    teeth: Teeth,
    flanks: Flanks,
    turn: float,
    eccentricity: complex,
    torque: float,
    beta: float,
    gradient: Floats,
) -> float:
    """Set the gradient (7,) of one moment and give the stiffness [N m/rad]."""
    gradient[:] = 0.0 if math.isfinite(beta) else math.nan
    turned = complex(math.cos(turn), math.sin(turn))
    center = eccentricity * turned.conjugate()
    stiffness = 0.0
    if torque == 0.0 and flanks.high > flanks.low:
        _add_edge(mesh, teeth, flanks.plus, flanks.high, 1.0, center, gradient)
        _add_edge(mesh, teeth, flanks.minus, flanks.low, -1.0, center, gradient)
    else:
        stiffness += _add_side(mesh, teeth, flanks.plus, beta, 1.0, center, gradient)
        stiffness += _add_side(mesh, teeth, flanks.minus, beta, -1.0, center, gradient)
        gradient /= stiffness
        gradient[3] = torque / mesh.compliance / stiffness
    housing = complex(gradient[0], gradient[1]) * turned
    gradient[0], gradient[1], gradient[5] = housing.real, housing.imag, 1.0 / stiffness
    return stiffness
