"""Transmissions of joints in a robot's description (URDF), with their actuators and ratios.

Both forms are read: ``<transmission>`` of URDF (``mechanicalReduction``) and of ros2_control
(``mechanical_reduction`` within ``<ros2_control>``).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from hd_diag.bag.reader import BagReader
from hd_diag.config.configuration import JointConfig
from hd_diag.formatting import visible
from hd_diag.messages.publications import STRING, read_string

_REDUCTIONS = ("mechanicalReduction", "mechanical_reduction")
_TOPIC = "robot_description"
_SAME = 0.01  # allowed relative difference from a described ratio, which has few digits
_LONGEST = 60  # characters of a name or number


class Transmission(NamedTuple):
    """A joint's transmission: the actuator's name, empty if none; its turns per turn of the joint."""

    joint: str
    actuator: str
    ratio: float


def transmissions(text: str) -> tuple[list[Transmission], list[str]]:
    """Transmissions of a description, and its unusable parts.

    Raises
    ------
    ValueError
        If the text is no description of a robot.
    """
    root = _parsed(text)
    if root.tag != "robot":
        raise ValueError(f"is no URDF: it begins with <{visible(root.tag, _LONGEST)}>, not with <robot>")
    found, problems = [], []
    for each in root.iter("transmission"):
        try:
            found += _of(each)
        except ValueError as error:
            problems.append(f"transmission {visible(each.get('name', ''), _LONGEST)} {error}")
    return found, problems


def described(reader: BagReader) -> tuple[str, str]:
    """The last description in a bag and its topic; both empty if the bag has none."""
    found = "", ""
    for topic in reader.topics:
        if topic.type_name == STRING and topic.name.rpartition("/")[2] == _TOPIC:
            for batch in reader.batches([topic.name]):
                for data in batch.messages() if batch.topic is topic else ():
                    found = read_string(bytes(data)), topic.name
    return found


def contradictions(found: Iterable[Transmission], joints: Iterable[JointConfig]) -> list[str]:
    """Texts on configured ratios that differ from those of a description."""
    ratios = {each.joint: each.ratio for each in found}
    told = []
    for joint in joints:
        own = joint.drive.kinematics.ratio
        other = ratios.get(joint.output_joint, ratios.get(joint.name, own))
        if abs(own - other) > _SAME * abs(own):
            told.append(f"{joint.name}: ratio {own:g} is configured, the robot's description has {other:g}")
    return told


def _of(transmission: Element) -> list[Transmission]:
    """The joints of a transmission; ValueError if a reduction is not a number."""
    actuators = transmission.findall("actuator")
    turns = [_reduction(each) for each in actuators]
    found = []
    for number, joint in enumerate(transmission.findall("joint")):
        alone = len(actuators) == 1 or number < len(actuators)
        own, of = _reduction(joint), turns[min(number, len(turns) - 1)] if turns and alone else None
        ratio = own if of is None or of == own else of if own is None else own * of
        if ratio is not None and joint.get("name"):
            name = actuators[min(number, len(actuators) - 1)].get("name", "") if actuators else ""
            found.append(Transmission(joint.get("name", ""), name, ratio))
    return found


def _reduction(element: Element) -> float | None:
    """Reduction of a joint or an actuator; None if none is given."""
    text = next((each.text or "" for tag in _REDUCTIONS for each in element.iter(tag)), None)
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or value == 0.0:
        hint = "; expand the file with xacro first" if "${" in text else ""
        raise ValueError(f"has a reduction that is no number: {visible(text.strip(), _LONGEST)!r}{hint}")
    return value


def _parsed(text: str) -> Element:
    """The root of a document; ValueError if it declares entities, because they may expand without end."""
    builder, parser = TreeBuilder(), expat.ParserCreate()

    def refuse(*_: object) -> None:
        raise ValueError("declares a document type or entities, which no robot's description needs")

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        raise ValueError(f"is no XML: {error}") from error
    return builder.close()
