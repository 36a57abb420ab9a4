"""``hd-diag topics``: what is in a bag, what could serve a joint, and the mapping to paste."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.bag.block import Topic
from hd_diag.bag.reader import BagReader
from hd_diag.cli.lines import show, tell
from hd_diag.cli.targets import Problem, write_json
from hd_diag.config.configuration import JointConfig, load, resolve
from hd_diag.config.configured_signals import OWNERS
from hd_diag.config.json_shape import read_text
from hd_diag.config.parameter_file import text
from hd_diag.config.parameters import ConfigError, Value
from hd_diag.diagnosis.record import RecordError
from hd_diag.formatting import listed, visible
from hd_diag.formatting import number as figure
from hd_diag.messages.joint_states import JOINT_STATE
from hd_diag.records.contents import AnglePair, Contents, NumericField, beside, contents, pairs
from hd_diag.records.robot_description import Transmission, contradictions, described, transmissions
from hd_diag.records.table_columns import TableColumns, table_columns
from hd_diag.records.text_table import is_table

_SHOWN, _NAMED = 40, 12  # most numbers listed of a topic; most joints of a publisher
_TORQUES = "torque", "current"
_BULK = 0.01, 0.99  # quantiles of the stamps that give a rate
_DIFFERS = 0.02  # relative difference allowed between the ratio of two angles and a described one


def topics(bag: Path, urdf: Path | None, config_file: str | None, json_file: str | None) -> None:
    """Run ``hd-diag topics``."""
    joints = load(config_file, teeth=False).joints if config_file else ()
    result = of_table(bag) if is_table(bag) else _of_bag(bag, urdf, joints)
    if write_json(json_file, result):
        tell_contents(result)


def of_table(path: Path, verb: str = "diagnose") -> dict[str, Any]:
    """Content of a table, and the verb's command for it; a Problem if it is no table."""
    try:
        found = table_columns(path)
    except RecordError as error:
        raise Problem(str(error)) from error
    time = found.time[np.isfinite(found.time)]
    time = np.cumsum(np.maximum(np.diff(time, prepend=time[:1]), 0.0))  # recordings one after the other
    duration = float(np.ptp(time)) if time.size and found.time_name else 0.0
    content = Contents(found.fields, "", {(): time if found.time_name else time[:0]})
    topic = Topic(str(path), "table", len(found.time))
    result = _result(str(path), duration, [], [(topic, content)])
    joints = result["joints"]
    first = next((joint for joint in joints if "input.field" in joint["mapping"]), next(iter(joints), None))
    return result | {
        "mapping": _command(path, found, first["mapping"], verb) if first else "",
        "time": found.time_name,
    }


def _command(path: Path, found: TableColumns, mapping: dict[str, Any], verb: str) -> str:
    """The verb's command for a table, or that of ``ripple`` if there is one angle."""
    columns = {"time": found.time_name} if found.time_name else {}
    for role, owner in OWNERS.items():
        if name := mapping.get(f"{owner}.field"):
            unit = mapping.get(f"{owner}.unit", "")
            shown = f"[{unit}]" if unit and not name.endswith("]") else ""
            columns[role] = name + shown + ("*1" if unit in ("A", "mA") else "")
    columns |= {"record": found.record_name} if found.record_name else {}
    pairs_given = ",".join(f"{key}={name}" for key, name in columns.items())
    words = ["hd-diag", verb if "input" in columns else "ripple", str(path), "--columns", pairs_given]
    words += ["--input-divided"] if mapping.get("input_divided") else []
    words += [] if found.time_name else ["--rate", "HZ"]
    return shlex.join(words)


def _of_bag(bag: Path, urdf: Path | None, joints: Sequence[JointConfig]) -> dict[str, Any]:
    with BagReader(bag) as reader:
        seen = list(zip(reader.topics, contents(reader, reader.topics), strict=True))
        seen += [(topic, Contents([], topic.content, {})) for topic in reader.foreign]
        result = _result(str(reader.path), reader.duration, reader.problems, seen)
        _describe(result, *_described(reader, urdf), joints)
    return result | {"mapping": _mapping(result["joints"], result["description"]["contested"])}


def _result(
    path: str, duration: float, problems: list[str], seen: list[tuple[Topic, Contents]]
) -> dict[str, Any]:
    every = [n for _, content in seen for n in content.numbers]
    found = pairs(every)
    alone = _alone(every, {id(n) for pair in found for n in pair[:2]})
    joints = [_joint(pair.output, pair, every) for pair in found] + [_joint(n, None, every) for n in alone]
    return {
        "schema": "hd_diag/topics/1",
        "bag": path,
        "duration": duration,
        "problems": problems,
        "topics": [_topic(duration, *each) for each in seen],
        "joints": joints,
        "description": {"source": "", "unseen": [], "contested": [], "warnings": []},
    }


def _mapping(joints: list[dict[str, Any]], contested: list[str]) -> str:
    """Text of a parameter file; comments above it have contradictions and the error of its check."""
    flat: dict[str, Value] = {"joints": [joint["name"] for joint in joints]}
    for joint in joints:
        flat |= {f"{joint['name']}.{name}": value for name, value in joint["mapping"].items()}
    remarks = [*contested]
    try:
        resolve(flat)
    except ConfigError as error:
        remarks.append(f"to be completed: {error}")
    return "".join(f"# {visible(each)}\n" for each in remarks) + text(flat) if joints else ""


def _described(reader: BagReader, urdf: Path | None) -> tuple[str, list[Transmission], list[str]]:
    """Path of the robot's description, its transmissions, and its unusable parts."""
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
    """Add the joints' ratios from a robot's description, and their contradictions to what is known.

    If the angles have another ratio, the mapping gets theirs.
    """
    ratios, contested = {each.joint: each for each in found}, []
    for joint in result["joints"]:
        each = ratios.get(joint["tag"]) or ratios.get(joint["name"])
        if each is None:
            continue
        joint["mapping"]["ratio"] = each.ratio
        joint["said"] += f"; the description says {each.ratio:g}"
        slope = joint["slope"]
        if slope is not None and abs(slope - each.ratio) > _DIFFERS * abs(slope):
            joint["mapping"]["ratio"] = float(round(slope))
            told = f"the angles have a ratio of {slope:.4g}, the robot's description has {each.ratio:g}"
            contested.append(f"{joint['name']}: {told}")
    known = {joint["tag"] for joint in result["joints"]} | {joint["name"] for joint in result["joints"]}
    unseen = [each for each in found if each.joint not in known]
    result["description"] = {
        "source": source,
        "transmissions": [each._asdict() for each in found],
        "unseen": [each.joint for each in unseen],
        "contested": contested,
        "warnings": problems + contested + contradictions(found, configured),
    }


def _topic(duration: float, topic: Topic, content: Contents) -> dict[str, Any]:
    """Content of a topic; rates by stamps, else by the duration [s] of the bag.

    Publishers on the same topic are distinguished by the joints that they name.
    """
    stamps = [*content.stamps.values()]
    rate = _rate(np.concatenate(stamps)) if stamps else None
    if rate is None and duration > 0.0 and topic.count > 1:
        rate = (topic.count - 1) / duration
    return {
        "name": topic.name,
        "type": topic.type_name,
        "messages": topic.count,
        "rate": rate,
        "problem": content.problem,
        "joints": sorted({n.tag for n in content.numbers if n.tag and n.kind}),
        "publishers": [
            {"joints": list(joints), "messages": len(each), "rate": _rate(each)}
            for joints, each in content.stamps.items()
        ],
        "numbers": [
            {
                "field": n.field,
                "kind": n.kind,
                "unit": n.unit,
                "first": float(n.values[0]),
                "least": float(np.min(n.values)),
                "greatest": float(np.max(n.values)),
            }
            for n in content.numbers
        ],
    }


def _rate(stamps: Floats) -> float | None:
    """Rate of messages with these stamps [s], in Hz; None if it is unknown.

    The bulk of the stamps decides: a few may come from another clock.
    """
    span = float(np.ptp(np.quantile(stamps, _BULK))) if stamps.size > 1 else 0.0
    return float(np.ptp(_BULK)) * (stamps.size - 1) / span if span > 0.0 else None


def _alone(every: list[NumericField], paired: set[int]) -> list[NumericField]:
    """Angles of joints without a known second angle; one for each joint."""
    joints = {n.tag for n in every if id(n) in paired}
    found: dict[str, NumericField] = {}
    for n in sorted(every, key=lambda n: not n.is_called_so):
        if n.kind == "angle" and (n.tag or not n.topic.name) and n.tag not in joints and n.moves:
            found.setdefault(n.tag, n)
    return list(found.values())


def _joint(output: NumericField, pair: AnglePair | None, every: list[NumericField]) -> dict[str, Any]:
    """A joint's name, mapping by names of parameters, and remarks on it."""
    tag = output.tag
    name = re.sub(r"\W", "_", tag if not tag[:1].isdigit() else f"joint_{tag}", flags=re.ASCII) or "joint_1"
    mapping: dict[str, Value] = {}
    said = ""
    if pair is None:
        velocity = beside(every, output, "velocity")
        said = "one angle, diagnose needs two; hd-diag ripple looks for the gear in its torque"
        said += "; a velocity of the motor's own encoder is a second: 'input: velocity'" if velocity else ""
    elif pair.counted:
        said = "input and output count: in unit counts/N put N, the counts to a turn, for '?'"
        if pair.output.unit == "rad":
            whole = 2.0 * np.pi * abs(pair.slope)
            said = f"{whole:.6g} counts of the input to a turn of the output: put that over the ratio for '?'"
    elif pair.divided:
        mapping["input_divided"] = True
        said = "two encoders at the output's side; the ratio is the catalogue's"
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
    stamp = {"stamp": "reception"} if n.by_reception else {}
    return {"topic": n.topic.name, **kind, "field": n.field, **unit, **stamp}


def tell_contents(result: dict[str, Any]) -> None:
    """Print what a bag or a table holds, and what to paste."""
    topics = "" if "time" in result else f", {len(result['topics'])} topics"
    tell(f"{result['bag']}: {figure(result['duration'])} s{topics}")
    rows = "rows" if "time" in result else "messages"
    for problem in result["problems"]:
        tell(f"  {problem}")
    for topic in result["topics"]:
        rate = f", {figure(topic['rate'])} Hz" if topic["rate"] else ""
        tell(f"{topic['name']}: {topic['type'] or 'no type'}, {topic['messages']} {rows}{rate}")
        if topic["problem"]:
            tell(f"  {topic['problem']}")
        for each in topic["publishers"] if len(topic["publishers"]) > 1 else ():
            rate = f", {figure(each['rate'])} Hz" if each["rate"] else ""
            joints = listed(each["joints"], _NAMED) or "no names"
            tell(f"  of one publisher, {joints}: {each['messages']} messages{rate}")
        known = [n for n in topic["numbers"] if n["kind"]]
        for n in known[:_SHOWN]:
            tell(f"  {n['field']}: {n['kind']}, {_span(n)}")
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
    tell("to paste:" if "time" in result else "to paste into a parameter file:")
    show(f"{result['mapping']}\n")


def _span(n: dict[str, Any]) -> str:
    if math.isnan(n["least"]):
        return "NaN throughout"
    return f"{figure(n['least'])} to {figure(n['greatest'])} {n['unit']}, the first {figure(n['first'])}"
