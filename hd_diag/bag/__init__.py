"""Bags: reads and writes recordings in rosbag2's formats as columns of numbers, without ROS."""

from rosbags.interfaces import Qos

from hd_diag.bag.block import Topic
from hd_diag.bag.errors import BagError, check_output, replaced
from hd_diag.bag.memory import Memory, Received
from hd_diag.bag.reader import BagReader, Batch, Mixed
from hd_diag.bag.recover import RecoveryReport, recover
from hd_diag.bag.retention import LogFolder, Retention
from hd_diag.bag.rosbag2 import RELIABLE
from hd_diag.bag.writer import BagWriter

__all__ = [
    "RELIABLE",
    "BagError",
    "BagReader",
    "BagWriter",
    "Batch",
    "LogFolder",
    "Memory",
    "Mixed",
    "Qos",
    "Received",
    "RecoveryReport",
    "Retention",
    "Topic",
    "check_output",
    "recover",
    "replaced",
]
