"""A plain version of the paper's method for one moment: a search per tooth pair, recursion over loaded pairs.

Dong, Chen, Wang, Dong, "Kinematic Model of Harmonic Drive in Robot Joints with Input Eccentricity Error",
ROMANSY 22, 2019, doi 10.1007/978-3-319-78963-7_18. A one-dimensional search along the flank gives each tooth
pair's backlash (section 3). The loaded pairs follow by iteration until none is added or released (eq. 8).
Quantities common to all pairs are computed once. The module imports nothing of hd_diag. SI units, angles
counter-clockwise, origin on the circular spline's axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from scipy.optimize import brentq, minimize_scalar
from scipy.special import ellipe, ellipeinc

SAMPLES = 24  # along a flank, before the search
STEP = 1e-8  # for numerical slopes [m]
PRECISION = 1e-13  # of the search [m]


@dataclass(frozen=True)
class Flank:
    """Double circular arc: radii and centres of the outer and the inner arc [m], with x outward."""

    outer_radius: float
    inner_radius: float
    outer_center: tuple[float, float]
    inner_center: tuple[float, float]

    @cached_property
    def tangent(self):
        """Normal direction of the common tangent [rad], and the heights where it meets the arcs [m]."""
        dx = self.inner_center[0] - self.outer_center[0]
        dy = self.inner_center[1] - self.outer_center[1]
        normal = math.atan2(dy, dx) - math.acos((self.outer_radius + self.inner_radius) / math.hypot(dx, dy))
        low = self.inner_center[0] - self.inner_radius * math.cos(normal)
        high = self.outer_center[0] + self.outer_radius * math.cos(normal)
        return normal, low, high


@dataclass(frozen=True)
class Gear:
    """The paper's example, with the two lengths that the paper does not print."""

    tooth: Flank = Flank(0.2031e-3, 0.5046e-3, (0.7625e-3, -0.0548e-3), (0.6929e-3, 0.6557e-3))
    slot: Flank = Flank(0.2313e-3, 0.4357e-3, (1.2201e-3, -0.0782e-3), (1.2791e-3, 0.5886e-3))
    root: float = 0.4e-3
    tip: float = 0.8519e-3
    semi_major: float = 30.2584e-3
    semi_minor: float = 29.7404e-3
    flexspline_teeth: int = 200
    circular_spline_teeth: int = 202
    datum: float = 29.868e-3
    slot_tip_radius: float = 30.7755e-3
    compliance: float = 1e-6

    @cached_property
    def modulus(self):
        """Parameter m of the ellipse for scipy's elliptic integrals."""
        return 1.0 - (self.semi_minor / self.semi_major) ** 2

    @cached_property
    def quarter(self):
        """Complete elliptic integral: a quarter of the neutral curve's length over its long semi-axis."""
        return float(ellipe(self.modulus))

    @cached_property
    def wall_joints(self):
        """Distances from the axis at which the slot's arcs meet their common tangent [m]."""
        flank = self.slot
        normal, low, high = flank.tangent
        inner = math.hypot(self.datum + low, flank.inner_center[1] - flank.inner_radius * math.sin(normal))
        outer = math.hypot(self.datum + high, flank.outer_center[1] + flank.outer_radius * math.sin(normal))
        return inner, outer


@dataclass(frozen=True)
class Pair:
    """One flank of a tooth pair: tooth, side, closing rotation [rad], radius and lever arm [m]."""

    tooth: int
    side: float
    rotation: float
    radius: float
    lever: float


def tooth_height(flank, x):
    """Half width of the tooth [m] at height x [m]."""
    normal, low, high = flank.tangent
    if x <= low:
        center, radius = flank.inner_center, flank.inner_radius
        return center[1] - math.sqrt(radius**2 - (x - center[0]) ** 2)
    center, radius = flank.outer_center, flank.outer_radius
    if x >= high:
        return center[1] + math.sqrt(radius**2 - (x - center[0]) ** 2)
    start = center[1] + radius * math.sin(normal)
    return start - (x - high) / math.tan(normal)


def wall_angle(gear, radius):
    """Polar angle of the slot's + wall [rad] at a distance from the axis [m]."""
    flank = gear.slot
    inner, outer = gear.wall_joints
    if inner < radius < outer:
        normal = flank.tangent[0]
        x, y = flank.outer_center[0] + gear.datum, flank.outer_center[1]
        distance = x * math.cos(normal) + y * math.sin(normal) + flank.outer_radius
        return normal - math.acos(distance / radius)
    if radius <= inner:
        center, arc, side = flank.inner_center, flank.inner_radius, -1.0
    else:
        center, arc, side = flank.outer_center, flank.outer_radius, 1.0
    x, y = center[0] + gear.datum, center[1]
    far = math.hypot(x, y)
    return math.atan2(y, x) + side * math.acos((far**2 + radius**2 - arc**2) / (2.0 * far * radius))


def neutral_point(gear, arc):
    """Point of the neutral layer and its outward normal at an arc length from the long axis (eq. 1)."""
    radius = 2.0 / math.pi * gear.semi_major * gear.quarter

    def excess(t):
        return gear.semi_major * (ellipeinc(t - math.pi / 2, gear.modulus) + gear.quarter) - arc

    t = arc / radius
    t = brentq(excess, t - 0.1, t + 0.1, xtol=1e-15, rtol=1e-15)
    x, y = gear.semi_minor * math.cos(t), gear.semi_major * math.sin(t)
    length = math.hypot(x, y)
    return (gear.semi_major * math.cos(t), gear.semi_minor * math.sin(t)), (x / length, y / length)


def pose(gear, tooth, turn, eccentricity):
    """Foot point and direction of a tooth's axis in the housing (eqs. 2-7)."""
    z_r, z_g = gear.flexspline_teeth, gear.circular_spline_teeth
    radius = 2.0 / math.pi * gear.semi_major * gear.quarter
    cup = -turn * (z_g - z_r) / z_r
    (x, y), (nx, ny) = neutral_point(gear, radius * (cup + 2.0 * math.pi * tooth / z_r - turn))
    c, s = math.cos(turn), math.sin(turn)
    foot = (c * x - s * y + eccentricity.real, s * x + c * y + eccentricity.imag)
    return foot, (c * nx - s * ny, s * nx + c * ny)


def flank_pair(gear, tooth, side, foot, axis):
    """Closing rotation of one flank, by a search along it; None if the flank does not reach the slots."""
    pitch = 2.0 * math.pi / gear.circular_spline_teeth
    middle = 0.5 * (gear.root + gear.tip)
    slot = pitch * round(math.atan2(foot[1] + middle * axis[1], foot[0] + middle * axis[0]) / pitch)
    c, s = math.cos(slot), math.sin(slot)

    def polar(x):
        """Distance of the flank from the axis, and its angle from the slot's axis, at height x."""
        y = side * tooth_height(gear.tooth, x)
        px, py = foot[0] + x * axis[0] - y * axis[1], foot[1] + x * axis[1] + y * axis[0]
        return math.hypot(px, py), side * math.atan2(c * py - s * px, c * px + s * py)

    def gap(x):
        radius, angle = polar(x)
        return wall_angle(gear, radius) - angle

    if polar(gear.tip)[0] <= gear.slot_tip_radius:
        return None
    first = brentq(lambda x: polar(x)[0] - gear.slot_tip_radius, gear.root, gear.tip, xtol=1e-16)
    x = searched(gap, first, gear.tip)
    radius = polar(x)[0]
    if gear.tip - x < 10.0 * STEP or x - first >= 10.0 * STEP:
        slope = (wall_angle(gear, radius + STEP) - wall_angle(gear, radius - STEP)) / (2.0 * STEP)
    else:  # the slot's corner touches the tooth's flank
        (r_0, a_0), (r_1, a_1) = polar(x - STEP), polar(x + STEP)
        slope = (a_1 - a_0) / (r_1 - r_0)
    return Pair(tooth, side, gap(x), radius, radius / math.hypot(1.0, radius * slope))


def searched(gap, low, high):
    """Place of the smallest gap: samples, then a bounded search around the best one, ends included."""
    step = (high - low) / SAMPLES
    places = [low + k * step for k in range(SAMPLES + 1)]
    values = [gap(place) for place in places]
    best = min(range(SAMPLES + 1), key=values.__getitem__)
    bounds = places[max(0, best - 1)], places[min(SAMPLES, best + 1)]
    found = minimize_scalar(gap, bounds=bounds, method="bounded", options={"xatol": PRECISION})
    return min((found.x, *bounds), key=gap)


def pairs(gear, turn, eccentricity):
    """All tooth pairs that can touch, both flanks."""
    found = []
    for tooth in range(gear.flexspline_teeth):
        foot, axis = pose(gear, tooth, turn, eccentricity)
        found += [flank_pair(gear, tooth, side, foot, axis) for side in (1.0, -1.0)]
    return [pair for pair in found if pair is not None]


def torsion(gear, found, torque, bearing=None, depth=0):
    """Torsion and loaded pairs. Pairs loaded at one torsion give the next one, until they stay (eq. 8)."""
    if bearing is None:
        bearing = [pair for pair in found if pair.side * torque > 0.0]
    stiffness = sum(pair.lever**2 for pair in bearing) / gear.compliance
    moment = sum(pair.lever**2 * pair.side * pair.rotation for pair in bearing) / gear.compliance
    beta = (torque + moment) / stiffness
    loaded = [pair for pair in found if pair.side * beta > pair.rotation]
    if loaded == bearing or depth > 100:
        return beta, loaded
    return torsion(gear, found, torque, loaded, depth + 1)


def one_moment(gear, turn, eccentricity, torque):
    """Torsion [rad], and backlash [m] and force [N] of every pair that can touch, by (tooth, side)."""
    found = pairs(gear, turn, eccentricity)
    beta, loaded = torsion(gear, found, torque)
    backlash = {(pair.tooth, pair.side): pair.radius * pair.rotation for pair in found}
    force = {
        (pair.tooth, pair.side): pair.lever * (pair.side * beta - pair.rotation) / gear.compliance
        for pair in loaded
    }
    return beta, backlash, force
