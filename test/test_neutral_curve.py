"""Neutral layer: known by its arc length."""

import drives
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from reference import polyline
from scipy.integrate import quad

from hd_diag.model.neutral_curve import NeutralCurve, neutral_curve, tooth_axes

PAPER = neutral_curve(drives.PAPER.semi_major, drives.PAPER.semi_minor)
Array = polyline.Array


def feet(curve: NeutralCurve, u: Array) -> tuple[Array, Array]:
    """Foot points (2, n) [m] and normals (2, n) from what tooth_axes gives."""
    angle, height, offset = tooth_axes(curve, u)
    normal = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-normal[1], normal[0]])
    return height * normal + offset * across, normal


def test_paper_s_curve_is_as_long_as_a_circle_of_30_mm_kept_and_cannot_be_changed() -> None:
    assert_allclose(PAPER.radius, 29.99996e-3, atol=5e-9)
    assert neutral_curve(drives.PAPER.semi_major, drives.PAPER.semi_minor) is PAPER
    with pytest.raises(ValueError, match="read-only"):
        PAPER.harmonics[0] = 0.0


@given(st.floats(1e-3, 1.0), st.floats(0.801, 1.0), st.floats(-10.0, 10.0))
@settings(max_examples=40)
def test_arc_length_is_the_integral_of_the_speed(major: float, slender: float, u: float) -> None:
    curve = neutral_curve(major, slender * major)
    speed = lambda t: np.hypot(major * np.sin(t), slender * major * np.cos(t))  # noqa: E731
    x, y = feet(curve, np.array([u]))[0][:, 0]
    parameter = u + np.angle(np.exp(1j * (np.arctan2(y / slender, x) - u)))  # within half a turn of u
    length, _ = quad(speed, 0, parameter, epsabs=1e-15, epsrel=1e-13, limit=200)
    assert_allclose(length, curve.radius * u, atol=1e-12 * major)


@pytest.mark.parametrize("drive", drives.DRIVES.values(), ids=drives.DRIVES)
def test_feet_and_normals_are_the_reference_s(drive: polyline.Drive) -> None:
    curve = neutral_curve(drive.semi_major, drive.semi_minor)
    u = np.linspace(-7, 9, 331)
    point, normal = feet(curve, u)
    expected = polyline.neutral_point(polyline.ring_radius(drive) * u, drive)
    assert_allclose(point, expected[0], atol=1e-15)
    assert_allclose(normal, expected[1], atol=1e-13)


def test_axes_turn_on_with_every_turn_and_are_symmetrical_about_both_axes() -> None:
    u = np.linspace(0.01, 1.5, 31)
    angle, height, offset = tooth_axes(PAPER, u)
    for turns in (-3, 1, 5):
        later = tooth_axes(PAPER, u + 2 * np.pi * turns)
        assert_allclose(later[0], angle + 2 * np.pi * turns, rtol=1e-14)
        assert_allclose(later[1:], [height, offset], atol=1e-16)
    for mirrored, start in ((-u, 0.0), (np.pi - u, np.pi)):
        other = tooth_axes(PAPER, mirrored)
        assert_allclose(other[0], start - angle, atol=1e-14)
        assert_allclose(other[1:], [height, -offset], atol=1e-16)


@pytest.mark.parametrize(
    ("major", "minor"), [(0.03, 0.031), (0.03, 0.023), (0.03, 0.0), (-0.03, -0.031), (float("nan"), 0.03)]
)
def test_refuses_axes_that_are_no_flexspline_s(major: float, minor: float) -> None:
    with pytest.raises(ValueError, match=r"semi_major .* at least semi_minor .* no more than 20 %"):
        neutral_curve(major, minor)
