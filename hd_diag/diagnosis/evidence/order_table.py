"""Order table: waves that no cause explains, described well enough for a model to run with them."""

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

_SAME = 9.0  # deviance that a whole number may cost; half a step beside it must cost more
_SEGMENTS = 4  # of a record of fewer runs, over which a phase is compared
_KNOWN = 2.0  # standard deviations of a segment's wave from which its phase says something
_STEADY = 0.8  # length of the mean of the segments' phases, 1 if all are the same
_FEW_INPUT, _FEW_OUTPUT = 8, 4  # orders a turn of the gear itself, and of eccentric encoders


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
        Of `ORDER_LINE`: periods per turn of the input, and whether it grows with the torque.
    coefficients, covariance : ndarray, shape (2,), (2, 2)
        Of `ORDER_LINE` [rad].
    repeats : bool
        Whether it has the same phase in all parts of the record: then a model can run with it.
    might_be : tuple of str
        Causes of the catalogue that have such an order.
    is_function : bool
        Whether the model has it as a function of torque already: a line that any gear has.
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
        """[rad]; at the rated torque where it grows with the torque."""
        return float(np.hypot(*self.coefficients))

    @property
    def phase(self) -> float:
        """Of the wave at input angle zero [rad]."""
        return float(np.arctan2(self.coefficients[1], self.coefficients[0]) % (2.0 * np.pi))


def order_table(rest: Remainder, waves: list[Wave], rated_torque: float) -> tuple[OrderRow, ...]:
    """Rows for waves over the input's angle that are not of a part of the record alone.

    Parameters
    ----------
    rest : Remainder
        With the waves in it.
    waves : list of Wave
    rated_torque : float
        [N m]

    Returns
    -------
    tuple of OrderRow
        Fitted together, whole numbers per turn of input or output recognised; the largest first.
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
    """Rows of given orders, fitted to a remainder.

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
    """Rows of a table fitted to another remainder; whether they repeat stays as where they were found."""
    repeats = {row.nonlinear: row.repeats for row in rows}
    found = table_at(rest, [(row.order, row.frame, row.nonlinear) for row in rows], rated_torque)
    return tuple(replace(row, repeats=repeats[row.nonlinear]) for row in found)


def part(rows: tuple[OrderRow, ...], input_angle: Floats, torque: Floats, rated_torque: float) -> Floats:
    """What rows that repeat add to the transmission error [rad], shape (n,)."""
    total = np.zeros(input_angle.size)
    for row in rows:
        order, loaded = row.nonlinear
        wave = turning(order * input_angle) @ row.coefficients
        total += row.in_model * wave * (torque / rated_torque if loaded else 1.0)
    return total


def _whole(rest: Remainder, wave: Wave, residual: Floats, whiten: Whitening) -> tuple[float, str, float]:
    """Order and frame, in whole numbers where one fits as well and its neighbours do not; per input turn.

    A whole number per turn of the input goes before one per turn of the output.
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
    """Runs, or stretches of a record that has fewer."""
    edges = bounds(run)
    if len(edges) < _SEGMENTS:
        cuts = np.linspace(0, run.size, _SEGMENTS + 1).astype(int).tolist()
        edges = [*pairwise(cuts)]
    return [slice(*edge) for edge in edges]


def _steady(white: Floats, target: Floats, beta: Floats, segments: list[slice]) -> list[bool]:
    """Whether each wave has the same phase in the segments that show it, two at least."""
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
            # Beside the other waves at their size in the whole record.
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
