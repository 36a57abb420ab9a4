"""Friction in the teeth and the cup: the torsion depends on where the torque came from."""

from __future__ import annotations

from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Starts, Stepped, Values
from hd_diag.effects.excitation import torque_reverses
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.recursions import bend, slip
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

_BENDING, _SLIPPING = (0.06, 0.15, 0.4), (0.03, 0.09, 0.25)  # start reaches over the rated torque
_ELEMENTS = np.linspace(-1.0, 1.0, 4)  # exponent of the spread for each slip element
_AGAINST = 0.5  # ratio of opposed amplitudes below which the smaller one only bends the loop
_SWING = 0.1  # least reversal of the torque over the rated torque

# Last torque [N m], None before the first sample; state z of the bend, states z of the elements.
State = tuple[float | None, float, tuple[float, ...]]


class Hysteresis(Effect):
    """``a_1 z_1 + a_2 z_2``: a spring that yields smoothly, and elements that slip one after the other.

    The first follows Bouc and Wen: ``dz_1 = dT / r_1 (1 - |z_1|^n)`` while the torque continues in its
    direction, ``dT / r_1`` on the way back. The second is a Maxwell slip model: the mean of elements ``z <-
    clip(z + dT / r, -1, 1)`` with r from ``r_2 / s`` to ``r_2 s``. With a > 0 the link lags less while the
    torque grows and more while it falls: friction beside the spring. With a < 0 it lags more while the
    torque grows: friction between the spring and the torque sensor.
    """

    def sensible(self, coefficients: Floats, nonlinear: Values) -> bool:
        """Whether bend and elements form one loop; opposed to each other, they filter the torque's noise."""
        first, second = coefficients.tolist()
        less, more = sorted((abs(first), abs(second)))
        return bool(first * second >= 0.0 or less < _AGAINST * more)

    def start(self, nonlinear: Values) -> State:
        """No torque yet; bend and elements are relaxed."""
        return None, 0.0, (0.0,) * _ELEMENTS.size

    def advance(self, state: State, signals: Signals, nonlinear: Values) -> Stepped:
        """Update the bend and the elements, which are averaged; see :meth:`Effect.advance`."""
        torque = signals.torque
        if not torque.size:
            return np.empty((0, 2)), state
        bending, sharpness, slipping, spread = nonlinear
        change = np.diff(torque, prepend=torque[0] if state[0] is None else state[0])
        bent = bend(state[1], change / bending, sharpness)
        reaches = slipping * spread**_ELEMENTS
        every = [slip(z, change / reach) for z, reach in zip(state[2], reaches, strict=True)]
        last = float(torque[-1]), float(bent[-1]), tuple(float(z[-1]) for z in every)
        return np.stack((bent, sum(every) / len(every)), axis=1), last

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Grid of reaches [N m], sharpness and spread."""
        rated = signals.rated_torque
        return Starts.grid(
            (one * rated, sharpness, two * rated, spread)
            for one in _BENDING
            for two, sharpness, spread in zip(_SLIPPING, (1.0, 2.0, 1.5), (1.2, 3.0, 2.0), strict=True)
        )


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
            "bending_amplitude", "rad", -5e-3, 5e-3, 15.0 * ARCSEC, "a_1, half width of the bend's loop"
        ),
        Quantity("slipping_amplitude", "rad", -5e-3, 5e-3, 15.0 * ARCSEC, "a_2, of the elements'"),
        Quantity("bending_reach", "N m", 1e-2, 1e4, 5.0, "r_1, torque that bends it", False, least=0.3),
        Quantity("sharpness", "-", 0.5, 5.0, 1.5, "n, of its giving way", linear=False, shape=True),
        Quantity(
            "slipping_reach",
            "N m",
            1e-2,
            1e4,
            5.0,
            "r_2, half the torque over which they stick",
            linear=False,
            least=0.3,  # smaller reaches lie within the torque's noise
        ),
        Quantity(
            "spread", "-", 1.0, 8.0, 2.0, "s, of the elements' torques about it", linear=False, shape=True
        ),
    ),
    confused_with=("torsional_hardening", "wear_backlash", "coulomb_windup"),
    source=(
        "Wen, J. Eng. Mech. Div. ASCE 102(2), 1976; Maxwell slip: Al-Bender, Lampaert, Swevers, IEEE Trans. "
        "Automatic Control 50(11), 2005; in harmonic drives: Dhaouadi, Ghorbel, Gandhi, IEEE Trans. "
        "Industrial Electronics 50(6), 2003"
    ),
    inspect=(
        "Torsion test with the input held, up and down twice, the second time half as far: the loop's width "
        "at zero torque is twice the sum of the amplitudes (about 1 arcmin in all is usual). Screws and the "
        "fit of cup and hub first. The loop must not depend on how fast it is run through."
    ),
)
