"""Neutral curves on cams of all shapes, against quadrature, polylines and a separate contact problem."""

import functools
import math
from dataclasses import replace
from pathlib import Path

import drives
import numpy as np
import pytest
from cli_runner import config_file, hd_diag
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from reference import polyline, published
from scipy.optimize import lsq_linear
from scipy.special import ellipe, ellipeinc

from hd_diag.model.cams import Cam, Cosine, Ellipse, FourForces, Points, TwoDiscs, curve_on
from hd_diag.model.contact import contacts
from hd_diag.model.mesh import Mesh
from hd_diag.model.neutral_curve import NeutralCurve, neutral_curve, tooth_axes

ELLIPSE = Ellipse(30.2584e-3, 29.7404e-3)
W0 = published.DISPLACEMENT
R_B = polyline.RING_RADIUS
DISCS = TwoDiscs(R_B, 29.35e-3, 0.9084e-3)
COSINE, FORCES = Cosine(R_B, W0), FourForces(R_B, W0, math.radians(25.0))


def test_harmonics_of_the_ellipse_and_its_arc() -> None:
    curve = curve_on(ELLIPSE)
    assert_allclose(curve.radius, published.ELLIPSE_RADIUS, atol=5e-10)
    away = np.abs(np.subtract(curve.harmonics[:4], published.ELLIPSE_HARMONICS[:4]))
    assert np.all(away < [5e-13, 5e-13, 5e-15, 5e-15])
    a, b = ELLIPSE.semi_major, ELLIPSE.semi_minor
    mu, modulus = np.linspace(0, np.pi / 2, 50), 1 - (b / a) ** 2
    t = np.arctan2(b * np.sin(mu), a * np.cos(mu))  # parameter of the ellipse at normal mu
    length = a * (ellipe(modulus) - ellipeinc(np.pi / 2 - t, modulus))
    k = 2 * np.arange(1, len(curve.harmonics) + 1)
    arc = curve.radius * mu + np.sin(np.outer(mu, k)) @ (np.array(curve.harmonics) * (1 - k**2) / k)
    assert_allclose(arc, length, rtol=0, atol=1e-16)  # both have rounding errors
    angle, height, offset = tooth_axes(curve, length / curve.radius)
    assert_allclose(angle, mu, rtol=0, atol=1e-14)
    place = a * np.cos(t) + 1j * b * np.sin(t)
    assert_allclose((height + 1j * offset) * np.exp(1j * angle), place, atol=1e-16)


CASES = [(FourForces(R_B, W0, math.radians(d)), c) for d, c in published.FOUR_FORCES_HARMONICS.items()]


@pytest.mark.parametrize(("cam", "expected"), [(COSINE, published.COSINE_HARMONICS), *CASES])
def test_harmonics_of_displaced_rings(cam: Cam, expected: tuple[float, ...]) -> None:
    found = curve_on(cam).harmonics[: len(expected)]
    # Published to five digits or to 0.01 nm, whichever is coarser.
    assert_allclose(found, expected, rtol=5e-4, atol=6e-9)


COSINE_RING = functools.partial(polyline.cosine_ring, W0)
RING_OF_FORCES = functools.partial(polyline.four_forces_ring, W0, math.radians(25.0))


@pytest.mark.parametrize(("cam", "ring"), [(COSINE, COSINE_RING), (FORCES, RING_OF_FORCES)])
def test_backlash_on_other_cams_against_polylines(cam: Cam, ring: object) -> None:
    gear = replace(drives.PAPER, cam=ring)  # type: ignore[arg-type]
    mesh = Mesh(drives.geometry(neutral_curve=cam), eccentricity=3e-6 - 5e-6j)
    for angle in (0.0, 0.4, 2.9):
        found, expected = contacts(mesh, np.array([angle])), polyline.mesh(angle, (3e-6, -5e-6), drive=gear)
        own = expected.backlash[:, found.teeth[0]]
        away = found.rotation[0] * found.radius[0] - own
        assert np.isfinite(own).sum() > 100
        assert_allclose(away[np.isfinite(own)], 0, atol=0.03e-6)


def test_two_discs_against_a_contact_problem() -> None:
    # The ring bends as little as possible beyond the discs. Of all support functions p >= a disc's, with
    # mean R_b, its curvature radius is closest to R_b. A quarter, by finite differences.
    mu = np.linspace(0, np.pi / 2, 181)
    step, n = mu[1], mu.size
    disc = DISCS.disc_radius + DISCS.disc_offset * np.cos(mu)
    bend = np.eye(n) + (np.eye(n, k=1) + np.eye(n, k=-1) - 2 * np.eye(n)) / step**2
    bend[0, 1] = bend[-1, -2] = 2 / step**2  # symmetric about both axes
    weight = np.ones(n)
    weight[[0, -1]] = 0.5
    rows = np.vstack((np.sqrt(weight)[:, None] * bend, 1e6 * weight / weight.sum()))
    wanted = np.append(np.sqrt(weight) * (R_B - bend @ disc), 1e6 * (R_B - weight @ disc / weight.sum()))
    found = lsq_linear(rows, wanted, bounds=(0, np.inf), method="bvls", tol=1e-14).x
    curve = curve_on(DISCS)
    orders = 2 * np.arange(1, len(curve.harmonics) + 1)
    support = curve.radius + np.cos(np.multiply.outer(mu, orders)) @ np.array(curve.harmonics)
    assert_allclose(support, disc + found, rtol=0, atol=0.05e-6)
    check_layer(curve)


@pytest.mark.parametrize("center", [0.0, 4e-6 - 3e-6j])
def test_points_of_a_cam_give_its_curve(center: complex) -> None:
    curve = curve_on(ELLIPSE)
    angle, height, offset = tooth_axes(curve, 2 * np.pi * np.arange(90) / 90)
    point = (height - 1e-3 + 1j * offset) * np.exp(1j * angle) + center  # a parallel layer, off centre

    def fitted(point: np.ndarray) -> Points:
        return Points(tuple(np.column_stack((np.angle(point), np.abs(point))).ravel().tolist()), 1e-3)

    cam = fitted(point)
    assert_allclose(curve_on(cam).radius, curve.radius, rtol=0, atol=1e-14)
    assert_allclose(curve_on(cam).harmonics[:3], curve.harmonics[:3], rtol=0, atol=1e-14)
    assert max(cam.residual) < 1e-14
    noise = np.random.default_rng(5).normal(0, 1e-6, 90)
    rms, largest = fitted(point * (1 + noise / np.abs(point))).residual
    assert_allclose(rms, np.sqrt(np.mean(noise**2) * (1 - 13 / 90)), rtol=0.15)
    assert rms < largest < 4 * rms


SHAPES = st.sampled_from(("ellipse", "cosine", "four forces"))


@given(SHAPES, st.floats(0.0, 0.06), st.floats(0.0, 0.6), st.floats(1e-3, 1.0))
def test_a_curve_is_convex_or_refused(shape: str, share: float, angle: float, radius: float) -> None:
    w0 = share * radius
    made = {"ellipse": Ellipse(radius + w0, radius - w0), "cosine": Cosine(radius, w0)}
    made["four forces"] = FourForces(radius, w0, angle)
    if share <= 0.02:
        check_layer(curve_on(made[shape]))
        return
    try:
        curve = curve_on(made[shape])
    except ValueError as error:
        said = str(error)
        assert said.startswith("neutral curve")
        assert "\n" not in said
        return
    check_layer(curve)


def check_layer(curve: NeutralCurve) -> None:
    """Equal steps give equal arcs along the tangent; the curve is convex and closed."""
    u, step = 2 * np.pi * np.arange(720) / 720, 1e-4
    (before, *_), (angle, height, _), (after, *_) = (tooth_axes(curve, u + d) for d in (-step, 0, step))
    assert (after - before > 0).all()
    ends = [tooth_axes(curve, u + d) for d in (-step, step)]
    first, second = ((h + 1j * q) * np.exp(1j * a) for a, h, q in ends)
    along = (second - first) / (2 * step) / curve.radius
    assert_allclose(along, 1j * np.exp(1j * angle), atol=2e-5)
    assert_allclose(angle[360:] - angle[:360], np.pi, rtol=1e-14)
    assert_allclose(height[360:], height[:360], rtol=1e-13)


REFUSED = [
    (Ellipse(0.0297, 0.0303), "semi_major"),
    (Cosine(R_B, -1e-3), "deformation"),
    (Cosine(0.0, 1e-3), "radius"),
    (Cosine(R_B, 5e-3), "turns tooth axes"),
    (FourForces(R_B, W0, 1.0), "angle"),
    (FourForces(math.nan, W0, 0.4), "radius"),
    (TwoDiscs(R_B, 31e-3, 1e-3), "disc_radius"),
    (TwoDiscs(R_B, 29e-3, 0.5e-3), "disc_offset"),
    (TwoDiscs(R_B, 29.99e-3, 0.9e-3), "do not bear"),
    (Points((0.0,)), "points"),
    (Points(tuple(np.ravel([(0.01 * k, R_B) for k in range(40)]))), "go around"),
    (Points(tuple(np.ravel([(0.2 * k, -R_B) for k in range(40)]))), "positive"),
]


@pytest.mark.parametrize(("cam", "message"), REFUSED)
def test_what_is_no_cam(cam: Cam, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        curve_on(cam)
    assert "\n" not in str(error.value)


def test_a_dent_is_not_convex() -> None:
    with pytest.raises(ValueError, match=r"not convex; its radius of curvature is -0\.003 m at 0 degrees"):
        neutral_curve(R_B, (*[0.0] * 7, 33e-3 / (16**2 - 1)))


def test_check_tells_how_far_measured_points_are_off(tmp_path: Path) -> None:
    """Points of the ellipse, alternately 1 µm outwards and inwards, which no cam's harmonics can follow."""
    angle, a, b = 2.0 * np.pi / 72 * np.arange(72), ELLIPSE.semi_major, ELLIPSE.semi_minor
    radius = a * b / np.hypot(b * np.cos(angle), a * np.sin(angle)) + 1e-6 * (-1.0) ** np.arange(72)
    points = np.column_stack((angle, radius)).ravel().tolist()
    config = config_file(tmp_path, neutral_curve__shape="points", neutral_curve__points=points)
    assert "off the fitted curve by 1 µm rms" in hd_diag("check", config).stdout
