"""Records from bags and tables, in the forms that users have."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_samples import JOINT_STATE, STRING, string_cdr, write_with_mcap
from joint_records import RATIO, columns, joint, prepared
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.bag import BagError, BagReader
from hd_diag.config.configuration import resolve
from hd_diag.diagnosis.record import Record, RecordError
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.messages.schemas import jazzy, serialize
from hd_diag.records.contents import contents
from hd_diag.records.joint_record import read_bags, read_motion
from hd_diag.records.joint_topics import joints_in
from hd_diag.records.tables import Table, read_table_motion, read_tables

START = 1_760_000_000 * 10**9  # [ns]
TEMPERATURE = "sensor_msgs/msg/Temperature"
NAMES = ("joint_1_motor", "joint_1")
COLUMNS = {"time": "t", "input": "motor", "output": "link", "torque": "tau"}
Message = tuple[str, str, bytes, int]
Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def given() -> Columns:
    return columns(seconds=6.0)


def states(
    time: np.ndarray,
    names: Sequence[str],
    position: Sequence[np.ndarray],
    effort: Sequence[np.ndarray] | None = None,
    velocity: Sequence[np.ndarray] | None = None,
    topic: str = "/joint_states",
) -> list[Message]:
    stamp = START + np.rint(1e9 * time).astype(np.int64)
    blocks = [None if b is None else np.stack(b, axis=1) for b in (position, velocity, effort)]
    rows = encode_joint_states(list(names), stamp, *blocks)
    return [(topic, JOINT_STATE, row.tobytes(), int(s)) for row, s in zip(rows, stamp, strict=True)]


def whole(given: Columns, names: Sequence[str] = NAMES, torque: bool = True) -> list[Message]:
    effort = (np.zeros_like(given["torque"]), given["torque"]) if torque else None
    return states(given["time"], names, (given["input"], given["output"]), effort)


def temperatures(time: np.ndarray, value: np.ndarray, topic: str = "/joint_1/temperature") -> list[Message]:
    types = jazzy().types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
    stamp = START + np.rint(1e9 * time).astype(np.int64)
    return [
        (topic, TEMPERATURE, serialize(types[TEMPERATURE](header, float(v), 0.0), TEMPERATURE), int(s))
        for s, v in zip(stamp, value, strict=True)
    ]


def write(path: Path, *messages: list[Message]) -> Path:
    return write_with_mcap(path, sorted((m for part in messages for m in part), key=lambda m: m[3]))


def read(*paths: Path, **own: Any) -> Record:
    return read_bags(paths, joint(**own))


# Bags ---


def test_everything_in_one_message(given: Columns, tmp_path: Path) -> None:
    record = read(write(tmp_path / "a.mcap", whole(given)))
    expected = prepared(given)
    assert_allclose(record.time, expected.time, rtol=0, atol=1e-9)
    for name in ("input_angle", "output_angle", "reported_torque"):
        assert_array_equal(getattr(record, name), getattr(expected, name))
    assert (record.has_torque, record.temperature, record.reported_speed) == (True, None, None)


def test_temperature_and_speed_as_reported(given: Columns, tmp_path: Path) -> None:
    seconds, speed = np.arange(7.0), np.gradient(given["input"], given["time"])
    angles = (given["input"], given["output"])
    path = write(
        tmp_path / "a.mcap",
        states(given["time"], NAMES, angles, None, (speed, speed / RATIO)),
        temperatures(seconds, 25.0 + seconds),
        temperatures(seconds, 80.0 + seconds, "/joint_2/temperature"),
    )
    record = read(path)
    assert_allclose(record.temperature, 25.0 + record.time, atol=0.05)
    assert_array_equal(record.reported_speed, speed)


def test_several_bags_are_runs(given: Columns, tmp_path: Path) -> None:
    later = {**given, "time": given["time"] + 3600.0}
    paths = [write(tmp_path / f"{i}.mcap", whole(part)) for i, part in enumerate((given, later))]
    record = read(*paths)
    assert (record.extent.runs, record.size) == (2, 2 * given["time"].size)
    assert_array_equal(record.run, record.bag)
    assert record.time[record.run == 1][0] == pytest.approx(3600.0, abs=1e-6)
    assert record.extent.duration == pytest.approx(2 * given["time"][-1], abs=1e-6)


def test_input_and_output_in_messages_of_their_own(given: Columns, tmp_path: Path) -> None:
    """The input at 1 kHz, half a step off the output's 200 Hz, is interpolated to the output's stamps."""
    fast = np.arange(0.0005, 6.0, 0.001)
    angle = 60.0 * np.sin(2.0 * np.pi * fast / 10.0)
    path = write(
        tmp_path / "split.mcap",
        states(fast, NAMES[:1], (angle,), topic="/motor/joint_states"),
        states(given["time"], NAMES[1:], (given["output"],), (given["torque"],)),
    )
    record = read(path)
    assert_allclose(record.time, given["time"][1:] - given["time"][1], rtol=0, atol=1e-9)
    # Linear interpolation error: an eighth of the step squared times the acceleration.
    bound = 1.01 * 0.001**2 / 8 * 60.0 * (2.0 * np.pi / 10.0) ** 2
    assert_allclose(record.input_angle, given["input"][1:], rtol=0, atol=bound)


@pytest.mark.parametrize("apart", [1, 20])
def test_a_torque_far_off_goes_with_the_samples_beside_it(given: Columns, apart: int, tmp_path: Path) -> None:
    """Torque comes as often as the angles or less; samples interpolated from the outlier go, too."""
    time, torque = given["time"], given["torque"].copy()
    torque[600] = 1e5
    angles = states(time, NAMES, (given["input"], given["output"]))
    nothing = (np.nan * time[::apart],)
    torques = states(time[::apart], NAMES[1:], nothing, (torque[::apart],), topic="/t")
    record = read(bag := write(tmp_path / "a.mcap", torques, angles))
    assert record.outliers == 2 * apart - 1
    assert np.abs(record.torque).max() < 60.0
    motion = read_motion([bag], joint())
    assert motion.torque.max() < 60.0


def test_a_clock_set_back_begins_a_run(tmp_path: Path) -> None:
    clean = columns(seconds=20.0)
    clean["time"][clean["time"].size // 2 :] -= 5.0
    messages = [(*message[:3], START + i * 10**6) for i, message in enumerate(whole(clean))]
    record = read(write(tmp_path / "back.mcap", messages))
    assert record.size > 3990
    assert (record.extent.runs, record.stamps.set_back) == (2, 1)
    assert_array_equal(np.flatnonzero(np.diff(record.run)), np.flatnonzero(np.diff(record.time) < 0.0))


@pytest.mark.parametrize("apart", [0.2, -1000.0])
def test_streams_of_two_clocks(given: Columns, apart: float, tmp_path: Path) -> None:
    """The input comes four times a second, or has another clock."""
    time = given["time"] + apart
    slow = slice(None, None, 50 if apart > 0.0 else 1)
    path = write(
        tmp_path / "apart.mcap",
        states(time[slow], NAMES[:1], (given["input"][slow],), topic="/motor/joint_states"),
        states(given["time"], NAMES[1:], (given["output"],), (given["torque"],)),
    )
    with pytest.raises(RecordError, match=r"1[0-9]+ output angles have no input angle within 50 ms"):
        read(path)


def test_several_joints(given: Columns, tmp_path: Path) -> None:
    other = {**columns(seconds=6.0, seed=5), "input": given["input"] + 1.0}
    names = (*NAMES, "joint_2_motor", "joint_2")
    angles = (given["input"], given["output"], other["input"], other["output"])
    messages = states(given["time"], names, angles)
    path = write(tmp_path / "two.mcap", messages, [("/note", STRING, string_cdr("x"), START)])
    with BagReader(path) as reader:
        assert joints_in(reader) == set(names)
    config = resolve({"joints": ["joint_1", "joint_2"]})
    first, second = (read_bags([path], j) for j in config.joints)
    assert_array_equal(first.input_angle, given["input"])
    assert_array_equal(second.input_angle, other["input"])
    assert_array_equal(second.output_angle, other["output"])


def test_no_torque_and_an_effort_of_nan(given: Columns, tmp_path: Path) -> None:
    nothing = {**given, "torque": np.full_like(given["torque"], np.nan)}
    for messages in (whole(given, torque=False), whole(nothing)):
        record = read(write(tmp_path / "a.mcap", messages), torque=4.5)
        assert not record.has_torque
        assert_array_equal(record.torque, 4.5)


def test_bags_that_hold_no_record_of_the_joint(given: Columns, tmp_path: Path) -> None:
    wanted = r"no input angle \('joint_1_motor'\) with output angle \('joint_1'\)"
    there = wanted + ".*elbow, elbow_motor; its topics are /joint_states; .*hd-diag topics"
    with pytest.raises(RecordError, match=there):
        read(write(tmp_path / "others.mcap", whole(given, ("elbow_motor", "elbow"))))
    with pytest.raises(RecordError, match="with output angle"):
        read(write(tmp_path / "input.mcap", states(given["time"], NAMES[:1], (given["input"],))))
    with pytest.raises(BagError, match=r"has no topic with sensor_msgs/msg/JointState; it has /note"):
        read(write(tmp_path / "note.mcap", [("/note", STRING, string_cdr("x"), START)]))


# Tables ---


def write_table(path: Path, given: Columns, **more: np.ndarray) -> Path:
    named = {COLUMNS.get(name, name): column for name, column in {**given, **more}.items()}
    table = np.stack(list(named.values()), axis=1)
    np.savetxt(path, table, "%.17g", ",", header=",".join(named), comments="")
    return path


def test_tables_give_the_same_record_and_each_is_a_recording(given: Columns, tmp_path: Path) -> None:
    note = np.zeros(given["time"].size)
    paths = [write_table(tmp_path / name, given, note=note) for name in ("a.csv", "b.csv")]
    expected = prepared(given)
    for count in (1, 2):
        record = read_tables(paths[:count], Table(COLUMNS), joint())
        for name in ("time", "input_angle", "output_angle", "torque", "speed"):
            assert_array_equal(getattr(record, name), np.tile(getattr(expected, name), count))
        assert np.unique(record.bag).tolist() == list(range(count))


def test_a_table_without_torque_and_with_temperature_and_records(given: Columns, tmp_path: Path) -> None:
    count = given["time"].size
    path = write_table(tmp_path / "a.csv", given, heat=np.full(count, 31.0), part=np.arange(count) // 600)
    chosen = {name: COLUMNS[name] for name in ("time", "input", "output")}
    table = Table({**chosen, "temperature": "heat", "record": "part"})
    record = read_tables([path], table, joint(torque=3.0))
    assert (record.has_torque, record.extent.runs) == (False, 2)
    assert_allclose(record.temperature, 31.0, rtol=1e-9)


def write_lines(path: Path, header: str, given: Sequence[np.ndarray], between: str, point: str = ".") -> Path:
    texts = ([f"{value:.17g}".replace(".", point) for value in row] for row in zip(*given, strict=True))
    path.write_text("\n".join([header, *map(between.join, texts)]), encoding="utf-8-sig")
    return path


@pytest.mark.parametrize("between", [";", "\t", "|"])
def test_a_table_with_a_decimal_comma_and_units_in_its_header(
    given: Columns, tmp_path: Path, between: str
) -> None:
    """Tables as spreadsheets write them, with a byte-order mark."""
    current = given["torque"] / 11.2
    units = 1e3 * given["time"], np.degrees(given["input"]), given["output"] / (2 * np.pi), current * 1e3
    header = between.join(("t [ms]", "motor (deg)", "link", "i [mA]"))
    path = write_lines(tmp_path / "a.csv", header, units, between, ",")
    table = Table({"time": "t", "input": "motor", "output": "link[turns]", "torque": "i*11.2"})
    record, expected = read_tables([path], table, joint()), prepared(given)
    assert record.by_current
    for name in ("time", "input_angle", "output_angle", "reported_torque"):
        assert_allclose(getattr(record, name), getattr(expected, name), rtol=0, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(
    ("counts", "bits", "offset"),
    [(512, 16, 100.0), (512, 16, -32000.0), (4096, 16, 65000.0), (2**20, 32, 2.0**31), (4096, 12, 3.0)],
)
def test_a_counter_that_runs_over_is_the_same_in_tables_and_bags(
    given: Columns, tmp_path: Path, counts: int, bits: int, offset: float
) -> None:
    """16 bits signed or unsigned, 32 bits, or one that restarts each turn; with stamps or a rate."""
    whole = np.rint(given["input"] / (2 * np.pi) * counts) + offset
    told = np.mod(whole + 2.0**15, 2.0**16) - 2.0**15 if offset < 0 else np.mod(whole, 2.0**bits)
    lines = write_lines(tmp_path / "a.csv", "t,m,l", (given["time"], told, given["output"]), ",")
    columns = {"input": f"m[counts/{counts}]", "output": "l"}
    tables = Table(columns | {"time": "t"}), Table(columns, rate=200.0)
    own = joint(input__field="position", input__unit=f"counts/{counts}")
    bag = write(tmp_path / "a.mcap", states(given["time"], NAMES, (told, given["output"])))
    for record in (*(read_tables([lines], table, joint()) for table in tables), read_bags([bag], own)):
        assert_allclose(record.time, given["time"], rtol=0, atol=1e-9)
        turned = record.input_angle - record.input_angle[0]
        assert_allclose(turned, 2 * np.pi / counts * (whole - whole[0]), rtol=0, atol=1e-6)


@pytest.mark.parametrize("divided", [True, False])
def test_a_velocity_in_a_table_is_integrated_as_in_a_bag(
    given: Columns, tmp_path: Path, divided: bool
) -> None:
    """Velocity of the link if the configuration says so, otherwise of the motor in rpm."""
    speed = np.gradient(given["input"], given["time"])
    own = joint(input="velocity")
    columns = {"time": "t", "input": "v", "output": "l"} if divided else {**COLUMNS, "input": "v[rpm]"}
    shown = speed / RATIO if divided else speed * 60.0 / (2 * np.pi)
    header = "t,v,l,tau" if divided else "t,v,link,tau"
    values = given["time"], shown, given["output"], given["torque"]
    path = write_lines(tmp_path / "a.csv", header, values, ",")
    record = read_tables([path], Table({**columns, "torque": "tau"}), own if divided else joint())
    messages = states(given["time"], NAMES[1:], (given["output"],), (given["torque"],), (speed / RATIO,))
    expected = read_bags([write(tmp_path / "a.mcap", messages)], own)
    assert (record.by_velocity, expected.by_velocity) == (True, True)
    for name in ("time", "input_angle", "output_angle", "torque", "reported_speed"):
        assert_allclose(getattr(record, name), getattr(expected, name), rtol=0, atol=1e-8, err_msg=name)
    with pytest.raises(RecordError, match="needs the output's angle to begin its integral from"):
        read_table_motion([path], Table({"time": "t", "input": "v[rpm]", "torque": "tau"}), joint())


def test_a_divided_input_of_a_table_that_wraps(given: Columns, tmp_path: Path) -> None:
    """On the output's side it exceeds half a turn, at which both encoders restart."""
    moved = {"input": given["input"] / RATIO + 3.0, "output": given["output"] + 3.0}
    wrapped = {name: np.mod(angle + np.pi, 2 * np.pi) - np.pi for name, angle in moved.items()}
    path = write_table(tmp_path / "a.csv", {**given, **wrapped})
    for table, own in ((Table(COLUMNS, divided=True), joint()), (Table(COLUMNS), joint(input_divided=True))):
        record = read_tables([path], table, own)
        assert_allclose(record.input_angle - RATIO * 3.0, given["input"], rtol=0, atol=1e-9)


def test_empty_cells_are_missing_values(given: Columns, tmp_path: Path) -> None:
    """A torque between two others is interpolated; without an output angle there is no sample."""
    path = write_table(tmp_path / "a.csv", given)
    lines = path.read_text().splitlines()
    lines[100], lines[200] = lines[100].rpartition(",")[0] + ",", lines[200].split(",")[0]
    path.write_text("\n".join(lines))
    assert read_tables([path], Table(COLUMNS), joint()).dropped == 1


@pytest.mark.parametrize("wraps", [False, True])
def test_signals_of_a_table_may_have_rates_and_stamps_of_their_own(
    given: Columns, wraps: bool, tmp_path: Path
) -> None:
    """The input has stamps between those of the output; torque and temperature come less often."""
    whole, count = prepared(given), given["time"].size
    apart, own = 0.4 * (given["time"][1] - given["time"][0]), np.full((4, 2 * count), np.nan)
    time = np.stack((given["time"], given["time"] + apart), axis=1).ravel()
    angle = np.interp(time, given["time"], given["input"])
    own[0, 1::2] = np.remainder(angle[1::2], 2.0 * np.pi) if wraps else angle[1::2]
    own[1, ::2] = given["output"]
    own[2, ::8] = given["torque"][::4]
    own[3, [0, -2]] = 20.0, 26.0
    cells = [["" if np.isnan(value) else repr(float(value)) for value in column] for column in (time, *own)]
    rows = (",".join(row) for row in zip(*cells, strict=True))
    path = tmp_path / "a.csv"
    path.write_text("\n".join(("t,motor,link,tau,heat", *rows)))
    columns = {"time": "t", "input": "motor", "output": "link", "torque": "tau", "temperature": "heat"}
    record = read_tables([path], Table(columns), joint())
    assert record.size > count - 5
    assert_allclose(record.output_angle, whole.output_angle[1 : record.size + 1], atol=1e-12)
    assert_allclose(record.torque, whole.torque[1 : record.size + 1], atol=0.05)
    assert record.temperature[[10, -10]] == pytest.approx([20.0, 26.0], abs=0.2)


def test_a_stamp_that_goes_back_ends_an_interpolation(tmp_path: Path) -> None:
    """The second half repeats the stamps of the first; a cell of the torque is filled from its own half."""
    made = columns(seconds=20.0)
    half, torque = made["time"].size // 2, made["torque"]
    time = np.where(np.arange(2 * half) < half, made["time"], made["time"] - made["time"][half])
    sparse = np.where(np.arange(2 * half) % 4 == 0, torque, np.nan)
    path = write_table(tmp_path / "a.csv", {**made, "time": time, "torque": sparse})
    record = read_tables([path], Table(COLUMNS), joint())
    assert record.size == 2 * (half - 3)  # none after the last torque of a half
    wanted = prepared({**made, "time": time})
    rows = np.delete(np.arange(2 * half), np.r_[half - 3 : half, 2 * half - 3 : 2 * half])
    assert_allclose(record.torque, wanted.torque[rows], atol=0.05)


HEADER, LINK = "t,motor,link,tau\n", {"time": "t", "output": "link"}


@pytest.mark.parametrize(
    ("text", "columns", "said"),
    [
        ("", COLUMNS, "is empty"),
        ("Seen,\non Monday.\n", COLUMNS, "has no column 't'; it has Seen,  and no rows of numbers"),
        ("PK\3\4\0\0", COLUMNS, "is a spreadsheet or an archive: save the table as CSV"),
        ("t,motor,link\n0,0,0\n", COLUMNS, "has no column 'tau'; it has t, motor, link"),
        ("t,motor,link,tau\n0,1,x,3\n", COLUMNS, "line 2: 'x' is not a number"),
        ("t,motor,link,tau\n", COLUMNS, "too short: 0 usable samples"),
        ("t,motor,link,tau\n0,1,2,3\n", COLUMNS, "too short: 1 usable samples"),
        ("\xff\xfe", COLUMNS, "is empty"),
        (None, COLUMNS, "cannot be read"),
        (None, {"time": "t", "input": "motor"}, "columns need output: one angle has no transmission error; "),
        (None, LINK, "publish the motor encoder's angle, or its velocity (input=v["),
        (None, LINK, "; for hd-diag ripple a torque or a current"),
        (None, {"output": "link", "torque": "tau"}, "; what the torque shows: hd-diag ripple"),
        (None, {"torque": "tau"}, "columns need time (or a rate), input, output"),
        (None, {"input": "t", "output": "motor"}, "columns need time (or a rate)"),
        (HEADER, {**COLUMNS, "input": "motor[mm]"}, "column 'motor': 'mm' is not a unit of input"),
        (HEADER, {**COLUMNS, "output": "link[rpm]"}, "'rpm' is not a unit of output"),
        (HEADER, {**COLUMNS, "input": "motor*x"}, "has no column 'motor*x'"),
        (None, {**COLUMNS, "speed": "v"}, "columns cannot be 'speed'"),
        (None, {"time": "t", "input": "m", "outputs": "l"}, "columns cannot be 'outputs'; "),
    ],
)
def test_a_bad_table_is_told_in_one_line(
    text: str | None, columns: dict[str, str], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    if text is not None:
        path.write_text(text, encoding="latin-1")
    with pytest.raises(RecordError) as caught:
        read_tables([path], Table(columns), joint())
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_bag_of_what_rclpy_serializes(given: Columns, tmp_path: Path) -> None:
    """Bags as rosbag2_py writes them: with bytes after the last field if velocity or effort is empty."""
    serialize_message = pytest.importorskip("rclpy.serialization").serialize_message
    messages = pytest.importorskip("sensor_msgs.msg")
    found: list[Message] = []
    for t, *position in zip(given["time"], given["input"], given["output"], strict=True):
        time = START + round(1e9 * t)
        state = messages.JointState(name=NAMES, position=position)
        warm = messages.Temperature(temperature=30.0 + t)
        for message in (state, warm):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(time, 10**9)
        found.append(("/joint_states", JOINT_STATE, serialize_message(state), time))
        found.append(("/joint_1/temperature", TEMPERATURE, serialize_message(warm) + bytes(8), time))
    bag = write(tmp_path / "a.mcap", found)
    assert len(found[0][2]) > len(whole(given, torque=False)[0][2])
    record = read(bag)
    assert (record.size + record.outliers, record.stamps.refused) == (given["time"].size, 0)
    with BagReader(bag) as reader:
        assert [len(reader.deserialize(batch)[1]) for batch in reader.batches(grouped=True)] == [0, 0]
        assert [n.field for n in contents(reader, reader.topics[:1])[0].numbers] == [
            f"position[{n}]" for n in NAMES
        ]
