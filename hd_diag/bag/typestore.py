"""Message types as a bag itself defines them."""

from __future__ import annotations

import functools
import re
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import get_types_from_idl, get_types_from_msg
from rosbags.typesys.store import Typestore

from hd_diag.messages.encoding import encode_joint_states
from hd_diag.messages.joint_states import JOINT_STATE
from hd_diag.messages.schemas import Definition, deserialize, jazzy

# Separator of rosbag2 and MCAP before each part of a definition: 80 times "=", then its kind and name.
_PART = re.compile(r"^=+\n(IDL|MSG): *(\S+)\n", re.MULTILINE)
_NAME = re.compile(r"[A-Za-z]\w{0,99}/(msg|srv|action)/[A-Za-z]\w{0,99}", re.ASCII)
# rosbags unrolls its deserializer over fixed arrays, so longer ones are refused, except for numbers.
_MAX_UNROLLED = 1000
_MAX_TEXT = 128 << 10


@functools.lru_cache(maxsize=64)
def store_of(type_name: str, known: Definition | None) -> Typestore:
    """Type store that has `type_name`: that of ROS 2 Jazzy, unless the bag defines the type differently.

    Raises ValueError if the definition is missing or cannot be understood.
    """
    store, is_jazzy = jazzy(), type_name in jazzy().fielddefs
    if known is None or not known.text:
        if not is_jazzy:
            raise ValueError(f"type {type_name} is not defined in the bag, and not a type of ROS 2 Jazzy")
        return store
    if is_jazzy and known.text == store.generate_msgdef(type_name, ros_version=2)[0]:
        return store
    own = _registered(known)
    return store if is_jazzy and own.hash_rihs01(type_name) == store.hash_rihs01(type_name) else own


def _registered(known: Definition) -> Typestore:
    """A new store with a definition and the types that it uses."""
    # The parser's time grows with the square of the number of empty and comment lines, so they are removed.
    comment = "#" if known.encoding == "ros2msg" else ("//", "#include")
    lines = (line for line in known.text.splitlines() if line.strip())
    text = "".join(line + "\n" for line in lines if not line.lstrip().startswith(comment))
    if not _NAME.fullmatch(known.type_name) or len(text) > _MAX_TEXT:
        raise ValueError(f"definition of {known.type_name[:100]} is not usable")
    store = Typestore()
    try:
        types = _types(text, known)
        for name, (_, fields) in types.items():
            if not _NAME.fullmatch(name) or not all(_is_bounded(desc) for _, desc in fields):
                raise ValueError(f"type {name[:100]} is not usable")
        store.register(types)
        store.get_msgdef(known.type_name)
        store.hash_rihs01(known.type_name)
    except Exception as exc:  # rosbags raises many kinds on hostile text
        raise ValueError(f"definition of {known.type_name} cannot be understood: {exc}") from exc
    return store


def _types(text: str, known: Definition) -> Typesdict:
    """Types of a definition; each IDL part is parsed separately."""
    if known.encoding == "ros2msg":
        return get_types_from_msg(text, known.type_name)
    first, *parts = _PART.split(text)
    types = get_types_from_idl(first) if first.strip() else {}
    for kind, name, part in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
        types |= get_types_from_idl(part) if kind == "IDL" else get_types_from_msg(part, name)
    return types


def _is_bounded(desc: Any) -> bool:
    """Whether decoding work is proportional to the data: no empty and no long, unrolled fixed arrays."""
    if desc[0] != Nodetype.ARRAY:
        return True
    element, length = desc[1]
    is_plain = element[0] == Nodetype.BASE and element[1][0] != "string"
    return int(length) > 0 and (is_plain or int(length) <= _MAX_UNROLLED)


def standard_joint_state(data: Any, store: Typestore) -> memoryview:
    """Convert a JointState message of another definition to that of ROS 2 Jazzy; empty if it is damaged.

    Bytes that cannot be CDR are returned unchanged, so that decoding says why.
    """
    if len(data) and data[0]:
        return memoryview(bytes(data))
    try:
        message = deserialize(store, data, JOINT_STATE)
        stamp, arrays = message.header.stamp, (message.position, message.velocity, message.effort)
        time = [stamp.sec * 10**9 + stamp.nanosec]
        values = (np.array([array], np.float64) if len(array) else None for array in arrays)
        position, velocity, effort = values
        frame = message.header.frame_id
        return memoryview(encode_joint_states(message.name, time, position, velocity, effort, frame)[0])
    except Exception:  # rosbags raises several kinds on hostile data
        return memoryview(b"")
