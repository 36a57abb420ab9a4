"""All joints while they run: the same one at a time and many at once, whatever arrives."""

import dataclasses
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from live import MS, RATIO, START, TEETH, config, states
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.config.configuration import Config
from hd_diag.drive import mesh_state, transmission_error
from hd_diag.messages.publications import encode
from hd_diag.monitor import Monitor
from hd_diag.monitor.publications import Angles, Drawings, Publication, ToothArrays
from hd_diag.replay.map_builder import map_of
from hd_diag.streams.columns import JointStates

CONFIG = config("a", "b", array_rate=100.0, mesh_rate=30.0)
OTHER = config(
    "a", "b", array_rate=40.0, a__eccentricity__magnitude=7e-6, a__torque=-2.0, b__cup_compliance=1e-5
)
MAPS = {joint.name: map_of(joint) for joint in CONFIG.joints}
EVERYTHING = ("a_motor", "a", "b_motor", "b")

# Names, and which of position and effort there are.
SHAPES: tuple[tuple[tuple[str, ...], bool, bool], ...] = (
    (EVERYTHING, True, True),
    (("b", "stranger", "a", "b_motor", "a_motor"), True, True),
    (EVERYTHING, True, False),
    (("a_motor", "b_motor"), True, False),
    (("a", "b"), True, True),
    (("a",), True, False),
    (("b_motor", "a_motor", "a"), True, True),
    (("a", "b"), False, True),
    (("a_motor", "a"), False, False),
    (("stranger",), True, True),
    ((), True, True),
)
INPUTS, OUTPUT = SHAPES[3], SHAPES[5]
STEPS = (MS, 2 * MS, 7 * MS, 80 * MS, 0, -MS, -400 * MS, -3000 * MS)  # [ns]

parts = st.tuples(
    st.sampled_from(SHAPES),
    st.lists(st.integers(0, 40).map(lambda i: STEPS[i] if i < len(STEPS) else MS), min_size=1, max_size=7),
    st.lists(
        st.tuples(st.integers(0, 6), st.integers(0, 9), st.sampled_from([np.nan, np.inf, -np.inf])),
        max_size=2,
    ),
    st.sampled_from(["", "", "", "configure", "back", "maps", "tick", "temperature"]),
)


def run(monitor: Monitor, states_: JointStates, first: int = START) -> list[Publication]:
    return monitor.joint_states(first + np.arange(states_.stamp.size), states_)


def found(publications: list[Publication], topic: str) -> list[Any]:
    return [p for p in publications if p.topic == topic]


def drawn(sequence: list[Any]) -> list[tuple[JointStates, str]]:
    """Messages of the drawn parts, with what is done before each part."""
    made, stamp = [], START
    for number, ((names, has_position, has_effort), steps, spoiled, event) in enumerate(sequence):
        stamps = stamp + np.cumsum(steps)
        stamp = int(stamps[-1])
        time = (stamps - START) * 1e-9
        columns = {
            name: 20.0 * np.sin(3.0 * time + k) / (1.0 if name.endswith("motor") else RATIO)
            for k, name in enumerate(names)
        }
        values = np.stack([*columns.values()], 1) if names else np.empty((len(steps), 0))
        efforts = 70.0 * np.cos(np.arange(values.size).reshape(values.shape) + number)
        for row, column, value in spoiled:
            if row < len(steps) and names:
                (values, efforts)[column % 2][row, column % len(names)] = value
        made.append(
            (states(names, stamps, values if has_position else None, efforts if has_effort else None), event)
        )
    return made


def play(made: list[tuple[JointStates, str]], single: bool) -> tuple[Any, ...]:
    monitor, received = Monitor(CONFIG), START
    topics: dict[str, list[tuple[int, bytes]]] = {}
    for messages, event in made:
        if event == "configure" or event == "back":
            monitor.configure(OTHER if event == "configure" else CONFIG)
        elif event == "temperature":
            monitor.temperature("a", 31.5)
        elif event == "maps":
            for name, table in MAPS.items():
                monitor.use_map(name, table)
        published: list[Publication] = []
        if event == "tick":
            published.append(monitor.tick(received, received, {}))
        count = messages.stamp.size
        times = received + np.arange(count)
        received += 5 * MS
        for at in [slice(i, i + 1) for i in range(count)] if single else [slice(0, count)]:
            columns = [None if c is None else c[at] for c in messages[4:]]
            part = JointStates(messages.row[at], messages.stamp[at], messages.names, "", *columns)
            published += monitor.joint_states(times[at], part)
        for encoded in map(encode, published):
            rows = zip(encoded.received.tolist(), map(bytes, encoded.rows), strict=True)
            topics.setdefault(encoded.topic, []).extend(rows)
    return topics, monitor.tick(received, received, {})


@hypothesis.settings(max_examples=80, suppress_health_check=[hypothesis.HealthCheck.too_slow])
@hypothesis.given(st.lists(parts, min_size=1, max_size=8))
@hypothesis.example([(INPUTS, [MS], [], ""), (OUTPUT, [MS], [], ""), (INPUTS, [MS] * 3, [], "")])
def test_many_at_once_is_one_at_a_time(sequence: list[Any]) -> None:
    made = drawn(sequence)
    assert play(made, single=False) == play(made, single=True)


@pytest.mark.parametrize("with_map", [False, True], ids=["exact", "map"])
@pytest.mark.parametrize("effort", [False, True], ids=["no effort", "effort"])
@pytest.mark.parametrize("names", [EVERYTHING, ("a_motor", "b_motor")], ids=["in one", "inputs"])
def test_clean_messages_are_taken_at_once(names: tuple[str, ...], effort: bool, with_map: bool) -> None:
    """What the property test compares is really one call for all rows where nothing is wrong."""
    monitor = Monitor(CONFIG)
    if with_map:
        for name, table in MAPS.items():
            assert monitor.use_map(name, table)
    n = 50
    values = np.random.default_rng(1).uniform(-3, 3, (n, len(names)))
    made = states(names, START + MS * np.arange(n), values, values if effort else None)
    published = run(monitor, made)
    (error,) = found(published, "~/transmission_error")
    assert error.position.shape == (n, 2)
    singles = Monitor(CONFIG)
    for name, joint in singles.joints.items():
        joint.table = MAPS[name] if with_map else None
    for row in range(n):
        one = states(
            names, [made.stamp[row]], values[row : row + 1], values[row : row + 1] if effort else None
        )
        (alone,) = found(run(singles, one, START + row), "~/transmission_error")
        assert_array_equal(alone.position[0], error.position[row])


def test_predictions_are_the_drives() -> None:
    monitor = Monitor(CONFIG)
    values = np.array([[0.3, 0.02, -1.0, 0.1]])
    efforts = np.array([[np.nan, 3.0, np.nan, -2.0]])
    published = run(monitor, states(EVERYTHING, [START], values, efforts))
    (error,) = found(published, "~/transmission_error")
    assert error.names == ("a", "b")
    assert_array_equal(error.effort, [[3.0, -2.0]])
    for column, (angle, torque) in enumerate([(0.3, 3.0), (-1.0, -2.0)]):
        drive = CONFIG.joints[column].drive
        exact = transmission_error(drive, np.array([angle]), np.array([torque]))
        assert_array_equal(error.position[:, column], exact)
    (measured,) = found(published, "~/measured_transmission_error")
    assert_allclose(measured.position, [[0.02 - 0.3 / RATIO, 0.1 + 1.0 / RATIO]], rtol=1e-14)
    (residual,) = found(published, "~/residual")
    assert_array_equal(residual.position, measured.position - error.position)


def test_teeth_are_the_drives() -> None:
    published = run(Monitor(CONFIG), states(EVERYTHING, [START], [[0.3, 0, 0.5, 0]], [[0, 30.0, 0, 1.0]]))
    state = mesh_state(CONFIG.joints[0].drive, np.array([0.3]), np.array([-30.0]))
    (backlash,) = found(published, "~/a/backlash")
    (load,) = found(published, "~/a/load")
    assert_array_equal(backlash.values, state.backlash)
    assert_array_equal(load.values, state.load)
    assert load.values.shape == (1, 2, TEETH)
    assert load.values.max() > 0


def test_residual_needs_an_output_angle() -> None:
    published = run(Monitor(CONFIG), states(("a_motor", "b_motor", "b"), [START], [[0.1, 0.2, 0.0]]))
    assert found(published, "~/transmission_error")[0].names == ("a", "b")
    assert found(published, "~/residual")[0].names == ("b",)
    assert not found(
        run(Monitor(CONFIG), states(("a_motor",), [START], [[0.1]])), "~/measured_transmission_error"
    )


def test_joints_of_different_messages_are_published_apart() -> None:
    monitor = Monitor(CONFIG)
    first = run(monitor, states(("a_motor",), [START], [[0.1]]))
    second = run(monitor, states(("b_motor",), [START + MS], [[0.2]]))
    assert [p.names for p in found(first + second, "~/transmission_error")] == [("a",), ("b",)]


# Torque ---


def torques(monitor: Monitor, made: JointStates) -> list[float]:
    return [t for p in found(run(monitor, made), "~/transmission_error") for t in p.effort[:, 0].tolist()]


def test_torque_is_the_last_reported() -> None:
    monitor = Monitor(config("a", a__torque=1.5))
    assert torques(monitor, states(("a_motor",), [START], [[0.1]])) == [1.5]
    assert torques(monitor, states(("a_motor", "a"), [START + MS], [[0.1, 0]], [[np.nan, np.nan]])) == [1.5]
    assert torques(monitor, states(("a_motor", "a"), [START + 2 * MS], [[0.1, 0]], [[0, 2.5]])) == [2.5]
    assert torques(monitor, states(("a_motor", "a"), [START + 3 * MS], [[0.1, 0]])) == [2.5]
    assert torques(monitor, states(("a",), [START + 4 * MS], None, [[-4.0]])) == []
    assert torques(monitor, states(("a_motor",), [START + 5 * MS], [[0.1]])) == [-4.0]
    assert monitor.joints["a"].rejected == 0


def test_effort_that_stops_being_a_number_is_refused() -> None:
    monitor = Monitor(config("a"))
    torques(monitor, states(("a_motor", "a"), [START], [[0.1, 0]], [[0, 2.5]]))
    assert torques(monitor, states(("a_motor", "a"), [START + MS], [[0.1, 0]], [[0, np.nan]])) == []
    assert monitor.joints["a"].last_rejection == "effort of a is nan"


# Pairing of output angles that arrive apart ---


def pair(monitor: Monitor, made: list[tuple[str, int, float]]) -> list[Publication]:
    return [
        p
        for name, milliseconds, angle in made
        for p in run(monitor, states((name,), [START + milliseconds * MS], [[angle]]))
    ]


def test_output_angles_that_arrive_apart_are_compared_with_interpolated_inputs() -> None:
    monitor = Monitor(CONFIG)
    published = pair(monitor, [("a_motor", 0, 1.0), ("a", 4, 0.05), ("a_motor", 10, 2.0), ("a", 10, 0.07)])
    measured = found(published, "~/measured_transmission_error")
    assert [int(p.stamp[0]) for p in measured] == [START + 4 * MS, START + 10 * MS]
    assert_allclose(
        [p.position[0, 0] for p in measured], [0.05 - 1.4 / RATIO, 0.07 - 2.0 / RATIO], rtol=1e-13
    )
    exact = transmission_error(CONFIG.joints[0].drive, np.array([1.4]), np.zeros(1))
    residual = found(published, "~/residual")[0]
    assert_allclose(residual.position, measured[0].position - exact, rtol=1e-12)
    assert len(found(published, "~/transmission_error")) == 2
    monitor.tick(START, START, {})
    assert len(measured) == 2


def test_output_that_comes_before_its_input_waits_for_it() -> None:
    monitor = Monitor(CONFIG)
    published = pair(monitor, [("a_motor", 0, 1.0), ("a", 5, 0.05), ("a", 6, 0.06), ("a_motor", 7, 1.7)])
    measured = found(published, "~/measured_transmission_error")
    assert [stamp for p in measured for stamp in p.stamp.tolist()] == [START + 5 * MS, START + 6 * MS]


@pytest.mark.parametrize(
    "made",
    [
        [("a", -5, 0.0), ("a_motor", 0, 1.0)],
        [("a_motor", 0, 1.0), ("a", 30, 0.0), ("a_motor", 60, 2.0)],
    ],
    ids=["before the first input", "in a gap"],
)
def test_outputs_without_inputs_around_them_are_counted(made: list[tuple[str, int, float]]) -> None:
    monitor = Monitor(CONFIG)
    assert not found(pair(monitor, made), "~/residual")
    assert monitor.joints["a"].unpaired == 1


def test_outputs_that_no_input_ever_meets_are_bounded_and_counted() -> None:
    monitor = Monitor(CONFIG)
    pair(monitor, [("a", i, 0.0) for i in range(1000)])
    pair(monitor, [("a_motor", 2000, 0.0)])
    assert monitor.joints["a"].unpaired == 1000


# Rates ---


def test_arrays_and_drawings_come_at_their_rates_by_stamps() -> None:
    monitor = Monitor(config("a", array_rate=20.0, mesh_rate=4.0))
    published = []
    for i in range(1000):
        published += run(monitor, states(("a_motor",), [START + i * MS], [[0.001 * i]]))
    backlash = [p for p in published if isinstance(p, ToothArrays) and p.topic.endswith("backlash")]
    drawings = [p for p in published if isinstance(p, Drawings)]
    assert [int(p.received[0]) - START for p in backlash] == [0] * 20
    assert [int(p.stamp[0]) - START for p in drawings] == [250 * MS * k for k in range(4)]


def test_joints_take_turns_with_their_arrays() -> None:
    monitor = Monitor(config("a", "b", "c", "d", array_rate=20.0))
    names = ("a_motor", "b_motor", "c_motor", "d_motor")
    at_once = []
    for i in range(200):
        published = run(monitor, states(names, [START + i * MS], np.zeros((1, 4))))
        at_once.append(sum(p.topic.endswith("load") for p in published))
    assert at_once[0] == 4  # the first message begins a period for all
    assert max(at_once[1:]) == 1
    assert 15 <= sum(at_once[1:]) <= 16


@pytest.mark.parametrize("rate", [0.0, 1000.0])
def test_rates_at_their_ends(rate: float) -> None:
    monitor = Monitor(config("a", array_rate=rate))
    published = run(monitor, states(("a_motor",), START + MS * np.arange(30), np.zeros((30, 1))))
    teeth = [p for p in published if isinstance(p, ToothArrays)]
    assert sum(p.received.size for p in teeth) == (60 if rate else 0)


def test_drawings_are_encoded_as_markers() -> None:
    monitor = Monitor(config("a", mesh_rate=10.0))
    published = run(monitor, states(("a_motor",), START + 50 * MS * np.arange(4), np.zeros((4, 1))))
    (drawing,) = [p for p in published if isinstance(p, Drawings)]
    encoded = encode(drawing)
    assert encoded.type_name == "visualization_msgs/msg/MarkerArray"
    assert len(encoded.rows) == 2
    assert encoded.received.tolist() == [START, START + 2]


# Configuration and maps ---


def predicted(monitor: Monitor, stamp: int, angle: float = 0.4) -> float:
    (error,) = found(run(monitor, states(("a_motor",), [stamp], [[angle]])), "~/transmission_error")
    return float(error.position[0, 0])


def test_a_configuration_acts_on_the_next_sample() -> None:
    monitor = Monitor(CONFIG)
    before = predicted(monitor, START)
    monitor.configure(OTHER)
    drive = OTHER.joints[0].drive
    exact = transmission_error(drive, np.array([0.4]), np.array([-2.0]))
    assert predicted(monitor, START + MS) == exact[0] != before
    monitor.configure(CONFIG)
    assert predicted(monitor, START + 2 * MS) == before


def test_a_map_is_used_from_the_next_sample_on_and_kept_while_its_mesh_is() -> None:
    monitor = Monitor(CONFIG)
    exact = predicted(monitor, START)
    assert monitor.use_map("a", MAPS["a"])
    mapped = predicted(monitor, START + MS)
    assert mapped != exact
    assert abs(mapped - exact) <= MAPS["a"].error_bound
    changed = config("a", "b", a__cup_compliance=1e-4, a__wave_generator_phase=0.1, a__rated_torque=6.0)
    monitor.configure(changed)
    assert monitor.joints["a"].table is MAPS["a"]


def test_an_outdated_map_is_refused() -> None:
    monitor = Monitor(CONFIG)
    monitor.use_map("a", MAPS["a"])
    monitor.configure(OTHER)
    assert monitor.joints["a"].table is None
    assert not monitor.use_map("a", MAPS["a"])
    assert monitor.use_map("b", MAPS["b"])
    drive = OTHER.joints[0].drive
    assert predicted(monitor, START) == transmission_error(drive, np.array([0.4]), np.array([-2.0]))[0]


def test_other_names_begin_the_stream_anew() -> None:
    monitor = Monitor(CONFIG)
    predicted(monitor, START)
    monitor.configure(config("a", "b", a__input_joint="elbow"))
    (error,) = found(run(monitor, states(("elbow",), [START - 5], [[0.4]])), "~/transmission_error")
    assert error.names == ("a",)
    assert found(run(monitor, states(("a_motor",), [START + MS], [[0.4]])), "~/transmission_error") == []
    assert monitor.streams.foreign == 1


# What cannot be used ---


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (states(("a_motor",), [START], [[np.nan]]), "input angle of a_motor is nan"),
        (states(("a_motor",), [START], [[-np.inf]]), "input angle of a_motor is -inf"),
        (states(("a_motor", "a"), [START], [[0.1, np.inf]]), "output angle of a is inf"),
        (states(("a_motor", "a"), [START], [[0.1, np.nan]]), "output angle of a is nan"),
        (states(("a_motor", "a"), [START], [[0.1, 0.1]], [[0, -np.inf]]), "effort of a is -inf"),
        (states(("a_motor",), [START - MS], [[0.1]]), "stamp of a_motor repeats the last"),
        (
            states(("a_motor",), [START - 251 * MS], [[0.1]]),
            "stamp of a_motor is 0.250000 s before the last",
        ),
        (
            states(("a_motor", "b"), [START], None, None),
            "the message names the joint and gives no position of it",
        ),
    ],
)
def test_what_cannot_be_used_is_counted_with_its_reason(made: JointStates, reason: str) -> None:
    monitor = Monitor(config("a"))
    run(monitor, states(("a_motor", "a"), [START - MS], [[0.1, 0.0]], [[0, 1.0]]))
    assert not run(monitor, made)
    joint = monitor.joints["a"]
    assert (joint.rejected, joint.last_rejection, joint.samples) == (1, reason, 1)
    assert run(monitor, states(("a_motor",), [START + MS], [[0.1]]))


def test_a_repeated_output_stamp_is_counted() -> None:
    monitor = Monitor(CONFIG)
    pair(monitor, [("a", 0, 0.1), ("a", 0, 0.1)])
    assert monitor.joints["a"].last_rejection == "stamp of a repeats the last"


def test_a_clock_that_jumps_back_begins_the_stream_anew() -> None:
    monitor = Monitor(CONFIG)
    predicted(monitor, START)
    predicted(monitor, START - 1500 * MS)
    assert predicted(monitor, START - 1499 * MS)
    joint = monitor.joints["a"]
    assert (joint.samples, joint.rejected, joint.clock_jumps) == (3, 0, 1)


def test_one_bad_joint_leaves_the_others() -> None:
    published = run(Monitor(CONFIG), states(EVERYTHING, [START], [[np.nan, 0, 0.1, 0]], [[0, 0, 0, 0]]))
    assert found(published, "~/transmission_error")[0].names == ("b",)


def test_strangers_are_counted_apart() -> None:
    monitor = Monitor(CONFIG)
    assert not run(monitor, states(("x", "y"), [START, START + MS], [[1, 2], [3, 4]]))
    assert monitor.streams.foreign == 2
    assert all(joint.rejected == 0 for joint in monitor.joints.values())


def test_a_bad_temperature_is_counted() -> None:
    monitor = Monitor(CONFIG)
    monitor.temperature("b", 40.0)
    monitor.temperature("b", np.nan)
    assert monitor.joints["b"].temperature == 40.0
    assert monitor.joints["b"].last_rejection == "temperature is nan"


def test_an_unbearable_torque_gives_nan_not_an_end() -> None:
    monitor = Monitor(CONFIG)
    (error,) = found(
        run(monitor, states(("a_motor", "a"), [START], [[0.1, 0]], [[0, 9e5]])), "~/transmission_error"
    )
    assert error.position.shape == (1, 1)
    report = monitor.tick(START, START, {})
    assert report.statuses[0].values["fault_code"] == "OUT_OF_RANGE"


def test_limits_of_time() -> None:
    """The first and the last stamp that a ROS time can hold."""
    monitor = Monitor(CONFIG)
    for stamp in (-(2**31) * 1_000_000_000, 2**31 * 1_000_000_000 - 1):
        published = run(monitor, states(("a_motor",), [stamp], [[0.1]]))
        assert len(encode(found(published, "~/transmission_error")[0]).rows) == 1


def test_configurations_differ_in_what_they_claim() -> None:
    """The property test's two configurations are two meshes of one and one of the other joint."""
    assert isinstance(OTHER, Config)
    assert CONFIG.joints[0].drive.mesh != OTHER.joints[0].drive.mesh
    assert CONFIG.joints[1].drive.mesh == OTHER.joints[1].drive.mesh
    assert dataclasses.asdict(CONFIG.joints[1].drive) != dataclasses.asdict(OTHER.joints[1].drive)
    assert isinstance(run(Monitor(CONFIG), states(("a_motor",), [START], [[0.0]]))[0], Angles)
