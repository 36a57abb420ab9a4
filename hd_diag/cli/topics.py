"""``hd-diag topics``: what is in a bag, what could serve a joint, and the mapping to paste."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.bag.block import Topic
from hd_diag.bag.reader import BagReader
from hd_diag.cli.lines import show, tell
from hd_diag.cli.targets import Problem, write_json
from hd_diag.config.configuration import JointConfig, load
from hd_diag.config.json_shape import read_text
from hd_diag.config.parameter_file import text
from hd_diag.config.parameters import Value
from hd_diag.formatting import number as figure
from hd_diag.formatting import visible
from hd_diag.messages.joint_states import JOINT_STATE
from hd_diag.records.contents import AnglePair, NumericField, beside, numbers, pairs
from hd_diag.records.robot_description import Transmission, contradictions, described, transmissions

_SHOWN = 40  # numbers of a topic
_TORQUES = "torque", "current"
_DIFFERS = 0.02  # part by which the ratio of two angles may differ from a described one


def topics(bag: Path, urdf: Path | None, config_file: str | None, json_file: str | None) -> None:
    """Do what ``hd-diag topics`` is asked for."""
    joints = load(config_file).joints if config_file else ()
    with BagReader(bag) as reader:
        every, seen = [], []
        for topic in reader.topics:
            try:
                found, problem = numbers(reader, topic)
            except Exception as error:  # rosbags raises several kinds on hostile definitions and data
                found, problem = [], str(error)
            every += found
            seen.append((topic, found, problem))
        seen += [(topic, [], topic.content) for topic in reader.foreign]
        result = _result(reader, seen, every)
        _describe(result, *_described(reader, urdf), joints)
        result["mapping"] = _mapping(result["joints"])
    if write_json(json_file, result):
        _tell(result)


def _result(
    reader: BagReader, seen: list[tuple[Topic, list[NumericField], str]], every: list[NumericField]
) -> dict[str, Any]:
    found = pairs(every)
    alone = _alone(every, {id(n) for pair in found for n in pair[:2]})
    joints = [_joint(pair.output, pair, every) for pair in found] + [_joint(n, None, every) for n in alone]
    return {
        "schema": "hd_diag/topics/1",
        "bag": str(reader.path),
        "duration": reader.duration,
        "problems": reader.problems,
        "topics": [_topic(reader.duration, *each) for each in seen],
        "joints": joints,
    }


def _mapping(joints: list[dict[str, Any]]) -> str:
    """Text of a parameter file."""
    flat: dict[str, Value] = {"joints": [joint["name"] for joint in joints]}
    for joint in joints:
        flat |= {f"{joint['name']}.{name}": value for name, value in joint["mapping"].items()}
    return text(flat) if joints else ""


def _described(reader: BagReader, urdf: Path | None) -> tuple[str, list[Transmission], list[str]]:
    """Where the robot's description is, its transmissions, and what of it cannot be used."""
    source = ""
    try:
        if urdf:
            source, text = str(urdf), read_text(urdf, "URDF")
        else:
            text, source = described(reader)
        return (source, *transmissions(text)) if source else ("", [], [])
    except ValueError as error:
        if urdf:
            raise Problem(f"{urdf}: {error}") from error
        return source, [], [f"{source}: {error}"]


def _describe(
    result: dict[str, Any],
    source: str,
    found: list[Transmission],
    problems: list[str],
    configured: Sequence[JointConfig],
) -> None:
    """Add what a description tells: ratios of the joints, and where they contradict what is known."""
    ratios, warnings = {each.joint: each for each in found}, [*problems]
    for joint in result["joints"]:
        each = ratios.get(joint["tag"]) or ratios.get(joint["name"])
        if each is None:
            continue
        joint["mapping"]["ratio"] = each.ratio
        joint["said"] += f"; the description says {each.ratio:g}"
        slope = joint["slope"]
        if slope is not None and abs(slope - each.ratio) > _DIFFERS * abs(slope):
            told = f"the angles have a ratio of {slope:.4g}, the robot's description has {each.ratio:g}"
            warnings.append(f"{joint['name']}: {told}")
    known = {joint["tag"] for joint in result["joints"]} | {joint["name"] for joint in result["joints"]}
    unseen = [each for each in found if each.joint not in known]
    result["description"] = {
        "source": source,
        "transmissions": [each._asdict() for each in found],
        "unseen": [each.joint for each in unseen],
        "warnings": warnings + contradictions(found, configured),
    }


def _topic(duration: float, topic: Topic, found: list[NumericField], problem: str) -> dict[str, Any]:
    """Content of a topic; its rate by its stamps, or by the duration [s] of the bag."""
    longest = max((n.time for n in found), key=len, default=np.zeros(0))
    span, count = (longest[-1] - longest[0], longest.size) if longest.size > 1 else (duration, topic.count)
    return {
        "name": topic.name,
        "type": topic.type_name,
        "messages": topic.count,
        "rate": (count - 1) / span if span > 0.0 and count > 1 else None,
        "problem": problem,
        "joints": sorted({n.tag for n in found if n.tag and n.kind}),
        "numbers": [
            {
                "field": n.field,
                "kind": n.kind,
                "unit": n.unit,
                "least": float(np.min(n.values)),
                "greatest": float(np.max(n.values)),
            }
            for n in found
        ],
    }


def _alone(every: list[NumericField], paired: set[int]) -> list[NumericField]:
    """Angles of joints of which no second one is known; one for each joint."""
    joints = {n.tag for n in every if id(n) in paired}
    found: dict[str, NumericField] = {}
    for n in every:
        if n.kind == "angle" and n.tag and n.tag not in joints and n.moves:
            found.setdefault(n.tag, n)
    return list(found.values())


def _joint(output: NumericField, pair: AnglePair | None, every: list[NumericField]) -> dict[str, Any]:
    """A joint's name, mapping by names of parameters, and what is to say about it."""
    tag = output.tag
    name = re.sub(r"\W", "_", tag if not tag[:1].isdigit() else f"joint_{tag}", flags=re.ASCII) or "joint_1"
    mapping: dict[str, Value] = {}
    said = ""
    if pair is None:
        velocity = beside(every, output, "velocity")
        said = "one angle: see hd-diag ripple"
        said += "; 'input: velocity' where its velocity is the motor's own" if velocity else ""
    elif pair.counted:
        said = "input and output count: in unit counts/N put N, the counts to a turn, for '?'"
        if pair.output.unit == "rad":
            whole = 2.0 * np.pi * abs(pair.slope)
            said = f"{whole:.6g} counts of the input to a turn of the output: put that over the ratio for '?'"
    elif pair.divided:
        mapping["input_divided"], said = (
            True,
            "two encoders at the output's side; the ratio is the catalogue's",
        )
    else:
        said = f"the input turns {pair.slope:.4g} times as far as the output: a ratio of {round(pair.slope)}?"
    torque, warm = beside(every, output, *_TORQUES), beside(every, output, "temperature")
    roles = ("input", pair.input if pair else None), ("output_signal", output)
    for owner, n in (*roles, ("torque_signal", torque), ("temperature_signal", warm)):
        mapping |= {f"{owner}.{key}": value for key, value in _signal(n).items()} if n else {}
    if torque is not None and torque.kind == "current":
        mapping["torque_signal.scale"], said = 1.0, f"{said}; scale: N m per A at the link"
    slope = None if pair is None or pair.divided or pair.counted else pair.slope
    return {"name": name, "tag": tag, "said": said, "slope": slope, "mapping": mapping}


def _signal(n: NumericField) -> dict[str, Value]:
    unit = {} if n.unit in ("rad", "N m", "degC", "") else {"unit": n.unit}
    kind = {} if n.topic.type_name == JOINT_STATE else {"type": n.topic.type_name.replace("/msg/", "/")}
    return {"topic": n.topic.name, **kind, "field": n.field, **unit}


def _tell(result: dict[str, Any]) -> None:
    tell(f"{result['bag']}: {figure(result['duration'])} s, {len(result['topics'])} topics")
    for problem in result["problems"]:
        tell(f"  {problem}")
    for topic in result["topics"]:
        rate = f", {figure(topic['rate'])} Hz" if topic["rate"] else ""
        tell(f"{topic['name']}: {topic['type'] or 'no type'}, {topic['messages']} messages{rate}")
        if topic["problem"]:
            tell(f"  {topic['problem']}")
        known = [n for n in topic["numbers"] if n["kind"]]
        for n in known[:_SHOWN]:
            span = f"{figure(n['least'])} to {figure(n['greatest'])} {n['unit']}"
            tell(f"  {n['field']}: {n['kind']}, {span}")
        if len(known) > _SHOWN:
            tell(f"  and {len(known) - _SHOWN} more")
    about = result["description"]
    if about["source"]:
        told = [f"{each['joint']} {each['ratio']:g}" for each in about["transmissions"]]
        tell(f"transmissions of {about['source']}: {', '.join(map(visible, told)) or 'none'}")
    if about["unseen"]:
        tell(f"  no angle that moves: {', '.join(map(visible, about['unseen']))}")
    for warning in about["warnings"]:
        tell(f"warning: {visible(warning)}")
    if not result["joints"]:
        tell("no angle that moves: nothing can be a joint's input or output")
        return
    for joint in result["joints"]:
        tell(f"{joint['name']}: {joint['said']}")
    tell("to paste into a parameter file:")
    show(f"{result['mapping']}\n")
