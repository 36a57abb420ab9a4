import numpy as np
import pytest
from bag_samples import joint_state_cdr
from hypothesis import given
from hypothesis import strategies as st

from hd_diag.bag import (
    decode_joint_states,
    encode_float64_multiarray,
    encode_float64_multiarray_message,
    encode_joint_state,
    encode_joint_states,
)
from hd_diag.messages.encoding import encode_diagnostic_array
from hd_diag.messages.schemas import jazzy, serialize

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
MULTIARRAY = "std_msgs/msg/Float64MultiArray"
text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)


@given(st.data())
def test_joint_states_are_what_rosbags_serializes(data):
    names = tuple(data.draw(st.lists(text, max_size=5)))
    count = data.draw(st.integers(1, 4))
    # An array of no joints is an empty array.
    shape = (count, len(names))
    numbers = st.lists(st.floats(), min_size=shape[0] * shape[1], max_size=shape[0] * shape[1])
    arrays = [data.draw(st.none() | numbers.map(lambda v: np.reshape(v, shape))) for _ in range(3)]
    stamps = data.draw(
        st.lists(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1), min_size=count, max_size=count)
    )
    frame = data.draw(text)
    encoded = encode_joint_states(names, stamps, *arrays, frame_id=frame)
    for i in range(count):
        row = [None if a is None else a[i] for a in arrays]
        expected = joint_state_cdr(names, stamps[i], *(() if r is None else r for r in row), frame)
        assert encoded[i].tobytes() == expected
        assert encode_joint_state(names, stamps[i], *row, frame) == expected


def test_encoding_and_decoding_are_inverse():
    generator = np.random.default_rng(1)
    position, velocity, effort = generator.normal(size=(3, 50, 4))
    stamps = generator.integers(0, 2**31 * 10**9, 50)
    names = ("a", "bb", "ccc", "dddd")
    (columns,), rejected = decode_joint_states(
        encode_joint_states(names, stamps, position, velocity, effort, "f")
    )
    assert rejected == []
    assert (columns.names, columns.frame_id) == (names, "f")
    assert np.array_equal(columns.stamp, stamps)
    for found, expected in zip(
        (columns.position, columns.velocity, columns.effort), (position, velocity, effort), strict=True
    ):
        assert np.array_equal(found, expected)


@given(
    st.lists(st.tuples(text, st.integers(0, 4)), max_size=3),
    st.integers(1, 3),
    st.randoms(use_true_random=False),
)
def test_multiarrays_are_what_rosbags_serializes(dims, count, chance):
    types, dims = jazzy().types, tuple(dims)
    lengths = [size for _, size in dims]
    values = np.array([chance.gauss(0, 1) for _ in range(count * int(np.prod(lengths)))]).reshape(
        count, *lengths
    )
    encoded = encode_float64_multiarray(dims, values)
    strides = [int(np.prod(lengths[i:])) for i in range(len(dims))]
    layout = types["std_msgs/msg/MultiArrayLayout"](
        [types["std_msgs/msg/MultiArrayDimension"](n, s, t) for (n, s), t in zip(dims, strides, strict=True)],
        0,
    )
    for i in range(count):
        expected = serialize(types[MULTIARRAY](layout, values[i].ravel()), MULTIARRAY)
        assert encoded[i].tobytes() == expected
        assert encode_float64_multiarray_message(dims, values[i]) == expected


def test_multiarray_of_a_view_that_is_not_contiguous():
    values = np.arange(12.0).reshape(3, 4).T
    dims = (("a", 4), ("b", 3))
    expected = encode_float64_multiarray(dims, np.ascontiguousarray(values)[None])[0].tobytes()
    assert encode_float64_multiarray_message(dims, values) == expected


@given(
    st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1),
    st.lists(
        st.tuples(st.integers(0, 127), text, text, text, st.dictionaries(text, text, max_size=4)), max_size=4
    ),
)
def test_diagnostics_are_what_rosbags_serializes(stamp, statuses):
    types = jazzy().types
    key_value = types["diagnostic_msgs/msg/KeyValue"]
    every = [
        types["diagnostic_msgs/msg/DiagnosticStatus"](
            level, name, message, hardware, [key_value(k, v) for k, v in values.items()]
        )
        for level, name, message, hardware, values in statuses
    ]
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    array = types[DIAGNOSTICS](types["std_msgs/msg/Header"](time, ""), every)
    assert encode_diagnostic_array(stamp, statuses) == serialize(array, DIAGNOSTICS)


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="velocity: shape"):
        encode_joint_states(("a",), [1, 2], np.zeros((2, 1)), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="1 values are needed"):
        encode_joint_state(("a",), 1, np.zeros(2))
    with pytest.raises(ValueError, match="data: shape"):
        encode_float64_multiarray((("a", 2),), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="data: shape"):
        encode_float64_multiarray_message((("a", 2),), np.zeros(3))


@pytest.mark.parametrize("stamp", [2**31 * 10**9, -(2**31) * 10**9 - 1])
def test_stamps_beyond_ros_time_are_refused(stamp):
    with pytest.raises(ValueError, match="32 bits"):
        encode_joint_states(("a",), [stamp], np.zeros((1, 1)))
    with pytest.raises(ValueError, match="ROS time"):
        encode_joint_state(("a",), stamp, np.zeros(1))
    with pytest.raises(ValueError, match="ROS time"):
        encode_diagnostic_array(stamp, [])


def test_no_messages():
    assert encode_joint_states(("a",), [], np.zeros((0, 1))).shape[0] == 0
    assert encode_float64_multiarray((("a", 2),), np.zeros((0, 2))).shape[0] == 0
