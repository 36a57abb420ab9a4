"""Interface of ``import hd_diag``: its page runs, equals the command line, and imports instantly."""

import doctest
import inspect
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from cli_runner import hd_diag as command

import hd_diag
from hd_diag.config.configuration import ConfigError
from hd_diag.diagnosis.record import RecordError

PAGE = Path(__file__).resolve().parent.parent / "docs/python.md"
ELBOW = [
    f"--{word}"
    for word in ["size=20", "ratio=160", "rated-torque=40", "k1=16e3", "k2=25e3", "k3=29e3", "t1=7", "t2=25"]
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Parameter file of a catalogue page, and a record as in the docs, but shorter and with one section."""
    place = tmp_path_factory.mktemp("notebook")
    page, config, bag = place / "page.yaml", place / "elbow.yaml", place / "elbow.mcap"
    assert command("gear", *ELBOW, "--accuracy=1", "--joint=elbow", "--out", page).exit_code == 0
    parameters = yaml.safe_load(page.read_text())
    parameters["hd_diag"]["ros__parameters"]["elbow"]["sections"] = 1
    config.write_text(yaml.safe_dump(parameters))
    errors = ("--eccentricity-um=6", "--direction-deg=40", "--angle-noise-arcsec=2", "--torque-noise=0.1")
    motion = ("--duration=20", "--rate=100", "--out", bag)
    assert command("simulate", "--config", config, *errors, *motion).exit_code == 0
    return place


def test_the_page_in_python_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    found = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert found.attempted > 15
    assert found.failed == 0


def test_a_moment_is_that_of_the_command_line(folder: Path) -> None:
    drive = hd_diag.load(folder / "elbow.yaml")["elbow"].drive
    words = ("--config", folder / "elbow.yaml", "--input-angle=0.7", "--torque=9", "--json=-")
    told = json.loads(command("mesh", *words).stdout)
    state = hd_diag.mesh_state(drive, 0.7, [9.0])
    assert state.torsion[0] == told["torsion"]
    assert hd_diag.transmission_error(drive, [0.7], 9)[0] == told["transmission_error"]
    for name, values in (("load", state.load), ("backlash", state.backlash)):
        expected = np.array([told[name][sign] for sign in "+-"], dtype=float)
        np.testing.assert_array_equal(values[0], expected)
    with pytest.raises(ValueError, match=r"angle \(3,\) \[rad\] and torque \(4,\) \[N m\] differ in shape"):
        hd_diag.transmission_error(drive, np.zeros(3), np.zeros(4))
    driven = hd_diag.mesh_state(drive, 0.7, drive.frame.cup_torque(np.array([9.0])))
    assert driven.torsion[0] == told["as_driven"]["torsion"]


def test_a_gear_is_that_of_the_command_line(folder: Path) -> None:
    by_values = {key: float(value) for key, value in (word[2:].split("=") for word in ELBOW)}
    by_values["rated_torque"] = by_values.pop("rated-torque")
    drive = hd_diag.load(folder / "page.yaml")["elbow"].drive
    own = hd_diag.gear(by_values, accuracy=drive.accuracy)
    assert own == drive
    assert repr(own) == "<Drive: ratio 160, 320/322 teeth, rated 40 N m, eccentricity 0 µm>"
    assert hd_diag.gear("csg-25-100", output="circular_spline").kinematics.ratio == 101.0
    with pytest.raises(ConfigError, match="no gear 'CSF-25-100' in the table"):
        hd_diag.gear("CSF-25-100")
    with pytest.raises(ConfigError, match=r"unknown parameter 'joint_1.k4'"):
        hd_diag.gear("CSG-25-100", k4=1.0)


def test_a_csv_file_is_read(folder: Path) -> None:
    joint = hd_diag.load(folder / "elbow.yaml")["elbow"]
    bag = hd_diag.read(folder / "elbow.mcap", joint)
    rows = np.column_stack([bag.time, np.degrees(bag.input_angle), bag.output_angle, bag.torque])
    np.savetxt(folder / "e.csv", rows, delimiter=",", header="t,motor,link,torque", comments="", fmt="%.17g")
    columns = {"time": "t", "input": "motor[deg]", "output": "link", "torque": "torque"}
    record = hd_diag.read(folder / "e.csv", joint, columns)
    np.testing.assert_allclose(record.input_angle, bag.input_angle, atol=1e-9)
    with pytest.raises(RecordError, match=r"e.csv: a table needs columns, as \{.*hd-diag topics .*e.csv"):
        hd_diag.read(folder / "e.csv", joint)


def test_a_joint_is_given_by_its_name_too_and_all_of_a_file_are_not_one(folder: Path) -> None:
    joints = hd_diag.load(folder / "elbow.yaml")
    named = hd_diag.read(folder / "elbow.mcap", "elbow")
    whole = hd_diag.read(folder / "elbow.mcap", joints["elbow"])
    np.testing.assert_array_equal(named.output_angle, whole.output_angle)
    with pytest.raises(TypeError, match=r'one joint, as load\(file\)\["elbow"\] or "elbow", not all'):
        hd_diag.read(folder / "elbow.mcap", joints)
    joint = joints["elbow"]
    for drive in (joints, joint, "elbow"):
        with pytest.raises(TypeError, match=r'as load\(file\)\["elbow"\]\.drive or gear\(name\), not '):
            hd_diag.mesh_state(drive, 0.0, 1.0)
        with pytest.raises(TypeError, match="expected a drive"):
            hd_diag.diagnose(whole, drive)
    with pytest.raises(TypeError, match=r"a record of hd_diag\.read, not str"):
        hd_diag.diagnose("elbow.mcap", joint.drive)


def test_importing_it_loads_nothing_and_its_names_are_typed_and_told() -> None:
    code = (
        "import sys; before = set(sys.modules); import hd_diag; dir(hd_diag); "
        "print({'numpy', 'numba', 'scipy', 'rclpy', 'yaml', 'click'} & (set(sys.modules) - before), "
        "[m for m in sys.modules if m.startswith('hd_diag')])"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.strip() == "set() ['hd_diag']"
    for name in hd_diag.__all__:
        function = getattr(hd_diag, name)
        assert name in dir(hd_diag)
        assert function.__doc__
        assert set(inspect.get_annotations(function)) == {*inspect.signature(function).parameters, "return"}
    with pytest.raises(AttributeError, match="module 'hd_diag' has no attribute 'gears_'"):
        _ = hd_diag.gears_
