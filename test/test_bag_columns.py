import struct

import numpy as np
import pytest
from bag_samples import JOINT_STATE, MS, NAMES, joint_state, joint_state_cdr, rows
from hypothesis import given
from hypothesis import strategies as st

from hd_diag.bag import JointStateDecoder, decode_joint_states
from hd_diag.messages.joint_states import joint_states_from_messages
from hd_diag.messages.schemas import jazzy

text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)


@st.composite
def joint_state_arguments(draw):
    names = tuple(draw(st.lists(text, max_size=5)))
    array = st.one_of(st.just(()), st.lists(st.floats(), min_size=len(names), max_size=len(names)).map(tuple))
    stamp = draw(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
    return names, stamp, draw(array), draw(array), draw(array), draw(text)


def from_rosbags(messages):
    """The general way: objects of rosbags, one by one."""
    store = jazzy()
    return joint_states_from_messages(
        (i, store.deserialize_cdr(m, JOINT_STATE)) for i, m in enumerate(messages)
    )


def assert_same(one, other):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert (a.names, a.frame_id, a.row.tolist(), a.stamp.tolist()) == (
            b.names,
            b.frame_id,
            b.row.tolist(),
            b.stamp.tolist(),
        )
        for x, y in ((a.position, b.position), (a.velocity, b.velocity), (a.effort, b.effort)):
            assert (x is None) == (y is None)
            if x is not None:
                assert x.shape == y.shape == (len(a.row), len(a.names))
                assert x.tobytes() == np.ascontiguousarray(y).tobytes()


@given(st.lists(st.tuples(joint_state_arguments(), st.booleans()), max_size=8))
def test_columns_are_what_rosbags_decodes(given_messages):
    messages = [joint_state_cdr(*a, little_endian=little) for a, little in given_messages]
    columns, rejected = decode_joint_states(messages)
    expected, refused = from_rosbags(messages)
    assert rejected == refused == []
    assert_same(sorted_rows(columns), sorted_rows(expected))


def sorted_rows(columns):
    """One entry for each message: both byte orders of one shape are one group for rosbags and two here."""
    return sorted(
        (
            c._replace(
                row=c.row[i : i + 1],
                stamp=c.stamp[i : i + 1],
                **{
                    n: None if getattr(c, n) is None else getattr(c, n)[i : i + 1]
                    for n in ("position", "velocity", "effort")
                },
            )
            for c in columns
            for i in range(len(c.row))
        ),
        key=lambda c: int(c.row[0]),
    )


@given(joint_state_arguments(), st.booleans())
def test_single_messages_are_decoded_alike(arguments, little_endian):
    data = joint_state_cdr(*arguments, little_endian=little_endian)
    decoder = JointStateDecoder()
    (expected,), _ = decode_joint_states([data])
    for message in (data, memoryview(data), bytearray(data)):
        assert_same([decoder.decode(message)], [expected])


@given(st.integers(1, 40), st.integers(1, 6), st.sampled_from(["<", ">"]))
def test_constant_shape_is_one_group(count, joints, order):
    names = tuple(f"j{i}" for i in range(joints))
    value = np.arange(count * joints, dtype=float).reshape(count, joints)
    messages = [
        joint_state_cdr(names, i * MS, value[i], (), -value[i], little_endian=order == "<")
        for i in range(count)
    ]
    (columns,), rejected = decode_joint_states(np.frombuffer(b"".join(messages), np.uint8).reshape(count, -1))
    assert rejected == []
    assert np.array_equal(columns.position, value)
    assert np.array_equal(columns.effort, -value)
    assert columns.velocity is None
    assert columns.position.dtype == np.dtype("=f8")
    assert columns.stamp.tolist() == [i * MS for i in range(count)]


def test_many_layouts_of_one_size():
    """More layouts than are done at once."""
    messages = [joint_state_cdr((f"joint_{i % 40:02d}",), i, (float(i),)) for i in range(200)]
    columns, rejected = decode_joint_states(np.frombuffer(b"".join(messages), np.uint8).reshape(200, -1))
    assert rejected == []
    assert sorted(int(r) for c in columns for r in c.row) == list(range(200))
    for c in columns:
        assert {f"joint_{r % 40:02d}" for r in c.row.tolist()} == set(c.names)
        assert c.position[:, 0].tolist() == c.row.tolist()


@pytest.mark.parametrize("wrong", range(4))
def test_malformed_among_good_messages(wrong):
    block, _ = rows(10)
    block = block.copy()
    place = (0, 1, 12, 16)[wrong]
    block[3, place : place + 4] = 255
    block[7, place : place + 4] = 255
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
    data = joint_state_cdr(*arguments)
    columns, ((row, why),) = decode_joint_states([data])
    assert (columns, row) == ([], 0)
    assert reason in why
    with pytest.raises(ValueError, match=reason):
        JointStateDecoder().decode(data)
    assert reason in joint_states_from_messages([(0, joint_state(*arguments))])[1][0].reason


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
    _, rejected = decode_joint_states([data + bytes(4)])
    assert "too many" in rejected[0].reason


@given(st.binary(max_size=200))
def test_random_bytes_are_decoded_or_refused(data):
    columns, rejected = decode_joint_states([data])
    assert len(columns) + len(rejected) == 1
    try:
        JointStateDecoder().decode(data)
    except ValueError:
        assert rejected
    else:
        assert columns


@given(st.data())
def test_damaged_messages_are_decoded_alike_or_refused(data):
    """What is not refused is what rosbags makes of it; padding may hold anything."""
    message = bytearray(joint_state_cdr(("a", "joint_2"), 5 * MS, (1.0, 2.0), (), (3.0, 4.0), "base"))
    for _ in range(data.draw(st.integers(1, 3))):
        message[data.draw(st.integers(0, len(message) - 1))] = data.draw(st.integers(0, 255))
    columns, _ = decode_joint_states([bytes(message)])
    if columns:
        expected, refused = from_rosbags([bytes(message)])
        assert refused == []
        assert_same(columns, expected)


def test_a_decoder_forgets_layouts_in_time():
    decoder = JointStateDecoder()
    for i in range(1000):
        decoder.decode(joint_state_cdr((f"joint_{i}",), i, (1.0,)))
    assert sum(map(len, decoder._layouts.values())) <= 64


def test_no_messages():
    assert decode_joint_states([]) == ([], [])
    assert decode_joint_states(np.empty((0, 100), np.uint8)) == ([], [])
    assert decode_joint_states(np.empty((2, 0), np.uint8))[0] == []
