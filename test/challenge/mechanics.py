"""Mechanics beside the mesh: joints, slip elements, friction, springs, an oscillator, a warming housing."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import cont2discrete, lfilter

from challenge.clearances import Array


def universal_joint(angle: Array, bend: float, direction: float) -> Array:
    """Angle of the driven shaft [rad] of a universal joint whose shafts enclose an angle bend [rad]."""
    a = angle - direction
    driven = np.arctan2(np.sin(a) * np.cos(bend), np.cos(a))
    return np.asarray(angle + np.angle(np.exp(1j * (driven - a))), dtype=np.float64)


def play(x: Array, width: float) -> Array:
    """What follows x through a dead band of a width, as a pin in a wide slot; it begins in the middle."""
    half, at = width / 2, float(x[0])
    out = np.empty_like(x)
    for i, target in enumerate(x.tolist()):
        at = min(max(at, target - half), target + half)
        out[i] = at
    return out


def slip_spring(torque: Array, stiffness: float, elements: tuple[tuple[float, float], ...]) -> Array:
    """Deflection [rad] under a torque (n,) [N m] of a spring beside elements (stiffness, slip torque).

    Each (Jenkins) element is a spring behind a slider that gives way at its slip torque. The torque balance
    of every sample is solved for the deflection; the sliders stay where it leaves them.
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

    Bent fully after a way of presliding [rad]; at rest it straightens within relaxation [s].
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
    """Deflection [rad] of a symmetric spring whose compliance [rad/(N m)] steps at knees [N m]; 0 below."""
    load = np.linspace(0, max(1.0, float(np.abs(torque).max())), 20_001)
    step = np.searchsorted(knees, load, side="right")
    compliance = np.r_[0, np.cumsum(compliances)][step]
    deflection = cumulative_trapezoid(compliance, load, initial=0)
    return np.asarray(np.sign(torque) * np.interp(np.abs(torque), load, deflection), dtype=np.float64)


def beyond_spring(error: Array, step: float, frequency: float, damping: float) -> Array:
    """Motion (n,) of an inertia behind a spring and damper whose other end moves by error (n,).

    x'' + 2 z w (x' − y') + w² (x − y) = 0, integrated exactly for an error that is straight between samples.
    """
    w = 2 * np.pi * frequency
    numerator, denominator, _ = cont2discrete(
        ([2 * damping * w, w**2], [1, 2 * damping * w, w**2]), step, method="foh"
    )
    return np.asarray(lfilter(numerator.ravel(), denominator, error - error[0]) + error[0], dtype=np.float64)


def warming(time: Array, ambient: float, rise: float, constant: float) -> Array:
    """Temperature [°C] of a first-order body that starts at ambient and is heated evenly."""
    return np.asarray(ambient + rise * -np.expm1(-time / constant), dtype=np.float64)
