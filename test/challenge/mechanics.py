"""Mechanics outside the mesh: joints, slip elements, friction, springs, an oscillator, a warming housing."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import cont2discrete, lfilter

from challenge.design import Array


def universal_joint(angle: Array, bend: float, direction: float) -> Array:
    """Driven shaft's angle [rad] of a universal joint; ``bend`` is the angle between the shafts [rad]."""
    a = angle - direction
    driven = np.arctan2(np.sin(a) * np.cos(bend), np.cos(a))
    return angle + np.angle(np.exp(1j * (driven - a)))


def play(x: Array, width: float) -> Array:
    """Output of a dead band that follows x, as a pin in a wide slot; it begins in the middle."""
    half, at = width / 2, float(x[0])
    out = np.empty_like(x)
    for i, target in enumerate(x.tolist()):
        at = min(max(at, target - half), target + half)
        out[i] = at
    return out


def slip_spring(torque: Array, stiffness: float, elements: tuple[tuple[float, float], ...]) -> Array:
    """Deflection [rad] under a torque (n,) [N m] of a spring parallel to elements (stiffness, slip torque).

    Each (Jenkins) element is a spring in series with a slider that gives way at its slip torque. The torque
    balance of every sample is solved for the deflection, then the sliders move as far as they slip.
    """
    slider = [0.0] * len(elements)
    phi, out = 0.0, np.empty_like(torque)
    for n, load in enumerate(torque.tolist()):
        for _ in range(20):
            moment, slope = stiffness * phi, stiffness
            for (k, slip), s in zip(elements, slider, strict=True):
                spring = k * (phi - s)
                if abs(spring) < slip:
                    moment, slope = moment + spring, slope + k
                else:
                    moment += slip if spring > 0 else -slip
            step = (load - moment) / slope
            phi += step
            if abs(step) < 1e-13:
                break
        for i, (k, slip) in enumerate(elements):
            slider[i] = min(max(slider[i], phi - slip / k), phi + slip / k)
        out[n] = phi
    return out


def rubbing(angle: Array, time: Array, presliding: float, relaxation: float) -> Array:
    """State (n,) in −1..1 of a bristle that motion bends and vibration relaxes: a Dahl model with creep.

    ``presliding`` is the travel that bends it [rad]; ``relaxation`` the time constant at rest [s].
    """
    way, dt = np.diff(angle, prepend=angle[0]), np.diff(time, prepend=time[0])
    rate = np.abs(way) / presliding + np.abs(dt) / relaxation
    aim = np.divide(way / presliding, rate, out=np.zeros_like(rate), where=rate > 0)
    keep = np.exp(-rate)
    z, out = 0.0, np.empty_like(angle)
    for n, (target, factor) in enumerate(zip(aim.tolist(), keep.tolist(), strict=True)):
        z = target + (z - target) * factor
        out[n] = z
    return out


def spring(torque: Array, knees: tuple[float, ...], compliances: tuple[float, ...]) -> Array:
    """Deflection [rad] of a symmetric spring, rigid below its first knee.

    ``compliances`` [rad/(N m)] add up: each applies above its knee [N m].
    """
    load = np.linspace(0, max(1.0, float(np.abs(torque).max())), 20_001)
    step = np.searchsorted(knees, load, side="right")
    compliance = np.r_[0, np.cumsum(compliances)][step]
    deflection = cumulative_trapezoid(compliance, load, initial=0)
    return np.sign(torque) * np.interp(np.abs(torque), load, deflection)


def beyond_spring(error: Array, step: float, frequency: float, damping: float) -> Array:
    """Motion (n,) of an inertia behind a spring and damper whose other end moves by error (n,).

    x'' + 2 z w (x' − y') + w² (x − y) = 0, solved exactly for an error that is linear between samples.
    """
    w = 2 * np.pi * frequency
    numerator, denominator, _ = cont2discrete(
        ([2 * damping * w, w**2], [1, 2 * damping * w, w**2]), step, method="foh"
    )
    return lfilter(numerator.ravel(), denominator, error - error[0]) + error[0]


def warming(time: Array, ambient: float, rise: float, constant: float) -> Array:
    """Temperature [°C] of a first-order body that starts at ambient and is heated with constant power."""
    return ambient + rise * -np.expm1(-time / constant)


def elasto_plastic(angle: Array, presliding: float, stick: float) -> Array:
    """State (n,) in −1..1 of a bristle that bends elastically before it slips, and stays bent at rest.

    Dupont, Hayward, Armstrong, Altpeter, IEEE Trans. Automatic Control 47(5), 2002, eq. 5-9. The bristle does
    not slip while |state| is at most ``stick``. ``presliding`` is the travel that bends it [rad].
    """
    z, out = 0.0, np.empty_like(angle)
    for n, way in enumerate((np.diff(angle, prepend=angle[0]) / presliding).tolist()):
        if abs(way) > 8:
            z = np.sign(way)
        else:
            steps = int(4 * abs(way)) + 1
            for _ in range(steps):
                z += way / steps * (1 - _slipping(z, way, stick) * abs(z))
        out[n] = z
    return out


def _slipping(z: float, way: float, stick: float) -> float:
    if z * way <= 0 or abs(z) <= stick:
        return 0.0
    return 0.5 + 0.5 * math.sin(math.pi * (min(abs(z), 1.0) - (1 + stick) / 2) / (1 - stick))


def bouc_wen(torque: Array, reach: float, sharpness: float) -> Array:
    """State (n,) in −1..1 of Bouc and Wen's smooth hysteresis.

    dz = dT/r (1 − |z|^n) while dT drives z away from zero, else dT/r; r: ``reach`` [N m], n: ``sharpness``.
    Wen, J. Eng. Mech. Div. ASCE 102(2), 1976, with beta = gamma = 1/2.
    """
    z, out = 0.0, np.empty_like(torque)
    for n, way in enumerate((np.diff(torque, prepend=torque[0]) / reach).tolist()):
        steps = int(4 * abs(way)) + 1
        for _ in range(steps):
            z += way / steps * (1 - (abs(z) ** sharpness if z * way > 0 else 0.0))
            z = min(max(z, -1.0), 1.0)
        out[n] = z
    return out


def slipping_elements(torque: Array, reaches: Array, weights: Array) -> Array:
    """Weighted sum (n,) of the states −1..1 of many elements; each slips after its reach [N m].

    Generalised Maxwell slip: Al-Bender, Lampaert, Swevers, IEEE Trans. Automatic Control 50(11), 2005.
    """
    z, out = np.zeros(len(reaches)), np.empty_like(torque)
    for n, change in enumerate(np.diff(torque, prepend=torque[0]).tolist()):
        z = np.minimum(np.maximum(z + change / reaches, -1.0), 1.0)
        out[n] = weights @ z
    return out


def lagging(values: Array, time: Array, constant: float) -> Array:
    """Values (n,) through a first-order lag with a time constant [s], settled at the start."""
    keep = np.exp(-float(np.median(np.diff(time))) / constant)
    return lfilter([1 - keep], [1, -keep], values - values[0]) + values[0]
