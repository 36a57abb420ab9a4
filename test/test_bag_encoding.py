"""Messages as bytes, identical to those that rosbags serializes."""

import numpy as np
import pytest
from bag_samples import joint_state_cdr
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from hd_diag.messages.encoding import encode_float64_multiarray, encode_headers, encode_joint_states
from hd_diag.messages.joint_states import kernel
from hd_diag.messages.publications import DIAGNOSTICS, STRING, encode, read_string, string
from hd_diag.messages.schemas import jazzy, serialize
from hd_diag.monitor.publications import Report, Status

MULTIARRAY = "std_msgs/msg/Float64MultiArray"
STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)


@given(st.data())
def test_joint_states_are_what_rosbags_serializes(data):
    names, frame = tuple(data.draw(st.lists(text, max_size=5))), data.draw(text)
    stamps = data.draw(st.lists(STAMPS, min_size=1, max_size=4))
    shape = (len(stamps), len(names))  # an array for no joints is empty
    numbers = st.lists(st.floats(), min_size=shape[0] * shape[1], max_size=shape[0] * shape[1])
    arrays = [data.draw(st.none() | numbers.map(lambda v: np.reshape(v, shape))) for _ in range(3)]
    encoded = encode_joint_states(names, stamps, *arrays, frame_id=frame)
    for i in range(len(stamps)):
        row = [() if a is None else a[i] for a in arrays]
        assert encoded[i].tobytes() == joint_state_cdr(names, stamps[i], *row, frame)


@given(st.lists(st.tuples(text, st.integers(0, 4)), max_size=3), st.integers(0, 3), st.integers(0, 99))
def test_multiarrays_are_what_rosbags_serializes(dims, count, seed):
    types, lengths = jazzy().types, [size for _, size in dims]
    values = np.random.default_rng(seed).standard_normal((count, *lengths))
    encoded = encode_float64_multiarray(dims, values)
    strides = [int(np.prod(lengths[i:])) for i in range(len(dims))]
    dimension = types["std_msgs/msg/MultiArrayDimension"]
    every = [dimension(n, s, t) for (n, s), t in zip(dims, strides, strict=True)]
    layout = types["std_msgs/msg/MultiArrayLayout"](every, 0)
    expected = [serialize(types[MULTIARRAY](layout, row.ravel()), MULTIARRAY) for row in values]
    assert [row.tobytes() for row in encoded] == expected


@given(st.lists(STAMPS, max_size=4), text)
def test_headers_are_what_rosbags_serializes(stamps, frame):
    types, header = jazzy().types, "std_msgs/msg/Header"
    times = [types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)) for stamp in stamps]
    expected = [serialize(types[header](time, frame), header) for time in times]
    assert [row.tobytes() for row in encode_headers(stamps, frame)] == expected


values_ = st.dictionaries(text, text, min_size=1, max_size=4)


@given(st.lists(st.tuples(text, st.integers(0, 2), text, values_), min_size=1, max_size=3))
def test_reports_are_what_rosbags_serializes(drawn):
    encoded = encode(Report("/diagnostics", 7, 3 * 10**9 + 5, [Status(*each) for each in drawn]), "/robot")
    assert (encoded.topic, encoded.type_name, encoded.received.tolist()) == ("/diagnostics", DIAGNOSTICS, [7])
    types = jazzy().types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](3, 5), "")
    status, pair = types["diagnostic_msgs/msg/DiagnosticStatus"], types["diagnostic_msgs/msg/KeyValue"]
    statuses = [
        status(level, f"hd_diag: {joint}", told, f"/robot/{joint}", list(map(pair, values, values.values())))
        for joint, level, told, values in drawn
    ]
    assert encoded.rows == [serialize(types[DIAGNOSTICS](header, statuses), DIAGNOSTICS)]


@given(text)
def test_strings_are_what_rosbags_serializes(value):
    assert string(value) == serialize(jazzy().types[STRING](value), STRING)
    assert read_string(string(value)) == value


def test_wrong_shapes_and_stamps_beyond_ros_time_are_refused():
    with pytest.raises(ValueError, match="velocity: shape"):
        encode_joint_states(("a",), [1, 2], np.zeros((2, 1)), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="data: shape"):
        encode_float64_multiarray((("a", 2),), np.zeros((1, 3)))
    for stamp in (2**31 * 10**9, -(2**31) * 10**9 - 1):
        with pytest.raises(ValueError, match="32 bits"):
            encode_joint_states(("a",), [stamp], np.zeros((1, 1)))
        with pytest.raises(ValueError, match="32 bits"):
            encode_headers([stamp], "a")
    assert encode_joint_states(("a",), [], np.zeros((0, 1))).shape[0] == 0


def test_strided_stamps_and_values_need_no_other_machine_code() -> None:
    """A message of several joints has strided columns; a node would stop for seconds to compile."""
    stamps, values = np.arange(6) * 10**9, np.arange(24.0).reshape(6, 4)
    expected = encode_joint_states(("a", "b"), stamps[::2].copy(), values[::2, ::2].copy())
    known = len(kernel().write.signatures)
    assert_array_equal(encode_joint_states(("a", "b"), stamps[::2], values[::2, ::2]), expected)
    assert len(kernel().write.signatures) == known
