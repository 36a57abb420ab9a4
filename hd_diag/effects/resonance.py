"""One order swells and turns its phase where it meets a natural frequency of the joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hd_diag.effects.effect import Quantity, StatefulEffect, Values, amplitude, direction
from hd_diag.effects.excitation import sample_interval, several_speeds
from hd_diag.effects.signals import Signals
from hd_diag.model.torsion_map import ARCSEC

Floats = npt.NDArray[np.float64]

ORDERS = (2.0, 4.0)
"""Orders of the wave generator's turn that excite."""

_COARSE = 6  # natural frequencies per order in the grid
_FINE = 60  # in a scan
_DAMPINGS = (0.02, 0.08)  # [-]
_BINS = 256  # of excitation frequency, in a scan
_CANDIDATES = 3
_TWO_PI = 2.0 * np.pi

State = tuple[float, complex, complex, complex] | None


@dataclass(frozen=True)
class Resonance(StatefulEffect):
    """What a two-inertia oscillator adds to one order: ``Re a (x - u)``, ``u = exp(i n theta_W)``.

    ``x'' + 2 zeta omega_n x' + omega_n^2 x = omega_n^2 u``; at constant speed ``x - u = (H - 1) u`` with
    ``H = 1 / (1 - r^2 + 2 i zeta r)``, ``r = n omega / omega_n``. It starts in the steady state.
    """

    def start(self, nonlinear: Values) -> State:
        """Nothing yet."""
        return None

    def step(self, state: State, signals: Signals, nonlinear: Values) -> tuple[Floats, State]:
        """Exact between samples while the speed is constant there; see :meth:`Effect.step`."""
        if not signals.size:
            return np.empty((0, 2)), state
        order, frequency, damping = nonlinear
        pole = frequency * complex(-damping, np.sqrt(1.0 - damping * damping))
        phase = order * signals.wave_generator_angle
        if state is None:
            rate = order * float(signals.wave_generator_speed[0])
            first = np.exp(1j * phase[0])
            state = (
                float(signals.time[0]),
                phase[0],
                first / (1j * rate - pole),
                first / (1j * rate - np.conj(pole)),
            )
        time = np.concatenate(([state[0]], signals.time))
        turned = np.concatenate(([np.real(state[1])], phase))
        modes = [
            _mode(q, root, time, turned) for q, root in zip(state[2:], (pole, np.conj(pole)), strict=True)
        ]
        response = frequency**2 / (2j * pole.imag) * (modes[0] - modes[1]) - np.exp(1j * phase)
        last = float(time[-1]), complex(turned[-1]), complex(modes[0][-1]), complex(modes[1][-1])
        return np.stack((response.real, response.imag), axis=1), last

    def grid(self, signals: Signals) -> list[Values]:
        """Natural frequencies [rad/s] that the orders pass."""
        return [
            (order, float(frequency), _DAMPINGS[0])
            for order in ORDERS
            for frequency in np.geomspace(*_passed(signals, order), _COARSE)
        ]

    def scan(self, signals: Signals, residual: Floats) -> list[Values]:
        """Natural frequencies and dampings that fit best as if every speed were constant."""
        found = [one for order in ORDERS for one in _quasi_static(signals, residual, order)]
        return [nonlinear for _, nonlinear in sorted(found, reverse=True)[:_CANDIDATES]]

    def trials(self, signals: Signals) -> int:
        """Orders, frequencies and dampings of a scan."""
        return len(ORDERS) * _FINE * len(_DAMPINGS)

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """Five speeds across it."""
        return several_speeds(signals, 5)


def _mode(q: complex, root: complex, time: Floats, phase: Floats) -> npt.NDArray[np.complex128]:
    """``q' = root q + u`` at the samples after the first, with u turning evenly between them."""
    step = np.diff(time)
    still = step == 0.0
    rate = np.where(still, 0.0, np.diff(phase) / np.where(still, 1.0, step))
    decay = np.exp(root * step)
    drive = np.exp(1j * phase)
    added = (drive[1:] - decay * drive[:-1]) / (1j * rate - root)
    added[still] = 0.0
    result = np.empty(step.size, dtype=np.complex128)
    for index, (factor, more) in enumerate(zip(decay.tolist(), added.tolist(), strict=True)):
        q = factor * q + more
        result[index] = q
    return result


def _passed(signals: Signals, order: float) -> tuple[float, float]:
    """Lowest and highest natural frequency worth trying [rad/s]."""
    greatest = order * float(np.max(np.abs(signals.wave_generator_speed), initial=0.0))
    greatest = min(greatest, np.pi / sample_interval(signals)) if signals.size > 1 else greatest
    greatest = max(greatest, 1.0)
    return 0.15 * greatest, 1.3 * greatest


def _quasi_static(signals: Signals, residual: Floats, order: float) -> list[tuple[float, Values]]:
    """Gain of every frequency and damping: the order's amplitude, bin by bin of the exciting frequency."""
    rate = order * signals.wave_generator_speed
    greatest = max(float(np.max(np.abs(rate), initial=0.0)), 1.0)
    place = np.rint((rate / greatest + 1.0) * (0.5 * (_BINS - 1))).astype(np.int64)
    turned = (residual - residual.mean()) * np.exp(-1j * order * signals.wave_generator_angle)
    sums = np.bincount(place, turned.real, _BINS) + 1j * np.bincount(place, turned.imag, _BINS)
    count = np.bincount(place, minlength=_BINS)
    center = np.linspace(-greatest, greatest, _BINS)
    found: list[tuple[float, Values]] = []
    for frequency in np.geomspace(*_passed(signals, order), _FINE):
        for damping in _DAMPINGS:
            r = center / frequency
            added = 1.0 / (1.0 - r**2 + 2j * damping * r) - 1.0
            power = float(count @ np.abs(added) ** 2)
            gain = float(np.abs(np.conj(added) @ sums) ** 2) / power if power > 0.0 else 0.0
            found.append((gain, (order, float(frequency), damping)))
    return found


EFFECT = Resonance(
    name="resonance",
    cause="An order of the gear meets the natural frequency of link inertia on the drive's stiffness.",
    kind="torsion",
    frame="time",
    needs=("time", "wave_generator_angle", "speed", "run"),
    quantities=(
        amplitude("amplitude", "rad", 1e-2, 8.0 * ARCSEC, "a, of the exciting order well below resonance"),
        direction("phase", "of the exciting order at wave generator angle zero"),
        Quantity(
            "order",
            "-",
            ORDERS[0],
            ORDERS[-1],
            1.0,
            "n, exciting order of the wave generator's turn",
            False,
            None,
            True,
        ),
        Quantity("natural_frequency", "rad/s", 1.0, 1e4, 100.0, "omega_n, undamped", linear=False),
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
