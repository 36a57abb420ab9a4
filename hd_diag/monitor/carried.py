"""State of a monitor as JSON: a log that continues another one begins with it."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.joint import Joint
from hd_diag.streams.rules import Reason

_COUNTERS = ("inputs", "first", "waiting", "samples", "rejected", "unpaired", "clock_jumps", "unstamped")


def carried(monitor: Monitor) -> dict[str, Any]:
    """State of a monitor right after `Monitor.begin_window`, without its configuration and maps."""
    streams = monitor.streams
    return {
        "streams": [_text(array) for array in streams.state],
        "last_rejections": streams.texts,
        "foreign": streams.foreign,
        "arrived": [[*each] for each in streams.before],
        "periods": monitor.periods.tolist(),
        "joints": {name: _of_joint(joint) for name, joint in monitor.joints.items()},
    }


def carry_on(monitor: Monitor, state: Mapping[str, Any]) -> None:
    """Let a monitor of the same configuration continue from the state of another.

    Raises
    ------
    ValueError
        If the state does not fit the monitor.
    """
    try:
        _put(monitor, state)
    except Exception as error:  # hostile numbers may raise anything in a model
        raise ValueError(f"its state is none of these joints: {error}") from error


def _put(monitor: Monitor, state: Mapping[str, Any]) -> None:
    streams = monitor.streams
    arrays = [_array(text, own) for text, own in zip(state["streams"], streams.state, strict=True)]
    joints, *_, waiting = arrays
    within = all((joints[name] >= 0).all() for name in _COUNTERS)
    if not within or not (joints["waiting"] <= waiting.shape[1]).all():
        raise ValueError("a place that no ring has")
    for reason in joints["reason"].tolist():
        Reason(reason)
    for own, array in zip(streams.state, arrays, strict=True):
        own[...] = array
    texts = state["last_rejections"]
    streams.foreign = int(state["foreign"])
    monitor.periods[...] = np.array(state["periods"], np.int64)
    if not isinstance(texts, list) or [type(text) for text in texts] != [str] * len(monitor.joints):
        raise ValueError("no text for each joint")
    streams.texts = texts
    for name, joint in monitor.joints.items():
        _put_joint(joint, state["joints"][name])
    monitor.begin_window()
    streams.before = [{_pair(pair): None for pair in times} for times in state.get("arrived", ())]


def _of_joint(joint: Joint) -> dict[str, Any]:
    lost, orders = joint.lost, joint.orders
    return {
        "temperature": joint.temperature if math.isfinite(joint.temperature) else None,
        "lost": [lost.count, lost.lately, lost.usual_step, lost.unjudged.tolist()],
        "orders": [_text(array) for array in orders.state],
        "runs": [run.carried for run in joint.runs],
    }


def _pair(pair: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and keys of messages; TypeError if they are not texts."""
    names, keys = pair
    "".join([*names, *keys])
    return tuple(names), tuple(keys)


def _put_joint(joint: Joint, state: Mapping[str, Any]) -> None:
    heat, lost, orders = state["temperature"], joint.lost, joint.orders
    joint.temperature = math.nan if heat is None else float(heat)
    count, lately, step, unjudged = state["lost"]
    if not (step == 0.0 or step >= 1.0):
        raise ValueError(f"a period of {step} ns")
    lost.count, lost.lately, lost.usual_step = int(count), int(lately), float(step)
    lost.unjudged = np.array(unjudged, np.int64).reshape(-1)
    for own, text in zip(orders.state, state["orders"], strict=True):
        own[...] = _array(text, own)
    for run, own in zip(joint.runs, state["runs"], strict=True):
        run.carry_on(own)


def _text(array: npt.NDArray[Any]) -> str:
    return base64.b64encode(array.tobytes()).decode()


def _array(text: str, like: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Array from its text, with the shape and type of another."""
    return np.frombuffer(base64.b64decode(text), like.dtype).reshape(like.shape).copy()
