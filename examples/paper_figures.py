"""The paper's Figs. 5, 6 and 7, computed and drawn by the model, and whether the paper's claims hold.

`hd-diag figures` runs this file.

H. Dong, T. Chen, D. Wang, B. Dong, Kinematic Model of Harmonic Drive in Robot Joints with Input Eccentricity
Error, ROMANSY 22, CISM 584, pp. 134-140, 2019, doi 10.1007/978-3-319-78963-7_18, sections 4.2, 4.3 and 5. As
in the paper's example the long axis stands on tooth 0, which is held there (eq. 1), and the eccentricity
stands across it, counter-clockwise: to the right of tooth 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import brentq

from hd_diag.arrays import Floats
from hd_diag.drive import Drive, MeshState, mesh_state
from hd_diag.model.neutral_curve import NeutralCurve, tooth_axes
from hd_diag.model.transmission_error import Kinematics
from hd_diag.report.pictures.canvas import DASHES, INK, SERIES, drawn, sheet, titled, turn

_PUBLISHED = 23e-6  # eccentricity at which interference first appears, section 4.2 [m]
_SIZES = np.linspace(0.0, _PUBLISHED, 6)  # eccentricities drawn [m]
_MOST = 40e-6  # largest eccentricity at which interference is looked for [m]
_DATUM_REACH = 20e-6  # largest shift of the datum to get the published interference [m]
_ROUNDING = 0.5e-6  # of a datum radius configured in micrometres [m]
_ENGAGED = 1.0 / 5.0  # share of all teeth shown to either side of the long axis
_FLANKS = (7.0 / 200.0, 24.0 / 200.0)  # shares of all teeth between which one flank alone is the nearer one
_TURN = 2.0 * np.pi
_PASSAGE = np.linspace(-0.9, 0.9, 451)  # wave generator angles while a lobe passes a tooth [rad]
_MICROMETRE = 1e-6
_EQUAL = 1e-12  # lengths that differ by less are equal up to rounding [m]
_SHOWN = 30.0  # shown to either side of the long axis [°]: over a whole wave the change is as thin as a line
_FREE = {6: 40.0, 7: 60.0}  # backlash above which a tooth counts as free [µm]
_NEAR: Any = {"color": INK, "lw": 0.9, "ls": (0, (1, 1))}


class Claim(NamedTuple):
    """A claim of the paper: its letter here, what was computed, and whether that agrees."""

    letter: str
    text: str
    holds: bool


class Study(NamedTuple):
    """What is drawn: eccentricities [m], their direction from the long axis [rad], torque [N m] (0: rated).

    `section` counts from 0 at the cup's bottom; None shows the teeth of the whole width and the neutral layer
    of the middle. Claims are the paper's, and are given for its own arrangement only.
    """

    sizes: Floats = _SIZES
    direction: float = 0.5 * np.pi
    torque: float = 0.0
    section: int | None = None

    @property
    def is_published(self) -> bool:
        """Whether this is the paper's arrangement."""
        return self.sizes is _SIZES and self.direction == 0.5 * np.pi and not self.torque


PAPER = Study()


class Drawn(NamedTuple):
    """A figure: file name, title, picture, claims, and columns of its data by their names with units."""

    name: str
    title: str
    figure: Figure
    claims: tuple[Claim, ...]
    data: dict[str, Floats]


def figures(drive: Drive, study: Study = PAPER) -> list[Drawn]:
    """Each figure of a drive."""
    if study.torque:
        drive = replace(drive, rated_torque=study.torque)
    layer, teeth = neutral_layer(drive, study), teeth_at_once(drive, study)
    tooth = tooth_over_time(drive, study)
    titles = (
        "Motion of the neutral layer (as Fig. 5)",
        "Backlash and load of all teeth at one moment (as Fig. 6)",
        "One tooth over time (as Fig. 7)",
    )
    told = layer.claims, teeth.claims, tooth.claims
    drawings = figure_5(layer), figure_6(teeth), figure_7(tooth)
    around = {"direction [rad]": layer.direction} | _columns("displacement_change", "m", layer, layer.change)
    data = around, _engaged_data("tooth", teeth), _engaged_data("wave_generator_angle [rad]", tooth)
    return [
        Drawn(f"figure_{number}", title, drawing, claims if study.is_published else (), columns)
        for number, title, drawing, claims, columns in zip(
            (5, 6, 7), titles, drawings, told, data, strict=True
        )
    ]


def _columns(name: str, unit: str, found: NeutralLayer | Engagement, rows: Floats) -> dict[str, Floats]:
    """Rows (eccentricities, places) as columns, one for each eccentricity."""
    sizes = found.eccentricity / _MICROMETRE
    return {f"{name} at {size:.3g} um [{unit}]": row for size, row in zip(sizes, rows, strict=True)}


def _engaged_data(place: str, found: Engagement) -> dict[str, Floats]:
    backlash, load = (
        _columns(name, unit, found, rows)
        for name, unit, rows in (("backlash", "m", found.backlash), ("load", "N", found.load))
    )
    return {place: found.place} | backlash | load


@dataclass(frozen=True)
class NeutralLayer:
    """Fig. 5: motion of the neutral layer's points.

    Attributes
    ----------
    stations : ndarray, shape (stations,)
        Angles of the points on the undeformed layer [rad].
    from_long_axis : ndarray, shape (places,)
        Arc from the long axis over R_b [rad].
    displacement : ndarray, shape (2, stations, places)
        Radial, from the undeformed circle [m]: without and with the largest eccentricity.
    direction : ndarray, shape (directions,)
        Direction of a point [rad].
    change : ndarray, shape (eccentricities, directions)
        Change of its radial displacement by the eccentricity [m].
    eccentricity : ndarray, shape (eccentricities,)
        [m]
    claims : tuple of Claim
    """

    stations: Floats
    from_long_axis: Floats
    displacement: Floats
    direction: Floats
    change: Floats
    eccentricity: Floats
    claims: tuple[Claim, ...]


@dataclass(frozen=True)
class Engagement:
    """Figs. 6 and 7: backlash and load of all teeth at one moment, or of one tooth over time.

    Attributes
    ----------
    eccentricity : ndarray, shape (eccentricities,)
        [m]; in Fig. 7 away from the tooth.
    place : ndarray, shape (places,)
        Fig. 6: tooth, from the long axis, positive to the right; Fig. 7: angle of the wave generator [rad].
    backlash, load : ndarray, shape (eccentricities, places)
        Lesser of both flanks without torque [m]; sum of both at `torque` [N].
    near : tuple of two ndarray, shape (places,), or None
        Fig. 7: backlash and load for the largest eccentricity towards the tooth.
    torque : float
        The rated one [N m].
    claims : tuple of Claim
    """

    eccentricity: Floats
    place: Floats
    backlash: Floats
    load: Floats
    near: tuple[Floats, Floats] | None
    torque: float
    claims: tuple[Claim, ...]


def neutral_layer(drive: Drive, study: Study = PAPER) -> NeutralLayer:
    """Fig. 5 for a drive."""
    stations = np.radians([0.0, 45.0, 90.0, 135.0])
    place = np.linspace(-np.pi / 2, np.pi / 2, 181)
    towards = study.sizes * np.exp(1j * study.direction)
    pair, curve, leant = (0.0, towards[-1]), *_layer(drive, study.section)
    both = np.stack([_radial(curve, place, stations[:, None] - place, e + leant) for e in pair])
    around = np.linspace(0.0, _TURN, 361)
    rows = np.stack([_radial(curve, around, np.zeros(around.size), e + leant) for e in (0.0, *towards)])
    change = rows[1:] - rows[0]
    where = np.mod(tooth_axes(curve, around)[0], _TURN)
    claims = _motion_claims(stations, both, where, change[-1])
    return NeutralLayer(stations, place, both, where, change, study.sizes, claims)


def _layer(drive: Drive, section: int | None) -> tuple[NeutralCurve, complex]:
    """Neutral curve of a section, by default the middle, and the offset of its centre by the tilt [m]."""
    geometry = drive.mesh.geometry
    if section is None:
        return geometry.curve, 0.0
    return geometry.section_curves[section], drive.mesh.tilt * float(geometry.section_places[section])


def _radial(curve: NeutralCurve, place: Floats, turned: Floats, eccentricity: complex) -> Floats:
    """Radial displacement [m] of the layer's points at places from the long axis, which is turned [rad]."""
    angle, height, offset = tooth_axes(curve, place)
    point = (height + 1j * offset) * np.exp(1j * (angle + turned)) + eccentricity
    return np.asarray(np.abs(point) - curve.radius)


def _motion_claims(stations: Floats, both: Floats, where: Floats, change: Floats) -> tuple[Claim, ...]:
    still, apart = np.ptp(both, axis=1).max(axis=1) / _MICROMETRE
    greatest = float(np.degrees(where[np.argmax(change)]))
    most, size = float(change.max()) / _MICROMETRE, _PUBLISHED / _MICROMETRE
    return (
        Claim(
            "a",
            f"Without eccentricity all points of the neutral layer share one motion; at {size:.1f} µm those "
            f"at {', '.join(f'{np.degrees(s):.0f}' for s in stations)}° are up to {apart:.1f} µm "
            "apart at the same place on the wave generator.",
            bool(still < _EQUAL / _MICROMETRE and apart > size),
        ),
        Claim(
            "a",
            f"The radial displacement changes most, by {most:.1f} µm, at {greatest:.0f}°, where "
            "the eccentricity points (90°).",
            bool(abs(greatest - 90.0) < 2.0 and abs(most / size - 1.0) < 0.01),
        ),
    )


def teeth_at_once(drive: Drive, study: Study = PAPER) -> Engagement:
    """Fig. 6 for a drive."""
    tooth = engaged(drive)
    towards = study.sizes * np.exp(1j * study.direction)
    states = [moment(drive, e, drive.rated_torque, study.section) for e in towards]
    backlash = np.stack([_free(drive, e, study.section) for e in towards])
    load = np.stack([state.load[0].sum(axis=0) for state in states])
    claims = (
        *_backlash_claims(tooth, backlash, drive.mesh.geometry.flexspline_teeth),
        _first_claim(drive, study.section),
        _load_claim(drive, states, load),
    )
    return Engagement(
        study.sizes, tooth.astype(np.float64), backlash, load[:, tooth], None, drive.rated_torque, claims
    )


def _backlash_claims(tooth: npt.NDArray[np.int64], backlash: Floats, teeth: int) -> tuple[Claim, ...]:
    low, high = (share * teeth for share in _FLANKS)
    skew = float(np.nanmax(np.abs(backlash[0] - backlash[0][::-1])))
    growth = np.diff(backlash, axis=0)
    left, right = (growth[:, (side >= low) & (side <= high)] for side in (-tooth, tooth))
    grown, shrunk = (float(np.nanmean(side.sum(axis=0))) / _MICROMETRE for side in (left, right))
    return (
        Claim("b", "Without eccentricity the backlash is symmetric about the long axis.", skew < _EQUAL),
        Claim(
            "b",
            f"With it, backlash grows on the left half, by {grown:.1f} µm on the mean, and shrinks on "
            f"the right, by {-shrunk:.1f} µm.",
            bool(np.all(left > 0.0) and np.all(right < 0.0)),
        ),
    )


def _first_claim(drive: Drive, section: int | None) -> Claim:
    least = float(np.nanmin(_free(drive, 0.0, section))) / _MICROMETRE
    if least < 0.0:
        return Claim("c", f"Teeth interfere without eccentricity, by {-least:.1f} µm.", False)
    first = first_interference(drive, section) / _MICROMETRE
    shift = _published_datum(drive, section) / _MICROMETRE
    published = _PUBLISHED / _MICROMETRE
    if not np.isfinite(first + shift):
        text = f"Interference does not first appear at an eccentricity near {published:.1f} µm."
        return Claim("c", text, False)
    return Claim(
        "c",
        f"Interference first appears at an eccentricity of {first:.1f} µm. The paper has {published:.1f} µm "
        f"and does not print the datum radius, on which it depends sharply: with a datum {abs(shift):.2f} µm "
        f"{'above' if shift > 0.0 else 'below'} the configured one it is {published:.1f} µm here, too.",
        bool(abs(shift) <= _ROUNDING / _MICROMETRE),
    )


def first_interference(drive: Drive, section: int | None = None) -> float:
    """Eccentricity at which a tooth near the long axis first has no backlash [m]; nan if none has."""
    return _root(lambda e: float(np.nanmin(_free(drive, 1j * e, section))), 0.0, _MOST)


def _published_datum(drive: Drive, section: int | None) -> float:
    """Shift of the slots' datum that gives the published first interference [m]; nan if it is too large."""
    geometry = drive.mesh.geometry

    def least(shift: float) -> float:
        moved = replace(geometry, circular_spline_datum=geometry.circular_spline_datum + shift)
        there = replace(drive, mesh=replace(drive.mesh, geometry=moved))
        return float(np.nanmin(_free(there, 1j * _PUBLISHED, section)))

    return _root(least, -_DATUM_REACH, _DATUM_REACH)


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    """Zero of a function of a length [m]; nan if the function has one sign at both ends."""
    if not function(low) * function(high) < 0.0:
        return float("nan")
    return float(brentq(function, low, high, xtol=1e-10))


def _load_claim(drive: Drive, states: list[MeshState], load: Floats) -> Claim:
    pairs, peak = [int(state.loaded_pairs[0]) for state in states], load.max(axis=1)
    around = _TURN * np.arange(load.shape[1]) / load.shape[1]
    lever = (load @ np.sin(around)) / load.sum(axis=1)
    rising = np.all(np.diff(peak) > 0.0) and np.all(np.diff(lever) > 0.0)
    return Claim(
        "d",
        f"At {drive.rated_torque:g} N m, from no eccentricity to the largest, the loaded pairs go from "
        f"{pairs[0]} to {pairs[-1]}, the largest force from {peak[0]:.1f} to {peak[-1]:.1f} N, and the "
        "load's centre moves towards the eccentricity, from "
        f"{abs(lever[0]):.2f} to {lever[-1]:.2f} of the radius.",
        bool(rising and np.all(np.diff(pairs) <= 0) and pairs[-1] < pairs[0]),
    )


def tooth_over_time(drive: Drive, study: Study = PAPER) -> Engagement:
    """Fig. 7 for a drive."""
    backlash, load = (
        np.stack(rows)
        for rows in zip(*(_passage(drive, -e, study.section) for e in study.sizes), strict=True)
    )
    near = _passage(drive, study.sizes[-1], study.section)
    least, most = np.nanmin(backlash, axis=1) / _MICROMETRE, load.max(axis=1)
    nearest, greatest = float(np.nanmin(near[0])) / _MICROMETRE, float(near[1].max())
    claims = (
        Claim(
            "e",
            f"On the side away from the eccentricity, from none to {_PUBLISHED / _MICROMETRE:.1f} µm, the "
            f"tooth's least backlash grows from {_signed(least[0])} to {_signed(least[-1])} µm and its "
            f"largest force at {drive.rated_torque:g} N m falls from {most[0]:.1f} to {most[-1]:.1f} N.",
            bool(np.all(np.diff(least) > 0.0) and np.all(np.diff(most) < 0.0)),
        ),
        Claim(
            "e",
            f"On the near side it is the other way about: {_signed(nearest)} µm and {greatest:.1f} N.",
            bool(nearest < least[0] and greatest > most[0]),
        ),
    )
    return Engagement(study.sizes, _PASSAGE, backlash, load, near, drive.rated_torque, claims)


def _passage(drive: Drive, eccentricity: float, section: int | None) -> tuple[Floats, Floats]:
    """Backlash [m] and load [N] of tooth 0 during a lobe's passage, with the eccentricity along the tooth."""
    placed = _placed(drive, complex(eccentricity, 0.0), 0.0)
    state = _seen(mesh_state(placed, _PASSAGE, np.full(_PASSAGE.size, drive.rated_torque)), section)
    return np.fmin(state.backlash[:, 0, 0], state.backlash[:, 1, 0]), state.load[:, :, 0].sum(axis=1)


def _placed(drive: Drive, eccentricity: complex, arc_offset: float) -> Drive:
    """The drive with this displacement alone; its input angle is the wave generator's angle."""
    mesh = replace(drive.mesh, eccentricity=eccentricity, runout=0.0, arc_offset=arc_offset)
    return Drive(mesh, Kinematics(-mesh.geometry.reduction), drive.rated_torque)


def moment(drive: Drive, eccentricity: complex, torque: float, section: int | None = None) -> MeshState:
    """The paper's initial moment: tooth 0 stays on the axis, so the layer's arc follows the eccentricity."""
    placed = _placed(drive, eccentricity, -eccentricity.imag)
    return _seen(mesh_state(placed, np.zeros(1), np.array([torque])), section)


def _seen(state: MeshState, section: int | None) -> MeshState:
    """The state with the teeth of one section, if one is given."""
    if section is None:
        return state
    return replace(state, backlash=state.section_backlash[:, section], load=state.section_load[:, section])


def engaged(drive: Drive) -> npt.NDArray[np.int64]:
    """Teeth near the long axis, counted from it, from left to right."""
    reach = int(_ENGAGED * drive.mesh.geometry.flexspline_teeth)
    return np.arange(-reach, reach + 1)


def _free(drive: Drive, eccentricity: complex, section: int | None = None) -> Floats:
    """Backlash of the teeth near the long axis at the paper's moment, the lesser of both flanks [m]."""
    backlash = moment(drive, eccentricity, 0.0, section).backlash[0]
    return np.asarray(np.fmin(backlash[0], backlash[1])[engaged(drive)])


def _signed(value: float) -> str:
    return f"{value:.1f}".replace("-", "−")


@drawn
def figure_5(found: NeutralLayer) -> Figure:
    """Radial displacement of the neutral layer's points, and its change by the eccentricity."""
    figure, (top, bottom) = sheet(5.4, 2)
    place = np.degrees(found.from_long_axis)
    displacement, change = found.displacement * 1e6, found.change * 1e6
    top.plot(place, displacement[0, 0], color=INK, lw=2.6, alpha=0.4, label="none: all points")
    for colour, dashes, angle, row in zip(SERIES, DASHES, found.stations, displacement[1], strict=False):
        top.plot(place, row, color=colour, ls=dashes, lw=1.0, label=f"point at {np.degrees(angle):.0f}°")
    shown = displacement[:, :, np.abs(place) <= _SHOWN]
    top.set_xlim(-_SHOWN, _SHOWN)
    top.set_ylim(shown.min() - 5.0, shown.max() + 5.0)
    top.set_xlabel("Arc from the long axis [°]")
    titled(top, f"Radial displacement [µm], none and {found.eccentricity[-1] * 1e6:.1f} µm")
    order = np.argsort(found.direction)
    direction = np.degrees(found.direction[order])
    for colour, dashes, size, row in zip(SERIES, DASHES, found.eccentricity, change, strict=False):
        bottom.plot(direction, row[order], color=colour, ls=dashes, label=f"{size * 1e6:.1f} µm")
    turn(bottom, "Where the point is [°]; the eccentricity points to 90°")
    titled(bottom, "Its change by eccentricity [µm]")
    return figure


@drawn
def figure_6(found: Engagement) -> Figure:
    """Backlash and load over the teeth at one moment."""
    figure, top, bottom = _engagement(found, found.place, 5.2, _FREE[6])
    titled(top, "Backlash [µm] at eccentricities of")
    bottom.set_title(f"Load at {found.torque:g} N m [N]")
    bottom.set_xlabel("Tooth, from the long axis; right: towards the eccentricity")
    return figure


@drawn
def figure_7(found: Engagement) -> Figure:
    """Backlash and load of one tooth while a lobe passes it."""
    figure, top, bottom = _engagement(found, np.degrees(found.place), 5.4, _FREE[7])
    titled(top, "Backlash of a tooth away from eccentricities of [µm]")
    bottom.set_title(f"Its load at {found.torque:g} N m [N]")
    bottom.set_xlabel("Wave generator angle from the tooth [°]")
    return figure


def _engagement(found: Engagement, place: Floats, height: float, free: float) -> tuple[Figure, Axes, Axes]:
    """Backlash above, load below; the caller adds the titles."""
    figure, (top, bottom) = sheet(height, 2, sharex=True)
    rows = zip(SERIES, DASHES, found.eccentricity, found.backlash, found.load, strict=False)
    for colour, dashes, size, backlash, load in rows:
        top.plot(place, backlash * 1e6, color=colour, ls=dashes, label=f"{size * 1e6:.1f} µm")
        bottom.plot(place, load, color=colour, ls=dashes)
    if found.near is not None:
        top.plot(
            place, found.near[0] * 1e6, label=f"{found.eccentricity[-1] * 1e6:.1f} µm towards it", **_NEAR
        )
        bottom.plot(place, found.near[1], **_NEAR)
    top.axhline(0.0, color=INK, lw=0.7)
    top.set_ylim(top=free)
    bottom.set_xlim(float(place[0]), float(place[-1]))
    return figure, top, bottom
