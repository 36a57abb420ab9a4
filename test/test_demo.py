"""The demo as a user runs it: real processes over DDS, a log, and an end that leaves no process."""

import json
import os
import signal
import statistics
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from demo.log import read_log
from demo.process import Child, DemoError
from demo.run import run as demo_run
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
TOPICS = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/hd_diag/transmission_error": "sensor_msgs/msg/JointState",
    "/hd_diag/joint_1/load": "std_msgs/msg/Float64MultiArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
}


def demo(folder: Path, *arguments: str, **environment: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "hd_diag", "demo", "--out", str(folder), *arguments]
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, **pipes, env=os.environ | environment, start_new_session=True)


def processes_of(folder: Path) -> list[str]:
    """Command lines of running processes that contain the folder's name."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:  # ended meanwhile
            continue
        if str(folder) in line:
            found.append(line)
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """One complete run: folder, output, summary."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    process = demo(folder, "--seconds", "8", "--json", str(folder.parent / "summary.json"))
    out, err = process.communicate(timeout=400)
    assert (process.returncode, err) == (0, ""), out
    summary = json.loads((folder.parent / "summary.json").read_text())
    return {"folder": folder, "out": out, "summary": summary}


def test_demo_is_complete_and_leaves_nothing_running(run: dict[str, Any]) -> None:
    summary = run["summary"]
    assert summary["schema"] == "hd_diag/demo/1"
    assert (summary["complete"], summary["missing"], summary["problems"]) == (True, [], [])
    assert summary["exit_codes"] == {"joint": 0, "node": 0}
    assert processes_of(run["folder"]) == []
    refused = summary["refused"]
    assert (refused["parameter"], refused["value"]) == ("joint_1.circular_spline_teeth", 203)
    assert "must exceed flexspline_teeth (200, at least 20) by 2 or 4" in refused["reason"]
    assert f"refused: {refused['reason']}" in run["out"]


def test_prediction_backlash_and_residual_move_with_the_eccentricity(run: dict[str, Any]) -> None:
    steps = run["summary"]["steps"]
    assert [step["eccentricity_um"] for step in steps] == [0.0, 5.0, 10.0, 18.0, 23.0]
    errors = [step["predicted_te_pp_arcsec"] for step in steps]
    assert errors[0] < 0.2  # tooth passing only
    assert errors == sorted(errors)
    assert errors[-1] == pytest.approx(55.0, abs=2.0)  # exact solution over a turn, at 14 N m
    assert steps[0]["minimum_backlash_um"] == pytest.approx(0.94, abs=0.02)
    assert all(step["minimum_backlash_um"] < 0.5 for step in steps[1:])
    assert steps[0]["lost_motion_arcmin"] == pytest.approx(0.210, abs=0.002)
    rates = [step["sample_rate_hz"] for step in steps]
    assert statistics.median(rates) == pytest.approx(250.0, rel=0.05)  # a busy machine may delay a step
    found = {step["eccentricity_um"]: step["residual_rms_arcsec"] for step in steps}
    residual = {um: rms for um, rms in found.items() if rms is not None}  # a busy machine may miss a step
    assert len(residual) > 1
    assert min(residual, key=residual.__getitem__) == 18.0  # the true one
    assert residual[18.0] == pytest.approx(1.0, abs=0.3)  # noise of the simulated encoder


def test_log_is_read_with_types_by_rosbags_and_mcap_ros2(run: dict[str, Any]) -> None:
    with AnyReader([run["folder"] / "log"]) as reader:
        counts = Counter(connection.topic for connection, _, _ in reader.messages())
        assert TOPICS.items() <= {(c.topic, c.msgtype) for c in reader.connections}
    assert counts["/joint_states"] == run["summary"]["published"] > 8 * 250 * 0.9
    assert counts["/hd_diag/transmission_error"] == counts["/joint_states"]
    assert {e["topic"]: e["count"] for e in run["summary"]["topics"]} == counts
    (path,) = (run["folder"] / "log").glob("*.mcap")
    changes = [
        (parameter.name, parameter.value.double_value)
        for message in read_ros2_messages(str(path), topics=["/parameter_events"])
        for parameter in message.ros_msg.changed_parameters
    ]
    magnitude = "joint_1.eccentricity.magnitude"
    assert changes == [(magnitude, pytest.approx(value)) for value in (5e-6, 10e-6, 18e-6, 23e-6)]


def test_replay_of_the_log_is_equal_and_the_verdict_true(run: dict[str, Any]) -> None:
    summary, out = run["summary"], run["out"]
    outputs = [e for e in summary["topics"] if e["topic"].startswith("/hd_diag/")]
    assert summary["replayed"] > sum(e["count"] for e in outputs if e["topic"] != "/hd_diag/events")
    verdict = json.loads((run["folder"] / "verdict.json").read_text())
    magnitude = verdict["refit"]["parameters"]["eccentricity.magnitude"]
    assert magnitude["value"] == pytest.approx(18e-6, abs=max(4.0 * magnitude["std"], 2e-7))
    assert (verdict["causes"], verdict["verdict"]) == ([], summary["verdict"])
    assert f"Verdict: {verdict['verdict']}" in out.replace("\n", " ")
    assert "<html" in (run["folder"] / "report.html").read_text()
    assert "\x1b" not in out
    in_force = "set joint_1.eccentricity.magnitude = 18 µm: in force\n"
    for words in (in_force, "\n      18.0 ", f"Log: {run['folder'] / 'log'}", "Complete: "):
        assert words in out


def test_log_of_an_earlier_run_is_not_touched_and_damage_is_a_problem(tmp_path: Path) -> None:
    (tmp_path / "log_0.mcap").write_bytes(b"not a bag")
    (problem,) = read_log(tmp_path).problems
    assert "cannot be read: " in problem
    (tmp_path / "log").mkdir()
    with pytest.raises(DemoError, match="log exists already: name another folder"):
        demo_run(tmp_path, 5.0)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_it_with_a_readable_log(number: signal.Signals, tmp_path: Path) -> None:
    process = demo(tmp_path / "out", "--seconds", "60")
    for line in process.stdout:
        if line.startswith("set "):
            break
    time.sleep(1.0)
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (128 + number, "")
    assert "NOT COMPLETE: it was interrupted" in out
    assert processes_of(tmp_path) == []
    log = read_log(tmp_path / "out/log")
    assert log.problems == []
    assert log.counts["/joint_states"] > 100


@pytest.mark.slow
def test_processes_that_do_not_see_each_other(tmp_path: Path) -> None:
    process = demo(tmp_path / "out", ROS_AUTOMATIC_DISCOVERY_RANGE="OFF")
    _, err = process.communicate(timeout=120)
    assert process.returncode == 2
    assert err.startswith("hd-diag: node and joint run but were not discovered over DDS within 20 s: ")
    assert len(err.splitlines()) == 1
    assert processes_of(tmp_path) == []


def test_node_that_cannot_start_is_named(tmp_path: Path) -> None:
    command = [str(EXAMPLES / "demo/simulated_joint.py"), "--config", "none.yaml"]
    said = "simulated_joint.py ended early with code 2: simulated_joint: none.yaml: cannot be read"
    with Child(command, tmp_path / "out.txt") as child:
        assert child.finish(60.0, []) == 2
        with pytest.raises(DemoError, match=f"^{said}"):
            child.check_running()


def test_child_that_ignores_sigint_is_killed(tmp_path: Path) -> None:
    """The child runs in its output's folder: from a source tree, it would import that package."""
    stubborn = (
        "import os, signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); "
        "print(os.getcwd(), flush=True); time.sleep(60)"
    )
    with Child(["-c", stubborn], tmp_path / "out.txt", end_limit=0.2) as child:
        while not child.lines:
            time.sleep(0.02)
        with pytest.raises(KeyboardInterrupt):
            child.finish(60.0, [signal.SIGTERM])
    assert (child.end(), child.lines) == (-signal.SIGKILL, [str(tmp_path)])
