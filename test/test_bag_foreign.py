"""Other contents of bags: messages not in CDR, definitions in IDL, and files that are no bags."""

import gzip
import json
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import faults
import numpy as np
import pytest
from bag_samples import JOINT_STATE, peak_of, rosbag2_folder, write_with_mcap
from cli_runner import hd_diag
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.testing import assert_array_equal
from rosbags.rosbag2 import Reader, StoragePlugin

from hd_diag.bag import BagError, BagReader, recover
from hd_diag.bag.typestore import store_of
from hd_diag.config.configuration import resolve
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.messages.schemas import Definition, deserialize, jazzy
from hd_diag.records.joint_record import read_motion

COUNT = 300
STAMPS = 10**18 + 5_000_000 * np.arange(COUNT)
ANGLE = np.linspace(0.0, 40.0, COUNT)
EFFORT = 20.0 * np.sin(0.3 * ANGLE)
POSITION = np.column_stack((ANGLE, ANGLE / 100.0))
STATES = encode_joint_states(
    ("joint_1_motor", "joint_1"), STAMPS, POSITION, None, np.column_stack((0.0 * EFFORT, EFFORT))
)
Message = tuple[str, str, bytes, int]
JOINTS = [
    ("/joint_states", JOINT_STATE, row.tobytes(), int(now)) for row, now in zip(STATES, STAMPS, strict=True)
]
ONE = resolve({}).joints[0]
BINARY = bytes(range(256))  # like a schema of protobuf
# Encoding of messages; encoding, name and text of the schema, if any; a message.
FOREIGN: dict[str, tuple[str, tuple[str, str, bytes] | None, bytes]] = {
    "json": ("json", ("jsonschema", "cell.Status", b'{"type": "object"}'), b'{"on": true}'),
    "protobuf": ("protobuf", ("protobuf", "cell.Status", BINARY), BINARY),
    "flatbuffer": ("flatbuffer", ("flatbuffer", "cell.Status", BINARY), BINARY),
    "ros1": ("ros1", ("ros1msg", "sensor_msgs/JointState", b"float64 x\n"), BINARY),
    "no schema": ("cdr", None, STATES[0].tobytes()),
    "json without a schema": ("json", None, b"{}"),
    "json by the name of joint states": ("json", ("jsonschema", JOINT_STATE, b"{}"), b"{}"),
}


def mcap_with(path: Path, kind: str) -> Path:
    encoding, schema, data = FOREIGN[kind]
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4000)
        writer.start("ros2")
        text = jazzy().generate_msgdef(JOINT_STATE, ros_version=2)[0].encode()
        own = writer.register_schema(JOINT_STATE, "ros2msg", text)
        joints = writer.register_channel("/joint_states", "cdr", own)
        number = writer.register_schema(schema[1], schema[0], schema[2]) if schema else 0
        other = writer.register_channel("/cell", encoding, number)
        for _, _, row, now in JOINTS:
            writer.add_message(other, now, data, now)
            writer.add_message(joints, now, row, now)
        writer.finish()
    return path


def database(folder: Path, *updates: str, given: Sequence[Message] = JOINTS) -> Path:
    """A rosbag2 folder whose database is then changed by SQL."""
    with closing(sqlite3.connect(rosbag2_folder(folder, given) / f"{folder.name}.db3")) as db:
        for update in updates:
            db.execute(update)
        db.commit()
    return folder


def database_with(path: Path, kind: str) -> Path:
    """A bag like rosbag2's: its table gives the format of each topic."""
    encoding, schema, data = FOREIGN[kind]
    given = [each for own in JOINTS for each in (("/cell", "std_msgs/msg/String", data, own[3]), own)]
    own_format = f"serialization_format = '{encoding}', type = '{schema[1] if schema else ''}'"
    return (
        database(path, f"UPDATE topics SET {own_format} WHERE name = '/cell'", given=given)
        / f"{path.name}.db3"
    )


@pytest.mark.parametrize(
    ("write", "kind"),
    [
        *((mcap_with, kind) for kind in FOREIGN),
        *((database_with, k) for k in FOREIGN if FOREIGN[k][0] != "cdr"),
    ],
)
def test_what_cannot_be_read_is_listed_and_left_alone_and_copied(
    write: Callable[[Path, str], Path], kind: str, tmp_path: Path
) -> None:
    bag = write(tmp_path / "a.mcap", kind)
    encoding, schema, data = FOREIGN[kind]
    motion = read_motion([bag], ONE)
    np.testing.assert_allclose(motion.input_angle, ANGLE, atol=1e-12)
    np.testing.assert_allclose(motion.torque, EFFORT, atol=1e-12)
    told = hd_diag("topics", bag, "--json", tmp_path / "t.json")
    assert told.exit_code == 0
    content = json.loads((tmp_path / "t.json").read_text())
    states, other = content["topics"]
    assert (states["messages"], other["messages"], states["problem"]) == (COUNT, COUNT, "")
    assert other["problem"] == f"{encoding if encoding != 'cdr' else 'no schema'}: not read"
    assert [joint["name"] for joint in content["joints"]] == ["joint_1"]
    report = recover(bag, tmp_path / "b.mcap")
    assert (report.complete, report.counts) == (True, {"/cell": COUNT, "/joint_states": COUNT})
    with (tmp_path / "b.mcap").open("rb") as file:
        every = [(s, c, m.data) for s, c, m in make_reader(file).iter_messages(["/cell"])]
    assert {(c.message_encoding, bytes(d)) for _, c, d in every} == {(encoding, data)}
    if schema and write is mcap_with:
        assert {(s.encoding, s.name, s.data) for s, _, _ in every} == {schema}


def test_a_signal_mapped_to_it_is_an_error_that_says_what_it_is(tmp_path: Path) -> None:
    signal = {"topic": "/cell", "type": "cell/Status", "field": "angle"}
    mapped = {f"joint_1.input.{name}": value for name, value in signal.items()}
    with pytest.raises(BagError, match="/cell for joint_1 is json: not read; it has /joint_states"):
        read_motion([mcap_with(tmp_path / "a.mcap", "json")], resolve(mapped).joints[0])


def test_a_bag_of_nothing_else_says_what_it_holds(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros1")
        schema = writer.register_schema("sensor_msgs/JointState", "ros1msg", b"float64 x\n")
        writer.add_message(writer.register_channel("/joint_states", "ros1", schema), 1, b"x", 1)
        writer.finish()
    result = hd_diag("ripple", tmp_path / "a.mcap")
    assert result.exit_code == 2
    assert "it has /joint_states (ros1: not read)" in result.stderr


# Definitions in IDL ---

LINE = "=" * 80
IDL = f"""{LINE}
IDL: acme_msgs/msg/Drive
// generated from rosidl_adapter/resource/msg.idl.em

#include "acme_msgs/msg/Side.idl"
#include "std_msgs/msg/Header.idl"

module acme_msgs {{
  module msg {{
    typedef double double__2[2];
    @verbatim (language="comment", text=
      "One drive")
    struct Drive {{
      std_msgs::msg::Header header;
      sequence<acme_msgs::msg::Side> sides;
      double__2 torque;
    }};
  }};
}};
{LINE}
IDL: acme_msgs/msg/Side
module acme_msgs {{ module msg {{ struct Side {{ string name; @unit (value="rad") double angle; }}; }}; }};
{LINE}
IDL: std_msgs/msg/Header
#include "builtin_interfaces/msg/Time.idl"
module std_msgs {{ module msg {{
  struct Header {{ builtin_interfaces::msg::Time stamp; string frame_id; }};
}}; }};
{LINE}
IDL: builtin_interfaces/msg/Time
module builtin_interfaces {{ module msg {{ struct Time {{ long sec; unsigned long nanosec; }}; }}; }};
"""
MSG = f"""std_msgs/Header header
acme_msgs/Side[] sides
float64[2] torque
{LINE}
MSG: acme_msgs/Side
string name
float64 angle
"""


def test_parts_of_idl_are_the_types_that_messages_are() -> None:
    """Type hashes cover all fields, and a message reads the same with either definition."""
    name = "acme_msgs/msg/Drive"
    header = f"{LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    time = f"{LINE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    ours, same = (
        store_of(name, Definition(name, text, encoding))
        for text, encoding in ((IDL, "ros2idl"), (MSG + header + time, "ros2msg"))
    )
    assert ours.hash_rihs01(name) == same.hash_rihs01(name)
    types: Any = same.types
    stamp = types["builtin_interfaces/msg/Time"](3, 4)
    side = types["acme_msgs/msg/Side"]("left", 1.5)
    message = types[name](types["std_msgs/msg/Header"](stamp, "base"), [side], np.array([2.0, 3.0]))
    found = deserialize(ours, bytes(same.serialize_cdr(message, name)), name)
    assert (found.header.stamp.sec, found.sides[0].name, found.sides[0].angle) == (3, "left", 1.5)
    assert_array_equal(found.torque, [2.0, 3.0])


# Compression, and files that are no bags ---


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_compressed_messages_need_no_metadata(plugin: StoragePlugin, tmp_path: Path) -> None:
    bag = rosbag2_folder(tmp_path / "bag", JOINTS, plugin=plugin, compression="message")
    expected = [data for _, _, data, _ in JOINTS]
    with Reader(bag) as other:
        assert [bytes(data) for _, _, data in other.messages()] == expected
    (file,) = (path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))
    assert recover(file, tmp_path / "whole.mcap").complete
    for path in (file, tmp_path / "whole.mcap"):
        with BagReader(path) as reader:
            found = [bytes(data) for batch in reader.batches() for data in batch.messages()]
        assert found == expected


def test_what_only_begins_as_if_compressed_is_left_alone(tmp_path: Path) -> None:
    """CDR starts with a zero; other bytes are no CDR, whatever they are."""
    data = [b"(", b"(x", b"", b"(\xb5/", STATES[0].tobytes()]
    given = [("/j", JOINT_STATE, each, i) for i, each in enumerate(data)]
    with BagReader(write_with_mcap(tmp_path / "a.mcap", given)) as reader:
        found = [bytes(each) for batch in reader.batches() for each in batch.messages()]
    assert found == data


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"0.1 2.0 3.0\n0.2 2.1 3.0\n", "text; a table's name"),
        ("Zeit;Winkel °\n1;2\n".encode(), "text; a table's name"),
        ("Zeit;Winkel\n".encode("utf-16"), "text; a table's name"),
        (gzip.compress(b"x", mtime=0), "compressed by gzip"),
    ],
)
def test_a_file_that_is_no_bag_says_what_it_is(content: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(BagError, match=said):
        BagReader(path)
    path.unlink()
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(BagError, match=r"no \.mcap or \.db3 file; run\.bag is a ROS 1 bag"):
        BagReader(tmp_path)


def test_a_replay_takes_what_it_needs(tmp_path: Path) -> None:
    (tmp_path / "one.yaml").write_text(faults.parameter_file(array_rate=0.0))
    for kind in ("json", "no schema"):
        bag, out = mcap_with(tmp_path / "a.mcap", kind), tmp_path / f"{kind}.mcap"
        assert hd_diag("replay", bag, "--config", tmp_path / "one.yaml", "--out", out).exit_code == 0
        with BagReader(out) as reader:
            counts = {topic.name: topic.count for topic in reader.topics}
        assert counts["/joint_states"] == counts["/hd_diag/residual"] == COUNT


PEAK_OF_READING = """
import sys
from pathlib import Path
from hd_diag.bag import BagReader, recover

def peak():
    return int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])

def read(path):
    with BagReader(path) as reader:
        return sum(len(batch) for batch in reader.batches([sys.argv[3]] if sys.argv[3:] else None))

read(sys.argv[1])
recover(sys.argv[1], "whole.mcap")
before = peak()
print(read(sys.argv[2]), recover(sys.argv[2], "saved.mcap").counts, peak() - before)
"""


@pytest.mark.skipif(not hasattr(sqlite3.Connection, "blobopen"), reason="Python 3.10 reads rows whole")
@pytest.mark.parametrize("content", ["zeroblob(100000000)", "hex(zeroblob(50000000))"])
def test_what_sqlite_takes_for_a_long_row_is_bounded_too(content: str, tmp_path: Path) -> None:
    """Rows of 100 MB, as BLOB and as text: SQLite reads all of a text to find its length."""
    database(tmp_path / "plain")
    database(tmp_path / "long", f"UPDATE messages SET data = {content} WHERE id = 150")
    code = [sys.executable, "-c", PEAK_OF_READING, "plain", "long", "/joint_states"]
    run = subprocess.run(code, cwd=tmp_path, capture_output=True, text=True, check=True)
    read, *counts, more = run.stdout.split()
    assert (read, counts) == (str(COUNT), ["{'/joint_states':", f"{COUNT}}}"])
    assert int(more) < 40_000  # [kB]


def test_a_definition_that_would_fill_the_memory_is_refused(tmp_path: Path) -> None:
    update = "UPDATE message_definitions SET encoded_message_definition = hex(zeroblob(20000000))"
    result = hd_diag("topics", database(tmp_path / "bag", update, given=JOINTS[:1]))
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert "string or blob too big" in result.stderr


def test_a_row_that_would_fill_the_memory_is_refused_alone(tmp_path: Path) -> None:
    """A row of 100 MB among readable rows is rejected when it is decoded."""
    bag = database(tmp_path / "bag", "UPDATE messages SET data = zeroblob(100000000) WHERE id = 150")
    motion, peak = peak_of(lambda: read_motion([bag], ONE))
    assert (motion.time.size, motion.stamps.refused) == (COUNT - 1, 1)
    assert peak < 60e6


def test_a_row_that_was_too_long_is_told_with_its_size(tmp_path: Path) -> None:
    """The size is reported even if the topic has no readable message."""
    bag = database(tmp_path / "bag", "UPDATE messages SET data = zeroblob(33554433)", given=JOINTS[:1])
    told = hd_diag("topics", bag).output
    assert "has 33554433 bytes, more than the 33554432 that are read" in told
