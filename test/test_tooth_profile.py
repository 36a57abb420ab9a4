"""Flank of two arcs and their common tangent."""

import dataclasses
import math

import drives
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from reference import polyline

from hd_diag.model.tooth_profile import DoubleArc

TOOTH, SLOT = (drives.double_arc(profile) for profile in (drives.PAPER.tooth, drives.PAPER.slot))


@pytest.mark.parametrize(("flank", "degrees"), [(TOOTH, 1.962), (SLOT, 9.915)])
def test_inclination_of_the_common_tangent(flank: DoubleArc, degrees: float) -> None:
    # The paper's table has 9.88 deg for the slot, and 3.99 deg for the tooth, which its arcs do not give.
    assert_allclose(90 - math.degrees(flank.normal_angle), degrees, atol=5e-4)


@pytest.mark.parametrize("profile", [drives.PAPER.tooth, drives.PAPER.slot])
def test_half_width_is_the_reference_flank_s(profile: polyline.Profile) -> None:
    flank = drives.double_arc(profile)
    start = flank.dedendum_center[0] - 0.9 * flank.dedendum_radius
    end = flank.addendum_center[0] + 0.9 * flank.addendum_radius
    x, y = polyline._flank(profile, start, end, 1600)
    assert_allclose([flank.half_width(height) for height in x], y, rtol=0, atol=1e-15)


arcs = st.builds(
    DoubleArc,
    st.floats(0.05, 1.0),
    st.floats(0.05, 1.0),
    st.tuples(st.floats(-0.2, 1.0), st.floats(-1.0, 0.0)),
    st.tuples(st.floats(-0.2, 1.0), st.floats(0.1, 1.5)),
)


@given(arcs)
@settings(max_examples=100)
def test_tangent_touches_both_arcs(flank: DoubleArc) -> None:
    apart = math.dist(flank.addendum_center, flank.dedendum_center)
    assume(apart > 1.001 * (flank.addendum_radius + flank.dedendum_radius))
    normal, outer, inner = (np.array(v) for v in (flank.normal, flank.addendum_joint, flank.dedendum_joint))
    assert_allclose(normal @ normal, 1, rtol=1e-14)
    assert_allclose(outer - flank.addendum_center, flank.addendum_radius * normal, atol=1e-14)
    assert_allclose(flank.dedendum_center - inner, flank.dedendum_radius * normal, atol=1e-14)
    assert_allclose(normal @ (outer - inner), 0, atol=1e-13)


def test_flank_ends_where_its_arcs_end_and_overlapping_arcs_have_no_tangent() -> None:
    past_tip = TOOTH.addendum_center[0] + TOOTH.addendum_radius + 1e-9
    below_root = TOOTH.dedendum_center[0] - TOOTH.dedendum_radius - 1e-9
    assert np.isnan([TOOTH.half_width(past_tip), TOOTH.half_width(below_root)]).all()
    overlapping = dataclasses.replace(TOOTH, addendum_radius=0.6e-3)
    with pytest.raises(ValueError, match=r"arcs overlap.*radii add up to 0\.0011046 m"):
        _ = overlapping.normal_angle
