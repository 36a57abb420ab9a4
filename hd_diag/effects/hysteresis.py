"""Friction in the teeth and the cup: the torsion depends on where the torque came from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Starts, Stepped, Values, by_run
from hd_diag.effects.excitation import torque_reverses
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.recursions import slip
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

_FRACTIONS = (0.02, 0.05, 0.12, 0.3)  # of the rated torque
_SWING = 0.1  # of the rated torque, that must be reversed twice

# Last torque [N m], None before the first sample; z of both elements.
State = tuple[float | None, tuple[float, ...]]


@dataclass(frozen=True, kw_only=True)
class Hysteresis(Effect):
    """Two Maxwell slip elements: ``z <- clip(z + dT / r, -1, 1)``, ``a_1 z_1 + a_2 z_2``.

    a > 0: the link lags less while the torque grows and more while it falls, as friction beside the spring
    has it. a < 0: it lags more while the torque grows, as friction behind the torque's measurement has it.
    """

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Both elements; see :meth:`Effect.columns`."""
        return by_run(signals, lambda run: _slipped(self.start(nonlinear), run, nonlinear)[0])

    def start(self, nonlinear: Values) -> State:
        """No torque yet; the elements are relaxed."""
        return None, (0.0,) * len(nonlinear)

    def step(self, state: State, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """Let the elements follow the torque; see :meth:`Effect.step`."""
        elements, state = _slipped(state, signals, nonlinear)
        return np.asarray(elements @ coefficients), state

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Pairs of torques over which the elements stick [N m]."""
        reach = [fraction * signals.rated_torque for fraction in _FRACTIONS]
        return Starts.grid((one, two) for index, one in enumerate(reach) for two in reach[index + 1 :])


def _slipped(state: State, signals: Signals, nonlinear: Values) -> tuple[Floats, State]:
    """The elements z after every sample, shape (n, elements), and the state at the end."""
    torque = signals.torque
    if not torque.size:
        return np.empty((0, len(nonlinear))), state
    change = np.diff(torque, prepend=torque[0] if state[0] is None else state[0])
    every = [slip(z, change / reach) for z, reach in zip(state[1], nonlinear, strict=True)]
    return np.stack(every, axis=1), (float(torque[-1]), tuple(float(z[-1]) for z in every))


EFFECT = Hysteresis(
    name="hysteresis",
    cause=(
        "Friction between the teeth and in the cup's fit holds the torsion back when the torque turns round."
    ),
    kind="friction",
    frame="torque",
    needs=("torque", "run"),
    excitation=(partial(torque_reverses, fraction=_SWING),),
    remembers=True,
    broadband=True,
    quantities=(
        Quantity(
            "first_amplitude",
            "rad",
            -5e-3,
            5e-3,
            15.0 * ARCSEC,
            "a_1, half width of the first element's loop",
        ),
        Quantity("second_amplitude", "rad", -5e-3, 5e-3, 15.0 * ARCSEC, "a_2, of the second element's"),
        Quantity(
            "first_reach", "N m", 1e-2, 1e4, 2.0, "r_1, half the torque over which it sticks", linear=False
        ),
        Quantity("second_reach", "N m", 1e-2, 1e4, 10.0, "r_2, of the second element", linear=False),
    ),
    confused_with=("torsional_hardening", "wear_backlash", "coulomb_windup"),
    source=(
        "Maxwell slip: Al-Bender, Lampaert, Swevers, IEEE Trans. Automatic Control 50(11), 2005; in "
        "harmonic drives: Dhaouadi, Ghorbel, Gandhi, IEEE Trans. Industrial Electronics 50(6), 2003"
    ),
    inspect=(
        "Torsion test with the input held, up and down twice, the second time half as far: the loop's width "
        "at zero torque is twice the sum of the amplitudes (about 1 arcmin in all is usual). Screws and the "
        "fit of cup and hub first. The loop must not depend on how fast it is run through."
    ),
)
