"""The bag edge: recordings as rosbag2 writes and reads them, as columns of numbers; no ROS is needed."""

from hd_diag.samples import JointStates

from .columns import JointStateDecoder, Rejection, decode_joint_states
from .encoding import (
    encode_float64_multiarray,
    encode_float64_multiarray_message,
    encode_joint_state,
    encode_joint_states,
)
from .errors import BagError, check_output
from .reader import BagReader, Batch, Topic
from .recover import FileRecovery, RecoveryReport, recover
from .rosbag2 import Qos
from .writer import BagWriter

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
