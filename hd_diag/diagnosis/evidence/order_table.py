"""Order table: waves without a known cause, described well enough for a model to run with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.evidence.waves import Remainder, Wave, Weight, turns
from hd_diag.diagnosis.fit.design import projection
from hd_diag.diagnosis.noise import Whitening, bounds, whitening
from hd_diag.effects.bearing_passage import CAGE
from hd_diag.effects.effect import Values
from hd_diag.effects.quantity import turning
from hd_diag.effects.remainders import LINES

_SAME = 9.0  # deviance that a whole number may cost; half a step away must cost more
_SEGMENTS = 4  # segments to compare phases in, for a record with fewer runs
_KNOWN = 2.0  # least size of a segment's wave for a usable phase, in standard deviations
_STEADY = 0.8  # least length of the mean phase vector of the segments; 1 if all phases are equal
_FEW_INPUT, _FEW_OUTPUT = 8, 4  # highest orders per turn of the gear; per output turn of eccentric encoders


@dataclass(frozen=True)
class OrderRow:
    """One row of the table.

    Attributes
    ----------
    order : float
        Periods per turn of its frame.
    frame : str
        ``input`` or ``output``.
    nonlinear : tuple of float
        Of `ORDER_LINE`: periods per turn of the input, and 1 if it grows with the torque, else 0.
    coefficients, covariance : ndarray, shape (2,), (2, 2)
        Of `ORDER_LINE` [rad].
    repeats : bool
        Whether its phase is the same in all parts of the record, so that a model can run with it.
    might_be : tuple of str
        Causes of the catalogue that have such an order.
    is_function : bool
        Whether the model already holds it as a function of torque: a line that any gear has.
    """

    order: float
    frame: str
    nonlinear: Values
    coefficients: Floats
    covariance: Floats
    repeats: bool
    might_be: tuple[str, ...]
    is_function: bool = False

    @property
    def in_model(self) -> bool:
        """Whether a model runs with the row itself."""
        return self.repeats and not self.is_function

    @property
    def amplitude(self) -> float:
        """Amplitude [rad], at the rated torque if the wave grows with the torque."""
        return float(np.hypot(*self.coefficients))

    @property
    def phase(self) -> float:
        """Phase of the wave at input angle zero [rad]."""
        return float(np.arctan2(self.coefficients[1], self.coefficients[0]) % (2.0 * np.pi))


def order_table(rest: Remainder, waves: list[Wave], rated_torque: float) -> tuple[OrderRow, ...]:
    """Rows for waves over the input angle, except waves found in a part of the record only.

    Parameters
    ----------
    rest : Remainder
        Residual that contains the waves.
    waves : list of Wave
    rated_torque : float
        [N m]

    Returns
    -------
    tuple of OrderRow
        Fitted together, largest first. Whole numbers per turn of input or output are recognised.
    """
    steady = [wave for wave in waves if wave.frame == "input" and not wave.weight.where]
    if not steady:
        return ()
    pairs = np.concatenate([rest.pair(wave) for wave in steady], axis=1)
    whiten = whitening(rest.residual - projection(pairs, rest.residual), rest.run)
    named = []
    for index, wave in enumerate(steady):
        others = np.delete(pairs, (2 * index, 2 * index + 1), axis=1)
        named.append(_whole(rest, wave, rest.residual - projection(others, rest.residual), whiten))
    loaded = [float(wave.weight.values.min()) < 0.0 for wave in steady]
    values = [(in_input, float(one)) for (_, _, in_input), one in zip(named, loaded, strict=True)]
    rows = [(*name[:2], value) for name, value in zip(named, values, strict=True)]
    return table_at(rest, rows, rated_torque)


def table_at(
    rest: Remainder, rows: Sequence[tuple[float, str, Values]], rated_torque: float
) -> tuple[OrderRow, ...]:
    """Rows of given orders, fitted to a residual.

    Parameters
    ----------
    rest : Remainder
    rows : sequence of (float, str, (float, float))
        Order and frame, and the nonlinear values of `ORDER_LINE`.
    rated_torque : float
        [N m]
    """
    if not rows:
        return ()
    scale = rest.torque / rated_torque
    weights = [Weight(scale if value[1] else np.ones(scale.size)) for _, _, value in rows]
    waves = [Wave(value[0], "input", weight) for (_, _, value), weight in zip(rows, weights, strict=True)]
    pairs = np.concatenate([rest.pair(wave) for wave in waves], axis=1)
    whiten = whitening(rest.residual - projection(pairs, rest.residual), rest.run)
    white, target = whiten(pairs, rest.run), whiten(rest.residual, rest.run)
    spread = np.asarray(np.linalg.pinv(white.T @ white), np.float64)
    beta = spread @ (white.T @ target)
    steady, covered = _steady(white, target, beta, _segments(rest.run)), turns(rest.input_angle)
    found = []
    for index, ((order, frame, nonlinear), repeats) in enumerate(zip(rows, steady, strict=True)):
        at = slice(2 * index, 2 * index + 2)
        might_be = _might_be(order, frame, bool(nonlinear[1]), rest.ratio)
        usual = any(line in LINES and abs(nonlinear[0] - line) * covered < 1.0 for line in rest.lines)
        found.append(OrderRow(order, frame, nonlinear, beta[at], spread[at, at], repeats, might_be, usual))
    return tuple(sorted(found, key=lambda row: -row.amplitude))


def refitted_rows(rest: Remainder, rows: Sequence[OrderRow], rated_torque: float) -> tuple[OrderRow, ...]:
    """Rows of a table fitted to another residual; `repeats` stays as it was found first."""
    repeats = {row.nonlinear: row.repeats for row in rows}
    found = table_at(rest, [(row.order, row.frame, row.nonlinear) for row in rows], rated_torque)
    return tuple(replace(row, repeats=repeats[row.nonlinear]) for row in found)


def part(rows: tuple[OrderRow, ...], input_angle: Floats, torque: Floats, rated_torque: float) -> Floats:
    """Transmission error of the rows that a model runs with [rad], shape (n,)."""
    total = np.zeros(input_angle.size)
    for row in rows:
        order, loaded = row.nonlinear
        wave = turning(order * input_angle) @ row.coefficients
        total += row.in_model * wave * (torque / rated_torque if loaded else 1.0)
    return total


def _whole(rest: Remainder, wave: Wave, residual: Floats, whiten: Whitening) -> tuple[float, str, float]:
    """Order, its frame, and the order per input turn; whole if that fits as well and its neighbours do not.

    A whole number per turn of the input takes precedence over one per turn of the output.
    """
    target = whiten(residual, rest.run)

    def deviance(order: float) -> float:
        columns = whiten(rest.pair(wave._replace(order=order)), rest.run)
        return -float(np.sum(projection(columns, target) ** 2))

    best, ratio = deviance(wave.order), abs(rest.ratio)
    for step, frame in ((1.0, "input"), (1.0 / ratio, "output")):
        number = float(round(wave.order / step))
        if number < 1.0 or deviance(number * step) - best > _SAME:
            continue
        if min(deviance((number + side) * step) for side in (-0.5, 0.5)) - best > _SAME:
            return number, frame, number * step
    return wave.order, "input", wave.order


def _segments(run: Integers) -> list[slice]:
    """Runs, or `_SEGMENTS` equal stretches if the record has fewer runs."""
    edges = bounds(run)
    if len(edges) < _SEGMENTS:
        cuts = np.linspace(0, run.size, _SEGMENTS + 1).astype(int).tolist()
        edges = [*pairwise(cuts)]
    return [slice(*edge) for edge in edges]


def _steady(white: Floats, target: Floats, beta: Floats, segments: list[slice]) -> list[bool]:
    """Whether each wave has the same phase in the segments that show it; at least two must."""
    whole = beta[::2] + 1j * beta[1::2]
    total, length = np.zeros(whole.size, complex), np.zeros(whole.size)
    count = np.zeros(whole.size, int)
    rest = target - white @ beta
    for segment in segments:
        columns = white[segment]
        for index in range(whole.size):
            own = columns[:, 2 * index : 2 * index + 2]
            gram = own.T @ own
            if np.linalg.cond(gram) > 1e3 * 1.0 or not gram.any():
                continue
            # The other waves keep their size in the whole record.
            pair = beta[2 * index : 2 * index + 2] + np.linalg.solve(gram, own.T @ rest[segment])
            here = complex(*pair)
            if np.sqrt(pair @ gram @ pair) < _KNOWN:
                continue
            total[index] += here / abs(here)
            length[index] += 1.0
            count[index] += 1
    steady = (count >= 2) & (np.abs(total) > _STEADY * np.maximum(length, 1e-300))
    return [bool(one) for one in steady]


def _might_be(order: float, frame: str, loaded: bool, ratio: float) -> tuple[str, ...]:
    """Causes of the catalogue with lines at such an order."""
    whole = order == round(order)
    if frame == "output":
        if order <= _FEW_OUTPUT:
            return ("output_runout", "output_encoder_eccentricity", "flexspline_pitch")
        around = order / abs(ratio)
        near = abs(around - round(around)) * abs(ratio)  # 2 N + 2 is the gear's own, seen from the flexspline
        if round(around) in (2, 4, 6) and 0.5 < near <= round(around) + 0.5:
            return ("flexspline_pitch", "tooth_damage")
        cage = ("bearing_passage",) if CAGE[0] <= around <= CAGE[1] else ()
        return (*cage, "output_encoder_interpolation", "tooth_damage")
    if not whole:
        return ("bearing_passage",)
    if order > _FEW_INPUT:
        return ("encoder_interpolation", "resonance")
    if order % 2 == 1:
        return ("input_encoder_eccentricity", "torque_sensor_ripple")
    if loaded:
        return ("torque_sensor_ripple", "circular_spline_pitch")
    return ("circular_spline_pitch", "circular_spline_form", "coupling_misalignment", "tooth_damage")
