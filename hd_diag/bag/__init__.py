"""The bag edge: recordings as rosbag2 writes and reads them, as columns of numbers; no ROS is needed."""

from hd_diag.bag.errors import BagError, check_output
from hd_diag.bag.reader import BagReader, Batch, Topic
from hd_diag.bag.recover import FileRecovery, RecoveryReport, recover
from hd_diag.bag.rosbag2 import Qos
from hd_diag.bag.writer import BagWriter
from hd_diag.messages.encoding import (
    encode_float64_multiarray,
    encode_float64_multiarray_message,
    encode_joint_state,
    encode_joint_states,
)
from hd_diag.messages.joint_states import JointStateDecoder, Rejection, decode_joint_states
from hd_diag.streams.columns import JointStates

__all__ = [
    "BagError",
    "BagReader",
    "BagWriter",
    "Batch",
    "FileRecovery",
    "JointStateDecoder",
    "JointStates",
    "Qos",
    "RecoveryReport",
    "Rejection",
    "Topic",
    "check_output",
    "decode_joint_states",
    "encode_float64_multiarray",
    "encode_float64_multiarray_message",
    "encode_joint_state",
    "encode_joint_states",
    "recover",
]
