import struct
import time

import numpy as np
import pytest
from bag_samples import JOINT_STATE, MS, NAMES, joint_state_cdr, rows
from hypothesis import given
from hypothesis import strategies as st

from hd_diag.messages.joint_states import JointStateDecoder, decode_joint_states
from hd_diag.messages.schemas import jazzy

text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)


@st.composite
def joint_state_arguments(draw):
    names = tuple(draw(st.lists(text, max_size=5)))
    array = st.one_of(st.just(()), st.lists(st.floats(), min_size=len(names), max_size=len(names)).map(tuple))
    stamp = draw(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
    return names, stamp, draw(array), draw(array), draw(array), draw(text)


def from_rosbags(data):
    """A message as rosbags reads it: names, frame, stamp [ns], bytes of the three arrays."""
    message = jazzy().deserialize_cdr(data, JOINT_STATE)
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    arrays = [np.asarray(v, "<f8").tobytes() for v in (message.position, message.velocity, message.effort)]
    return tuple(message.name), message.header.frame_id, stamp, arrays


def by_row(columns):
    return {
        int(row): (
            c.names,
            c.frame_id,
            int(c.stamp[i]),
            [b"" if v is None else v[i].astype("<f8").tobytes() for v in (c.position, c.velocity, c.effort)],
        )
        for c in columns
        for i, row in enumerate(c.row)
    }


@given(joint_state_arguments(), st.booleans())
def test_single_messages_are_decoded_alike(arguments, little_endian):
    data = joint_state_cdr(*arguments, little_endian=little_endian)
    decoder = JointStateDecoder()
    for message in (data, memoryview(data), bytearray(data)):
        assert by_row([decoder.decode(message)]) == {0: from_rosbags(data)}


@given(st.integers(1, 40), st.integers(1, 6), st.booleans())
def test_constant_shape_is_one_group(count, joints, little_endian):
    names = tuple(f"j{i}" for i in range(joints))
    value = np.arange(count * joints, dtype=float).reshape(count, joints)
    order = {"little_endian": little_endian}
    messages = [joint_state_cdr(names, i * MS, v, (), -v, **order) for i, v in enumerate(value)]
    (columns,), rejected = decode_joint_states(np.frombuffer(b"".join(messages), np.uint8).reshape(count, -1))
    assert rejected == []
    assert np.array_equal(columns.position, value)
    assert np.array_equal(columns.effort, -value)
    assert columns.velocity is None
    assert columns.position.dtype == np.dtype("=f8")
    assert columns.stamp.tolist() == [i * MS for i in range(count)]


def test_many_layouts_of_one_size():
    """More layouts than one pass decodes."""
    messages = [joint_state_cdr((f"joint_{i % 40:02d}",), i, (float(i),)) for i in range(200)]
    columns, rejected = decode_joint_states(np.frombuffer(b"".join(messages), np.uint8).reshape(200, -1))
    assert rejected == []
    assert sorted(int(r) for c in columns for r in c.row) == list(range(200))
    for c in columns:
        assert {f"joint_{r % 40:02d}" for r in c.row.tolist()} == set(c.names)
        assert c.position[:, 0].tolist() == c.row.tolist()


@pytest.mark.parametrize("wrong", [0, 1, 12, 16])
def test_malformed_among_good_messages(wrong):
    block = rows(10)[0].copy()
    block[[3, 7], wrong : wrong + 4] = 255
    (columns,), rejected = decode_joint_states(block)
    assert columns.row.tolist() == [0, 1, 2, 4, 5, 6, 8, 9]
    assert [r.row for r in rejected] == [3, 7]
    assert all(r.reason for r in rejected)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((("a", "b"), 0, (1.0,)), "1 values of position for 2 names"),
        ((("a",), 0, (1.0,), (1.0, 2.0)), "2 values of velocity for 1 names"),
        (((), 0, (), (), (3.0,)), "1 values of effort for 0 names"),
    ],
)
def test_lengths_that_do_not_agree(arguments, reason):
    """Only code that needs the values by names objects: `Alignment`, and mapped signals."""
    (columns,), rejected = decode_joint_states([joint_state_cdr(*arguments)])
    assert rejected == []
    assert [f"has {reason}"] == [text for number in range(3) if (text := columns.misfit(number))]
    for values, block in zip((*arguments[2:], (), ())[:3], columns.blocks, strict=False):
        assert block is None if not values else block.tolist() == [list(values)]


def test_stamp_with_too_many_nanoseconds():
    data = bytearray(joint_state_cdr(NAMES, 5, (1.0, 2.0)))
    struct.pack_into("<I", data, 8, 10**9)
    good = joint_state_cdr(NAMES, 6, (1.0, 2.0))
    (columns,), ((row, why),) = decode_joint_states([bytes(data), good])
    assert (columns.stamp.tolist(), row) == ([6], 0)
    assert "1000000000 nanoseconds" in why
    with pytest.raises(ValueError, match="nanoseconds"):
        JointStateDecoder().decode(bytes(data))


def test_every_cut_of_a_message_is_refused():
    data = joint_state_cdr(NAMES, 5, (1.0, 2.0), (3.0, 4.0), (5.0, 6.0), "base")
    _, rejected = decode_joint_states([data[:n] for n in range(len(data))])
    assert [r.row for r in rejected] == list(range(len(data)))
    assert decode_joint_states([]) == decode_joint_states(np.empty((0, 100), np.uint8)) == ([], [])
    assert decode_joint_states(np.empty((2, 0), np.uint8))[0] == []


@pytest.mark.parametrize("arrays", [((1.0,), (), ()), ((1.0,), (), (2.0,)), ((), (), ())])
@pytest.mark.parametrize("padding", [1, 4, 7])
def test_padding_behind_the_last_field_is_ignored(arrays, padding):
    """DDS adds such padding; rclpy writes it if velocity or effort is empty."""
    data = joint_state_cdr(("a",), 5, *arrays)
    padded = data + bytes(padding)
    (columns,), rejected = decode_joint_states([padded, padded])
    assert rejected == []
    assert by_row([columns]) == {0: from_rosbags(data), 1: from_rosbags(data)}
    assert by_row([JointStateDecoder().decode(padded)]) == {0: from_rosbags(data)}


@given(st.data())
def test_damaged_messages_are_decoded_alike_or_refused(data):
    """Any accepted message is decoded as rosbags decodes it; padding may hold anything."""
    message = bytearray(joint_state_cdr(("a", "joint_2"), 5 * MS, (1.0, 2.0), (), (3.0, 4.0), "base"))
    for _ in range(data.draw(st.integers(1, 3))):
        message[data.draw(st.integers(0, len(message) - 1))] = data.draw(st.integers(0, 255))
    columns, _ = decode_joint_states([bytes(message)])
    try:
        alone = [JointStateDecoder().decode(bytes(message))]
    except ValueError:
        alone = []
    assert len(alone) == len(columns)
    if columns:
        try:
            expected = from_rosbags(bytes(message))
        except AssertionError:  # rosbags refuses bytes after the last field
            return
        assert by_row(columns) == {0: expected}


def test_a_decoder_forgets_layouts_in_time():
    decoder = JointStateDecoder()
    for i in range(1000):
        decoder.decode(joint_state_cdr((f"joint_{i}",), i, (1.0,)))
    assert sum(map(len, decoder._layouts.values())) <= 64


def test_malformed_messages_that_are_alike_are_refused_at_once():
    """Each keeps its row number, between good messages and others of the same size."""
    good = joint_state_cdr(("a",), 5, (1.0,))
    other = bytes([0, 7]) + bytes(8)
    rows = [bytes(10), good, other, bytes(10), b"", good, b"", bytes(10)] * 500
    begin = time.process_time()
    columns, rejected = decode_joint_states(rows)
    assert [c.row.size for c in columns] == [1000]
    assert [r.row for r in rejected] == [i for i in range(4000) if i % 8 not in (1, 5)]
    _, rejected = decode_joint_states([b""] * 200_000)
    assert len(rejected) == 200_000
    assert time.process_time() - begin < 5.0
