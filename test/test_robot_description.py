"""Ratios from a robot's description: both forms of transmissions, hostile XML, messages of topics."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import robot_messages as robots
from bag_samples import STRING, string_cdr
from cli_runner import assert_one_line_error, hd_diag
from joint_records import columns
from robot_messages import DYNAMIC, START, Messages

from hd_diag.bag import BagReader, BagWriter
from hd_diag.config.configuration import dump, load, resolve
from hd_diag.records.robot_description import Transmission, contradictions, transmissions

URDF = """<robot name="arm"><joint name="elbow" type="revolute"/>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
 <joint name="elbow"><hardwareInterface>x</hardwareInterface></joint>
 <actuator name="elbow_motor"><mechanicalReduction>{}</mechanicalReduction></actuator>
</transmission></robot>"""
CONTROL = """<robot name="arm"><ros2_control name="hw" type="system"><joint name="elbow"/>
<transmission name="t"><plugin>transmission_interface/SimpleTransmission</plugin>
 <actuator name="a" role="actuator1"/>
 <joint name="elbow" role="joint1"><mechanical_reduction>{}</mechanical_reduction><offset>0.0</offset></joint>
</transmission>
<transmission name="d"><plugin>transmission_interface/DifferentialTransmission</plugin>
 <actuator name="m1" role="actuator1"><mechanical_reduction>50</mechanical_reduction></actuator>
 <actuator name="m2" role="actuator2"><mechanical_reduction>-50</mechanical_reduction></actuator>
 <joint name="roll" role="joint1"><mechanical_reduction>2.0</mechanical_reduction></joint>
 <joint name="pitch" role="joint2"><mechanical_reduction>2.0</mechanical_reduction></joint>
</transmission></ros2_control></robot>"""


def test_both_forms_of_transmissions() -> None:
    assert transmissions(URDF.format("-100")) == ([Transmission("elbow", "elbow_motor", -100.0)], [])
    found, problems = transmissions(CONTROL.format(" 1.6e2 "))
    assert problems == []
    expected = ("elbow", "a", 160.0), ("roll", "m1", 100.0), ("pitch", "m2", -100.0)
    assert found == [Transmission(*each) for each in expected]
    for parts in ("", f"{'<a>' * 100_000}{'</a>' * 100_000}"):
        assert transmissions(f"<robot>{parts}</robot>") == ([], [])


@pytest.mark.parametrize("text", ["${ratio}", "a hundred", "", "nan", "0"])
def test_a_reduction_that_is_none_is_told_and_the_others_are_read(text: str) -> None:
    found, (problem,) = transmissions(CONTROL.format(text))
    assert [each.joint for each in found] == ["roll", "pitch"]
    assert problem.startswith("transmission t has a reduction that is no number")
    assert ("xacro" in problem) == ("$" in text)


PASSWORDS = '<!ENTITY f SYSTEM "file:///etc/passwd">'
LAUGHS = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 12))
HOSTILE = {
    "a billion laughs": (f'<!DOCTYPE r [<!ENTITY l0 "ha">{LAUGHS}]><robot>&l11;</robot>', "document type"),
    "a file of the disk": (f"<!DOCTYPE r [{PASSWORDS}]><robot>&f;</robot>", "document"),
    "a file of the net": ('<!DOCTYPE r SYSTEM "http://127.0.0.1/r.dtd"><robot/>', "document type"),
    "no XML": ("robot: {}", "is no XML"),
    "cut off": (URDF[:200], "is no XML"),
    "another document": ("<sdf/>", "it begins with <sdf>"),
    "nothing": ("", "is no XML"),
    "an entity that nobody declared": ("<robot>&x;</robot>", "is no XML"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_what_is_no_description_is_refused_in_one_line(what: str, tmp_path: Path) -> None:
    text, said = HOSTILE[what]
    with pytest.raises(ValueError, match=said):
        transmissions(text)
    bag, file = tmp_path / "b.mcap", tmp_path / "arm.urdf"
    file.write_text(text)
    with BagWriter(bag) as writer:
        writer.write("/robot_description", STRING, string_cdr(text), START)
    assert_one_line_error(hd_diag("topics", bag, "--urdf", file), str(file), said)
    told = hd_diag("topics", bag)
    assert told.exit_code == 0
    assert re.search(f"warning: /robot_description: .*{said}", told.stdout)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bag of an elbow with ratio 100 in ros2_control messages, and its description."""
    messages, folder = Messages(DYNAMIC), tmp_path_factory.mktemp("b")
    states = robots.dynamic_states(messages, columns(seconds=6.0))
    plain, path = messages.write(folder / "a.mcap", "/d", states), folder / "b.mcap"
    with BagReader(plain) as reader, BagWriter(path) as writer:
        (topic,) = reader.topics
        writer.add_topic(topic.name, topic.type_name, topic.offers, topic.definition)
        writer.write("/arm/robot_description", STRING, string_cdr(URDF.format(100)), reader.start)
        for batch in reader.batches():
            for data, time in zip(batch.messages(), batch.log_time.tolist(), strict=True):
                writer.write(topic.name, topic.type_name, bytes(data), time)
    return path


def asked(folder: Path, bag: Path, *more: object) -> tuple[dict[str, Any], str]:
    told = hd_diag("topics", bag, "--json", folder / "t.json", *more)
    assert told.exit_code == 0, told.stderr
    return json.loads((folder / "t.json").read_text()), told.stdout


def test_the_bag_s_own_description_gives_the_ratio(bag: Path, tmp_path: Path) -> None:
    found, told = asked(tmp_path, bag)
    assert {"source": "/arm/robot_description", "warnings": []}.items() <= found["description"].items()
    assert "transmissions of /arm/robot_description: elbow 100" in told
    assert "ratio: 100.0" in found["mapping"]
    (joint,) = found["joints"]
    assert joint["mapping"]["ratio"] == pytest.approx(joint["slope"], rel=1e-3)


def test_ratios_that_contradict_are_warnings(bag: Path, tmp_path: Path) -> None:
    """Angles and configuration each contradict the description's ratio.

    The proposed mapping has the angles' ratio, and the check of a configuration accepts it.
    """
    file, config = tmp_path / "arm.urdf", tmp_path / "arm.yaml"
    file.write_text(CONTROL.format(160))
    config.write_text(dump(resolve({"joints": ["elbow", "roll"], "roll.ratio": 100.0})))
    found, told = asked(tmp_path, bag, "--urdf", file, "--config", config)
    one, other = found["description"]["warnings"]
    assert re.fullmatch(r"elbow: the angles have a ratio of (99\.9\d|100), the .* description has 160", one)
    assert other == "elbow: ratio 100 is configured, the robot's description has 160"
    assert all(f"warning: {each}" in told for each in (one, other))
    assert found["description"]["unseen"] == ["roll", "pitch"]
    assert f"# {one}\n" in found["mapping"]
    config.write_text(found["mapping"])
    assert load(config).joints[0].drive.kinematics.ratio == 100.0


def test_what_the_check_of_a_configuration_asks_for_stands_above_what_is_to_paste(tmp_path: Path) -> None:
    """Angles and description have a ratio that the example drive's teeth do not have."""
    plain, file = tmp_path / "a.mcap", tmp_path / "arm.urdf"
    given = columns(seconds=6.0)
    given["output"] = given["output"] / 1.6
    messages = Messages(DYNAMIC)
    messages.write(plain, "/d", robots.dynamic_states(messages, given))
    file.write_text(URDF.format(160))
    found, _ = asked(tmp_path, plain, "--urdf", file)
    first, *rest = found["mapping"].splitlines()
    assert first.startswith("# to be completed: elbow: ratio 160 does not fit 200 and 202 teeth")
    assert "ratio: 160.0" in rest[-1]


@pytest.mark.parametrize(("ratio", "told"), [(100.0, 0), (100.4, 0), (-100.0, 1), (101.5, 1)])
def test_a_sign_contradicts_as_a_size_does(ratio: float, told: int) -> None:
    joints = resolve({"joints": ["elbow"]}).joints
    assert len(contradictions([Transmission("elbow", "", ratio)], joints)) == told
    assert np.isclose(joints[0].drive.kinematics.ratio, 100.0)
