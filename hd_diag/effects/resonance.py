"""One order swells and turns its phase where it meets a natural frequency of the joint."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Complexes, Floats
from hd_diag.effects.effect import Effect, Stage, Starts, Stepped, Values
from hd_diag.effects.excitation import (
    enough_input_turns,
    loaded,
    sample_interval,
    several_speeds,
    torque_known,
)
from hd_diag.effects.quantity import Quantity, amplitude, choice, direction
from hd_diag.effects.recursions import relax
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

ORDERS = (1.0, 2.0, 4.0)
"""Orders of the wave generator's turn that excite."""

LOWEST = 10.0
"""Lowest natural frequency [rad/s]: no joint swings more slowly than once in half a second."""

_COARSE = 6  # natural frequencies per order in the grid
_FINE = 60  # natural frequencies per order in a scan of a residual
_DAMPINGS = (0.03, 0.08)  # [-]
_SLACK = 2.5e-3  # torque at which half of the ripple passes the backlash, over the rated torque
_TICK = 2.0**-40  # resolution of time steps [s]
_BINS = 256  # bins of the wave generator's speed in a scan

Before = tuple[tuple[float, float, float], tuple[complex, ...]]
State = Before | None


class Resonance(Effect):
    """The response of a two-inertia oscillator to one order, ``Re a x``, and to the gear's own ripple.

    A spring and damper connect the link x to the gear, which moves by u:
    ``x'' + 2 zeta omega_n (x' - u') + omega_n^2 (x - u) = 0``, ``u = exp(i n theta_W)``. At constant speed
    ``x = H u``, ``H = (1 + 2 i zeta r) / (1 - r^2 + 2 i zeta r)``, ``r = n omega / omega_n``. The model
    already has the ripple that it predicts, so a share c of it passes the same spring with ``c (H - 1)``.
    Without torque the link is loose in the backlash, and no ripple reaches it. The oscillator starts in the
    steady state, for the ripple at rest.
    """

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """The oscillator's inputs, alike for all frequencies, are cached; see :meth:`Effect.columns`."""
        kept = signals.kept.setdefault(("resonance", nonlinear[0]), [])
        if not kept and signals.size:
            _ = signals.ripple, signals.contact.ripple
            kept += [_path(signals.part(run), nonlinear[0], None) for run in signals.runs()]
        parts = [_stepped(nonlinear, path, None)[0] for path in kept]
        return np.concatenate(parts) if parts else np.empty((0, 3))

    def step(self, state: State, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """The recursion is exact for constant speed between samples; see :meth:`Effect.step`."""
        if not signals.size:
            return np.empty(0), state
        columns, state = _stepped(nonlinear, _path(signals, nonlinear[0], state), state)
        return np.asarray(columns @ coefficients), state

    def carry(self, signals: Signals, added: Floats, coefficients: Floats, nonlinear: Values) -> Floats:
        """Every part filtered by ``c (H - 1)``; see :meth:`Effect.carry`."""
        pole, residue = _oscillator(nonlinear)
        passed = added * _passing(signals)[:, None]
        result = -passed
        for run in signals.runs():
            moved = passed[run]
            decay, constant, rising = _steps(pole, _intervals(signals.time[run]))
            added_by = constant[:, None] * moved[:-1] + rising[:, None] * np.diff(moved, axis=0)
            first = -moved[0] / pole + 0j
            result[run] += (residue * np.vstack((first, relax(first, decay, added_by)))).real
        return np.asarray(coefficients[2] * result)

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Natural frequencies [rad/s] that the orders pass, or those that fit a residual best.

        The fit to a residual is quasi-static: it treats every speed as constant.
        """
        trials = len(ORDERS) * _FINE * len(_DAMPINGS)
        if residual is not None:
            bins = _binned(signals, residual)
            each = [(order, damping) for order in ORDERS for damping in _DAMPINGS]
            return Starts([max(_quasi_static(signals, bins, *one))[1] for one in each], trials)
        passed = [(order, np.geomspace(*_passed(signals, order), _COARSE)) for order in ORDERS]
        return Starts([(order, float(one), _DAMPINGS[0]) for order, every in passed for one in every], trials)


def _oscillator(nonlinear: Values) -> tuple[complex, complex]:
    """Pole [1/s] and residue of the link's response."""
    _, frequency, damping = nonlinear
    pole = frequency * complex(-damping, np.sqrt(1.0 - damping * damping))
    return pole, (2.0 * damping * frequency * pole + frequency**2) / (1j * pole.imag)


def _passing(signals: Signals) -> Floats:
    """Share of the gear's ripple that the torque passes on (n,); in the backlash noise selects the flank."""
    load = np.abs(signals.torque) / (_SLACK * signals.rated_torque)
    return np.asarray(load**4 / (1.0 + load**4))


class _Path(NamedTuple):
    """Inputs of the oscillator at n consecutive samples; they do not depend on its pole.

    The sample before them comes first, if there is one.
    """

    time: Floats
    phase: Floats
    ripple: Floats
    step: Floats  # time steps [s], shape (n - 1,), or (1,) if all are equal
    drive: Complexes  # exp(i phase)
    rate: Floats  # phase rate between samples [rad/s], shape (n - 1,)
    first_rate: float  # phase rate at the first sample [rad/s]


def _path(signals: Signals, order: float, state: State) -> _Path:
    time, phase = signals.time, order * signals.wave_generator_angle
    ripple = signals.ripple * _passing(signals)
    if state is not None:
        now = zip(state[0], (time, phase, ripple), strict=True)
        time, phase, ripple = (np.concatenate(([last], values)) for last, values in now)
    step, turned = _intervals(time), np.diff(phase)
    rate = np.where(step == 0.0, 0.0, turned / np.where(step == 0.0, 1.0, step))
    first_rate = order * float(signals.wave_generator_speed[0])
    return _Path(time, phase, ripple, step, np.cos(phase) + 1j * np.sin(phase), rate, first_rate)


def _intervals(time: Floats) -> Floats:
    """Time steps rounded to a picosecond [s], shape (n - 1,), or (1,) if all are equal.

    Without this, floating-point rounding would make the steps of evenly spaced samples differ.
    """
    step = np.round(np.diff(time) / _TICK) * _TICK
    return step[:1] if step.size and (step == step[0]).all() else step


def _steps(pole: complex, step: Floats) -> tuple[Complexes, Complexes, Complexes]:
    """Factors of q, v and the change of v over a step of ``q' = pole q + v``; (n,) or (1,) each."""
    z, still = pole * step, step == 0.0
    safe = np.where(still, 1.0, z)
    grown = np.expm1(safe)
    rising = np.where(still, 0.0, (grown - safe) / (pole * safe))
    return np.exp(z), np.where(still, 0.0, grown / pole), rising


def _stepped(nonlinear: Values, path: _Path, state: State) -> tuple[Floats, State]:
    """Columns (n, 3) along a path, and the state at its end."""
    pole, residue = _oscillator(nonlinear)
    first = np.array(_steady(pole, path) if state is None else state[1])
    decay, constant, rising = _steps(pole, path.step)
    # Contributions of exp(i phase) and its conjugate, at constant rate between samples.
    before, after, turning = path.drive[:-1], path.drive[1:], 1j * path.rate
    forward = (after - decay * before) / (turning - pole)
    backward = (after.conj() - decay * before.conj()) / (-turning - pole)
    straight = path.ripple[:-1] * constant + np.diff(path.ripple) * rising
    waves = np.stack((0.5 * (forward + backward), -0.5j * (forward - backward)), axis=1)
    waves[np.broadcast_to(path.step == 0.0, waves.shape[:1])] = 0.0
    modes = relax(first, decay, np.column_stack((waves, straight)))
    if state is None:  # the first sample is the steady state
        modes = np.vstack((first, modes))
    response = (residue * modes).real
    response[:, 2] -= path.ripple[path.ripple.size - response.shape[0] :]
    end = float(path.time[-1]), float(path.phase[-1]), float(path.ripple[-1])
    return response, (end, tuple(modes[-1].tolist()))


def _steady(pole: complex, path: _Path) -> tuple[complex, ...]:
    """Steady state at the first sample's speed and ripple."""
    first, rate = complex(path.drive[0]), path.first_rate
    forward, backward = first / (1j * rate - pole), first.conjugate() / (-1j * rate - pole)
    return 0.5 * (forward + backward), -0.5j * (forward - backward), -float(path.ripple[0]) / pole


def _passed(signals: Signals, order: float) -> tuple[float, float]:
    """Lowest and highest natural frequency worth trying [rad/s]."""
    greatest = order * float(np.max(np.abs(signals.wave_generator_speed), initial=0.0))
    greatest = min(greatest, np.pi / sample_interval(signals)) if signals.size > 1 else greatest
    greatest = max(greatest, 2.0 * LOWEST)
    moving = np.abs(signals.wave_generator_speed)
    slow = float(np.percentile(moving[moving > 0.0], 10)) if moving.any() else 0.0
    return max(min(max(0.7 * order * slow, 0.02 * greatest), 0.15 * greatest), LOWEST), 1.3 * greatest


def _binned(signals: Signals, residual: Floats) -> tuple[Floats, Floats, Complexes, Complexes]:
    """Speed bins [rad/s], samples in each (bins,), demodulated residual and ripple [rad] (orders, bins)."""
    speed = signals.wave_generator_speed
    greatest = max(float(np.max(np.abs(speed), initial=0.0)), 1e-3)
    place = np.rint((speed / greatest + 1.0) * (0.5 * (_BINS - 1))).astype(np.int64)
    count = np.bincount(place, minlength=_BINS).astype(np.float64)

    def means(values: Floats) -> Complexes:
        centred, found = values - values.mean(), []
        for order in ORDERS:
            turned = centred * np.exp(-1j * order * signals.wave_generator_angle)
            found.append(np.bincount(place, turned.real, _BINS) + 1j * np.bincount(place, turned.imag, _BINS))
        sums: Complexes = np.stack(found)
        return np.asarray(sums / np.maximum(count, 1.0), dtype=np.complex128)

    return (
        np.linspace(-greatest, greatest, _BINS),
        count,
        means(residual),
        2.0 * means(signals.ripple),
    )


def _quasi_static(
    signals: Signals, bins: tuple[Floats, Floats, Complexes, Complexes], order: float, damping: float
) -> list[tuple[float, Values]]:
    """Sum of squares that each natural frequency explains [rad^2], by the order and by the passed ripple.

    With it the nonlinear values. Every speed bin is treated as a steady state.
    """
    speed, count, rest, ripple = bins
    own = (np.array(ORDERS) == order)[:, None]
    frequencies = np.geomspace(*_passed(signals, order), _FINE)
    r = np.array(ORDERS)[:, None] * speed / frequencies[:, None, None]
    through = (1.0 + 2j * damping * r) / (1.0 - r**2 + 2j * damping * r)
    # Demodulating a real wave gives half of its amplitude.
    parts = 0.5 * np.stack((own * through, -1j * own * through, (through - 1.0) * ripple), axis=1)
    flat, weighted = (every.reshape(_FINE, 3, -1) for every in (parts, parts.conj() * count))
    moments = (weighted @ rest.ravel()).real
    grams = (weighted @ flat.transpose(0, 2, 1)).real
    found: list[tuple[float, Values]] = []
    for frequency, moment, gram in zip(frequencies, moments, grams, strict=True):
        gram = gram + 1e-9 * np.trace(gram) * np.eye(3)
        gain = float(moment @ np.linalg.solve(gram, moment)) if gram.any() else 0.0
        found.append((gain, (order, float(frequency), damping)))
    return found


EFFECT = Resonance(
    name="resonance",
    cause="An order of the gear meets the natural frequency of link inertia on the drive's stiffness.",
    kind="torsion",
    frame="time",
    needs=("time", "wave_generator_angle", "speed", "torque", "run"),
    # Needs five speeds across the resonance, enough turns, and a load that makes ripple.
    excitation=(
        torque_known,
        loaded,
        partial(enough_input_turns, turns=20.0),
        partial(several_speeds, number=5),
    ),
    stage=Stage.SPRING,
    remembers=True,
    quantities=(
        amplitude("amplitude", "rad", 1e-2, 8.0 * ARCSEC, "a, of the exciting order well below resonance"),
        direction("phase", "of the exciting order at wave generator angle zero"),
        Quantity(
            "carried",
            "-",
            -0.5,
            1.5,
            1.0,
            "c, share of the gear's own ripple that passes the spring",
            shape=True,
        ),
        choice("order", "n, exciting order of the wave generator's turn", ORDERS),
        Quantity("natural_frequency", "rad/s", LOWEST, 1e4, 100.0, "omega_n, undamped", linear=False),
        Quantity("damping", "-", 2e-3, 0.5, 0.03, "zeta, share of the critical one", linear=False),
    ),
    confused_with=("circular_spline_pitch", "circular_spline_form", "coupling_misalignment", "stream_delay"),
    source="two-inertia oscillator; in harmonic drives: Tuttle, MIT AI TR 1365, 1992",
    inspect=(
        "Ring-down: strike the link with the motor held; the natural frequency must be the one found (root "
        "of stiffness over inertia). Add a known inertia to the link: it must fall by the root. Ramp the "
        "speed slowly: the order swells where n times the wave generator's speed meets it, whichever the "
        "order."
    ),
)
