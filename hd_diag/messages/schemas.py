"""Message definitions, type hashes and CDR of ROS 2 Jazzy, without an installed ROS."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

MAX_READ = 32 << 20
"""Longest message that is read from a database for decoding [byte]."""
_TOO_LONG = b"\xfftoo long"  # no CDR message begins like this


@dataclass(frozen=True)
class Definition:
    """Definition of a message type and of the types that it uses, as a bag carries it.

    `encoding` is ``ros2msg`` or ``ros2idl``. The RIHS01 hash is empty if it is not known. `messages` is the
    encoding of the messages; if it is not ``cdr``, they can only be copied.
    """

    type_name: str
    text: str
    encoding: str = "ros2msg"
    type_hash: str = ""
    messages: str = "cdr"


@functools.cache
def jazzy() -> Typestore:
    """The message types of ROS 2 Jazzy; the store is shared, so add nothing to it."""
    return get_typestore(Stores.ROS2_JAZZY)


@functools.cache
def definition(type_name: str) -> Definition:
    """Definition of a message type of ROS 2 Jazzy.

    Raises
    ------
    KeyError
        If ROS 2 Jazzy has no such type.
    """
    store = jazzy()
    if type_name not in store.fielddefs:
        raise KeyError(type_name)
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return Definition(type_name, text, "ros2msg", store.hash_rihs01(type_name))


def serialize(message: Any, type_name: str) -> bytes:
    """CDR (little endian, with the 4-byte header) of a message made from the classes of :func:`jazzy`."""
    return bytes(jazzy().serialize_cdr(message, type_name))


def too_long(size: int) -> bytes:
    """Stand-in for a message of `size` bytes that was not read, because it could fill the memory."""
    return _TOO_LONG + size.to_bytes(8, "little")


def check_begin(data: bytes | memoryview) -> None:
    """Raise ValueError if a message cannot be CDR, or was too long to be read."""
    if len(data) == len(_TOO_LONG) + 8 and data[: len(_TOO_LONG)] == _TOO_LONG:
        size = int.from_bytes(data[len(_TOO_LONG) :], "little")
        raise ValueError(f"has {size} bytes, more than the {MAX_READ} that are read of a message")
    if len(data) < 4 or data[0] != 0 or data[1] > 1:
        raise ValueError("is not a CDR message")


def deserialize(store: Typestore, data: bytes | memoryview, type_name: str) -> Any:
    """Message object from CDR; bytes after its last field are ignored, as DDS does.

    Raises
    ------
    ValueError
        If the message is malformed.
    """
    check_begin(data)
    known = store.get_msgdef(type_name)
    decode = known.deserialize_cdr_le if data[1] else known.deserialize_cdr_be
    try:
        message, end = decode(memoryview(data)[4:], 0, known.cls, store)
    except Exception as exc:  # rosbags raises several kinds on hostile data
        raise ValueError(f"cannot be decoded: {exc}") from exc
    if end > len(data) - 4:
        raise ValueError("is cut off")
    return message
