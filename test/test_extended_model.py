"""The extended model: single samples and batches agree, and no result depends on the future."""

from dataclasses import replace

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from models import EFFECTS, OFFSET, RANGES, STATEFUL, VALUES, model, motion, term
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.drive import transmission_error
from hd_diag.effects.remainders import ORDERS
from hd_diag.extended_model import ExtendedModel, Term
from hd_diag.model.torsion_map import TorsionMap, build

Column = np.ndarray
CHUNK_TOLERANCE = 1e-12  # [rad]
EVERY = tuple(VALUES)
MODEL = model(*EVERY)
COUNT = 260
TIME, ANGLE, TORQUE, HEAT = motion(COUNT)
SPEED = np.where(np.arange(COUNT) % 3 == 0, np.nan, np.gradient(ANGLE, TIME))


@pytest.fixture(scope="module")
def table() -> TorsionMap:
    return build(MODEL.drive.mesh, 60.0)


def run(made: ExtendedModel, cuts: list[int], speed: Column | None, table: TorsionMap | None) -> Column:
    state, parts = made.start(), []
    for low, high in zip([0, *cuts], [*cuts, COUNT], strict=True):
        at = slice(low, high)
        known = None if speed is None else speed[at]
        part, state = made.step(state, TIME[at], ANGLE[at], known, TORQUE[at], HEAT[at], table)
        parts.append(part)
    return np.concatenate(parts)


def whole(made: ExtendedModel, **changed: Column | None) -> Column:
    columns = {"time": TIME, "input_angle": ANGLE, "speed": None, "torque": TORQUE, "temperature": HEAT}
    return made.step(made.start(), **(columns | changed))[0]


def assert_singles_are_the_whole(made: ExtendedModel) -> Column:
    singles = run(made, list(range(1, COUNT)), None, None)
    assert_allclose(singles, whole(made), rtol=0.0, atol=CHUNK_TOLERANCE)
    return singles


def added(name: str, **changed: Column | None) -> Column:
    return whole(model(name), **changed) - whole(model(), **changed)


@hypothesis.settings(max_examples=12)
@hypothesis.given(
    st.lists(st.integers(0, COUNT), max_size=6).map(sorted) | st.just(list(range(1, COUNT))),
    st.booleans(),
    st.booleans(),
)
def test_chunks_and_single_samples_are_the_whole(
    table: TorsionMap, cuts: list[int], reported: bool, mapped: bool
) -> None:
    used, speed = table if mapped else None, SPEED if reported else None
    found, expected = run(MODEL, cuts, speed, used), run(MODEL, [], speed, used)
    assert_allclose(found, expected, rtol=0.0, atol=CHUNK_TOLERANCE)


@pytest.mark.parametrize("name", [name for name in EFFECTS if name != "tooth_skip"])
def test_every_effect_runs(name: str) -> None:
    effect = EFFECTS[name]
    usual = {q.name: float(np.clip(q.prior_scale, q.low, q.high)) for q in effect.quantities}
    values = VALUES.get(name, usual | ({"order": 2.0} if name == "resonance" else {}))
    made = ExtendedModel(MODEL.drive, (term(name, values),), 0.0, RANGES)
    singles = assert_singles_are_the_whole(made)
    assert np.std(singles - transmission_error(MODEL.drive, ANGLE, TORQUE)) > 1e-8


@pytest.mark.parametrize("delay", [2e-3, -2e-3])
def test_a_remainder_beside_a_late_output_depends_on_no_chunk(delay: float) -> None:
    """A remainder describes the samples themselves: the delay must not carry it, nor its rate include it."""
    line = Term(ORDERS[2], tuple(np.linspace(0.3, 1.0, ORDERS[2].size)), (1e-4, -60.0, 60.0))
    late = term("stream_delay", {"delay": delay})
    made, alone = (ExtendedModel(MODEL.drive, terms, 0.0, RANGES) for terms in ((late, line), (late,)))
    singles = assert_singles_are_the_whole(made)
    beside, bare = (whole(ExtendedModel(MODEL.drive, terms, 0.0, RANGES)) for terms in ((line,), ()))
    assert_allclose((singles - whole(alone))[1:], (beside - bare)[1:], rtol=0.0, atol=1e-12)


def test_no_rows_are_no_step_and_it_needs_what_its_effects_need() -> None:
    nothing = np.empty(0)
    error, state = MODEL.step(MODEL.start(), nothing, nothing, None, nothing)
    assert (error.size, state.is_fresh) == (0, True)
    assert "temperature" in model("thermal_drift").needs
    assert model("stream_delay").needs >= {"time", "speed"}
    assert {"speed", "torque"} <= model(*STATEFUL).needs


def test_without_effects_it_is_the_drive(table: TorsionMap) -> None:
    drive, bare = MODEL.drive, ExtendedModel(MODEL.drive, (), 0.0, RANGES)
    for used in (None, table):
        error, _ = bare.step(bare.start(), TIME, ANGLE, None, TORQUE, HEAT, used)
        assert_array_equal(error, transmission_error(drive, ANGLE, TORQUE, used))
    assert_array_equal(whole(model()), transmission_error(drive, ANGLE, TORQUE) + OFFSET)


@pytest.mark.parametrize("reported", [None, SPEED], ids=["angles", "reported"])
def test_speed_is_as_reported_or_else_of_the_last_two_angles(reported: Column | None) -> None:
    difference = np.concatenate(([0.0], np.diff(ANGLE) / np.diff(TIME)))
    speed = difference if reported is None else np.where(np.isfinite(reported), reported, difference)
    forward = speed * np.sign(MODEL.drive.kinematics.ratio) / 100.0
    friction, exponent = VALUES["viscous_windup"].values()
    more = friction * np.sign(forward) * np.abs(forward) ** exponent
    expected = transmission_error(MODEL.drive, ANGLE, TORQUE + more) + OFFSET
    assert_allclose(whole(model("viscous_windup"), speed=reported), expected, rtol=0.0, atol=1e-15)


def test_torques_add_up_in_the_mesh() -> None:
    names = "torque_offset", "viscous_windup"
    more = VALUES["torque_offset"]["offset"]
    both, alone = whole(model(*names)), whole(model(names[1]), torque=TORQUE + more)
    assert_allclose(both, alone, rtol=0.0, atol=1e-15)
    assert np.abs(added(names[0]) + added(names[1]) - (both - whole(model()))).max() > 1e-7


@pytest.mark.parametrize("delay", [VALUES["stream_delay"]["delay"], 6.3e-3])
def test_delay_looks_back(delay: float) -> None:
    """The output comes from the delayed moment, interpolated between samples known at that time."""
    ratio, given = MODEL.drive.kinematics.ratio, {"delay": delay}
    made = replace(MODEL, effects=(term("stream_delay", given),))
    time, torque = 1e-3 * np.arange(COUNT), np.full(COUNT, 10.0)
    now, then = (40.0 * moment + 3.0 for moment in (time, time - delay))
    columns = {"time": time, "input_angle": now, "torque": torque}
    late = whole(made, **columns) - whole(model(), **columns)
    before, after = (angle / ratio + transmission_error(MODEL.drive, angle, torque) for angle in (now, then))
    expected = after - before
    # Teeth pass faster than these samples: interpolation misses 0.1 arcsec.
    assert_allclose(late[10:], expected[10:], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("heat", [None, np.full(COUNT, np.nan)], ids=["none", "nan"])
def test_without_a_temperature_there_is_no_drift(heat: Column | None) -> None:
    assert_array_equal(added("thermal_drift", temperature=heat), np.zeros(COUNT))


def test_a_resonance_of_a_joint_that_is_met_in_motion_starts_steady() -> None:
    """At constant speed the amplitude is the steady state's from the second sample on."""
    time = 1e-3 * np.arange(COUNT)
    angle = 25.0 * time + 4.0
    columns = {"time": time, "input_angle": angle, "torque": np.full(COUNT, 10.0)}
    own = replace(model(), effects=(term("resonance", VALUES["resonance"] | {"carried": 0.0}),))
    wave = (whole(own, **columns) - whole(model(), **columns))[1:]
    phase = 2.0 * angle[1:]
    fit, rest, *_ = np.linalg.lstsq(np.stack((np.cos(phase), np.sin(phase)), 1), wave, rcond=None)
    r, values = 2.0 * 25.0 / 60.0, VALUES["resonance"]
    damped = 2j * values["damping"] * r
    response = (1.0 + damped) / (1.0 - r * r + damped)
    assert_allclose(np.hypot(*fit), values["amplitude"] * abs(response), rtol=2e-3)
    assert rest < 1e-6 * np.sum(wave**2)


def test_a_sample_without_prediction_spoils_no_later_one() -> None:
    error = whole(model("stream_delay"), torque=np.where(np.arange(COUNT) == 100, np.nan, TORQUE))
    assert np.isnan(error[100])
    assert np.isfinite(np.delete(error, 100)).all()
