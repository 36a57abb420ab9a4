"""All joints while they run: their publications, and unusable samples."""

import numpy as np
import pytest
from live import MS, OTHER_TWO, START, TWO, config, map_of_two, states
from numpy.testing import assert_array_equal

from hd_diag.config.configuration import ConfigError
from hd_diag.drive import transmission_error
from hd_diag.messages.publications import encode
from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.publications import Angles, Drawings, ToothArrays
from hd_diag.replay.map_builder import map_of
from hd_diag.streams.columns import JointStates

SAME = "; where stamps stay the same, `stamp: reception` takes the time of reception"


ERROR = "~/transmission_error"


def run(monitor: Monitor, given: JointStates, topic: str = "") -> list:
    published = monitor.mixed_states(START + np.arange(given.stamp.size), (given,))
    return [each for each in published if topic in ("", each.topic)]


def test_residual_needs_an_output_angle() -> None:
    published = run(Monitor(TWO), states(("a_motor", "b_motor", "b"), [START], [[0.1, 0.2, 0.0]]))
    names = {each.topic: each.names for each in published if isinstance(each, Angles)}
    assert names == {ERROR: ("a", "b"), "~/measured_transmission_error": ("b",), "~/residual": ("b",)}


def test_arrays_and_drawings_come_at_their_rates_by_stamps() -> None:
    monitor = Monitor(config("a", array_rate=20.0, mesh_rate=4.0))
    published = []
    for i in range(1000):
        published += run(monitor, states(("a_motor",), [START + i * MS], [[0.001 * i]]))
    backlash = [p for p in published if isinstance(p, ToothArrays) and p.topic.endswith("backlash")]
    drawings = [p for p in published if isinstance(p, Drawings)]
    assert [int(p.received[0]) - START for p in backlash] == [0] * 20
    assert [int(p.stamp[0]) - START for p in drawings] == [250 * MS * k for k in range(4)]
    made = states(("a_motor",), START + MS * np.arange(30), np.zeros((30, 1)))
    for rate, number in ((0.0, 0), (1000.0, 60)):
        published = run(Monitor(config("a", array_rate=rate)), made)
        assert sum(p.received.size for p in published if isinstance(p, ToothArrays)) == number


def test_four_joints_at_a_time_take_turns_with_their_arrays() -> None:
    joints = tuple("abcdefgh")
    monitor = Monitor(config(*joints, array_rate=20.0))
    names = tuple(f"{joint}_motor" for joint in joints)
    at_once = []
    for i in range(200):
        published = run(monitor, states(names, [START + i * MS], np.zeros((1, 8))))
        at_once.append(sum(p.topic.endswith("load") for p in published))
    assert at_once[0] == 8  # the first message begins a period for all joints
    assert {*at_once[1:]} == {0, 4}
    assert at_once[1:].count(4) in (7, 8)


def predicted(monitor: Monitor, stamp: int, angle: float = 0.4) -> float:
    (error,) = run(monitor, states(("a_motor",), [stamp], [[angle]]), ERROR)
    return float(error.position[0, 0])


def test_a_map_is_used_from_the_next_sample_on_and_only_while_its_mesh_is() -> None:
    monitor = Monitor(TWO)
    exact = predicted(monitor, START)
    assert monitor.use_map("a", map_of_two())
    mapped = predicted(monitor, START + MS)
    assert 0.0 < abs(mapped - exact) <= map_of_two().error_bound
    changed = config("a", "b", a__cup_compliance=1e-4, a__wave_generator_phase=0.1, a__rated_torque=6.0)
    monitor.configure(changed)
    assert monitor.joints["a"].table is map_of_two()
    monitor.configure(OTHER_TWO)
    assert monitor.joints["a"].table is None
    assert [monitor.use_map(name, map_of_two()) for name in ("a", "b")] == [False, True]
    drive = OTHER_TWO.joints[0].drive
    own = transmission_error(drive, np.array([0.4]), np.array([-2.0]))[0]
    assert predicted(monitor, START + 2 * MS) == own


def test_drives_side_by_side_give_each_its_own_error_to_the_last_bit() -> None:
    """With and beyond a map, without one, output at either member; messages together or one at a time."""
    other = {"c__ratio": -101.0, "c__output": "circular_spline", "c__wave_generator_phase": 0.4}
    monitor = Monitor(config("a", "b", "c", a__cup_compliance=1e-5, **other))
    given = monitor.config.joints
    tables = {"a": map_of_two(), "b": None, "c": map_of(given[2])}
    assert all(monitor.use_map(name, table) for name, table in tables.items() if table is not None)
    names = [name for joint in given for name in (joint.input_joint, joint.output_joint)]
    angle = np.linspace(-7.0, 9.0, 24).reshape(8, 3)
    torque = np.linspace(-150.0, 150.0, 24).reshape(8, 3)[::-1]
    position, effort = np.repeat(angle, 2, axis=1), np.repeat(torque, 2, axis=1)
    stamp = (START + MS * np.arange(8)).tolist()
    published = []
    for rows in (slice(6), slice(6, 7), slice(7, 8)):
        published += run(monitor, states(names, stamp[rows], position[rows], effort[rows]), ERROR)
    errors = np.concatenate([each.position for each in published])
    assert max(abs(torque[:, 0])) > map_of_two().torque_limit
    for number, joint in enumerate(given):
        alone = transmission_error(joint.drive, angle[:, number], torque[:, number], tables[joint.name])
        assert_array_equal(errors[:, number], alone)


def test_a_tilt_acts_on_the_next_sample() -> None:
    wide = {"a__face_width": 0.011, "a__cup_length": 0.04, "a__sections": 3}
    monitor = Monitor(config("a", **wide))
    for number, tilt in enumerate(({}, {"a__tilt__magnitude": 1e-3, "a__tilt__direction": 0.7})):
        monitor.configure(config("a", **wide, **tilt))
        drive = monitor.config.joints[0].drive
        expected = transmission_error(drive, np.array([0.4]), np.zeros(1))[0]
        assert predicted(monitor, START + number * MS) == expected
    with pytest.raises(ConfigError, match="strikes the circular spline"):
        config("a", **wide, a__tilt__magnitude=0.09)


def test_other_names_begin_the_stream_anew() -> None:
    monitor = Monitor(TWO)
    predicted(monitor, START)
    monitor.configure(config("a", "b", a__input_joint="elbow"))
    (error,) = run(monitor, states(("elbow",), [START - 5], [[0.4]]), ERROR)
    assert error.names == ("a",)
    assert not run(monitor, states(("a_motor",), [START + MS], [[0.4]]))
    assert monitor.streams.foreign == 1


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (states(("a_motor",), [START], [[np.nan]]), "input angle of a_motor is nan"),
        (states(("a_motor",), [START], [[-np.inf]]), "input angle of a_motor is -inf"),
        (states(("a_motor", "a"), [START], [[0.1, np.inf]]), "output angle of a is inf"),
        (states(("a_motor", "a"), [START], [[0.1, np.nan]]), "output angle of a is nan"),
        (states(("a_motor", "a"), [START], [[0.1, 0.1]], [[0, -np.inf]]), "effort of a is -inf"),
        (states(("a_motor", "a"), [START], [[0.1, 0.1]], [[0, np.nan]]), "effort of a is nan"),
        (states(("a_motor",), [START - MS], [[0.1]]), f"stamp of a_motor repeats the last{SAME}"),
        (states(("a",), [START - MS], [[0.1]]), f"stamp of a repeats the last{SAME}"),
        (states(("a_motor",), [START - 251 * MS], [[0.1]]), "stamp of a_motor is 0.250000 s before the last"),
        (states(("a_motor", "b"), [START], None), "the message names the joint and gives no position of it"),
    ],
)
def test_what_cannot_be_used_is_counted_with_its_reason(made: JointStates, reason: str) -> None:
    monitor = Monitor(config("a"))
    run(monitor, states(("a_motor", "a"), [START - MS], [[0.1, 0.0]], [[0, 1.0]]))
    assert not run(monitor, made)
    joint = monitor.joints["a"]
    assert (joint.rejected, joint.last_rejection, joint.samples) == (1, reason, 1)
    assert run(monitor, states(("a_motor",), [START + MS], [[0.1]]))


def test_one_bad_joint_leaves_the_others_and_strangers_are_counted_apart() -> None:
    monitor = Monitor(TWO)
    names = ("a_motor", "a", "b_motor", "b")
    (error,) = run(monitor, states(names, [START], [[np.nan, 0, 0.1, 0]], [[0, 0, 0, 0]]), ERROR)
    assert error.names == ("b",)
    assert not run(monitor, states(("x", "y"), [START, START + MS], [[1, 2], [3, 4]]))
    assert monitor.streams.foreign == 2
    monitor.temperature("b", 40.0)
    monitor.temperature("b", np.nan)
    a, b = monitor.joints.values()
    assert (a.rejected, b.rejected, b.temperature, b.last_rejection) == (1, 1, 40.0, "temperature is nan")


def test_an_unbearable_torque_gives_nan_not_an_end() -> None:
    monitor = Monitor(TWO)
    (error,) = run(monitor, states(("a_motor", "a"), [START], [[0.1, 0]], [[0, 9e5]]), ERROR)
    assert error.position.shape == (1, 1)
    assert monitor.tick(START, START, {}).statuses[0].values["fault_code"] == "OUT_OF_RANGE"


def test_limits_of_time() -> None:
    monitor = Monitor(TWO)
    for stamp in (-(2**31) * 1_000_000_000, 2**31 * 1_000_000_000 - 1):
        (error,) = run(monitor, states(("a_motor",), [stamp], [[0.1]]), ERROR)
        assert len(encode(error).rows) == 1
