"""`hd-diag watch` with real nodes, over DDS, in a separate process."""

import contextlib
import itertools
import json
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from live import MS, START, parameters
from pool_tasks import wait_for
from running import Rig, feed, running

pytestmark = pytest.mark.usefixtures("ros")

JOINTS = ("shoulder", "elbow")
COMMAND = [sys.executable, "-m", "hd_diag", "watch"]
SET_PARAMETERS = Path(__file__).resolve().parent.parent / "docs/examples/set_parameters.py"
LIMIT = 60.0  # on a busy machine [s]
TIMEOUT = 15  # for commands that wait in vain while other tests run [s]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A node with two joints that tolerates silence, and one sample of each."""
    folder = tmp_path_factory.mktemp("arm")
    silence = (f"{joint}.limits.silence.{level}" for joint in JOINTS for level in ("warn", "error"))
    with running(folder, parameters(*JOINTS, diagnostics_rate=10.0) | dict.fromkeys(silence, 1e6)) as rig:
        stamps, publisher = itertools.count(START, MS), rig.publisher()
        for joint in JOINTS:
            feed(publisher, stamps, 20, joint=joint)
            rig.values(joint, lambda values: int(values["samples"]) == 20)
        yield rig


def watch(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, timeout=LIMIT)


@contextlib.contextmanager
def started(*command: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=LIMIT)


def following(*arguments: str) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    return started(*COMMAND, *arguments)


@pytest.fixture(scope="module")
def waiting(arm: Rig) -> Iterator[list[subprocess.Popen[str]]]:
    """Commands that wait for an unknown joint, for a namespace without a node, and for such a node."""
    once, here = ("--once", "--timeout", str(TIMEOUT), "--namespace"), arm.process.namespace
    with (
        following(*once, here, "--joint", "elbow", "--joint", "elbow_9") as joint,
        following(*once, "/nowhere") as nowhere,
        started(sys.executable, str(SET_PARAMETERS), "/nobody/hd_diag", "elbow.torque=1.0") as nobody,
    ):
        yield [joint, nowhere, nobody]


def line_with(process: subprocess.Popen[str], *words: str) -> str:
    return next(line for line in process.stdout if all(each in line for each in words))


def test_once_shows_every_joint_as_the_diagnostics_say(arm: Rig, tmp_path: Path, monkeypatch) -> None:
    """JSON in a file; on a pipe, a table and one line per joint."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    arm.set(elbow__eccentricity__magnitude=18e-6, elbow__eccentricity__direction=1.5707963267948966)
    reported = {joint: arm.values(joint) for joint in JOINTS}
    reported["elbow"] = arm.values("elbow", lambda values: values["eccentricity_um"] == "18")
    file, node = tmp_path / "seen.json", f"{arm.process.namespace}/hd_diag"
    names = ("--joint", "elbow", "--joint", "shoulder", "--namespace", arm.process.namespace)
    run = watch("--once", *names, "--json", str(file))
    assert (run.returncode, run.stderr) == (0, "")
    lines = run.stdout.splitlines()
    assert [line.partition(": ")[0] for line in lines[-2:]] == [f"{node} elbow", f"{node} shoulder"]
    assert [line.split()[:3] for line in lines[-4:-2]] == [["elbow", "OK", "18.0"], ["shoulder", "OK", "0.0"]]
    assert all(line.isprintable() for line in lines)
    seen = json.loads(file.read_text())
    assert not seen["missing"]
    joints = {joint["joint"]: joint for joint in seen["joints"]}
    assert set(joints) == set(JOINTS)
    for name, joint in joints.items():
        place = (node, f"{node}/{name}", f"{arm.process.namespace}/diagnostics")
        assert (joint["node"], joint["hardware_id"], joint["topic"]) == place
        assert set(joint["values"]) == set(reported[name])
        assert joint["values"]["samples"] == 20
        for key in ("eccentricity_um", "minimum_backlash_um", "peak_tooth_load_N", "lost_motion_arcmin"):
            assert joint["values"][key] == pytest.approx(float(reported[name][key]), rel=1e-5), key
    assert joints["elbow"]["values"]["eccentricity_direction_deg"] == pytest.approx(90.0)


@pytest.mark.usefixtures("waiting")
def test_a_fault_appears_and_can_be_failed_on(arm: Rig) -> None:
    arguments = ("--namespace", arm.process.namespace, "--joint", "shoulder", "--fail-on-fault")
    arm.set(shoulder__eccentricity__magnitude=0.0)
    arm.values("shoulder", lambda values: values["fault_code"] == "OK")
    assert watch("--once", *arguments).returncode == 0
    with following(*arguments) as process:
        assert " shoulder: OK; " in line_with(process, "shoulder: ")
        arm.set(shoulder__eccentricity__magnitude=60e-6)
        assert " the lobes overlap by " in line_with(process, "shoulder: INTERFERENCE")
        assert process.wait(LIMIT) == 1
    run = watch("--once", *arguments, "--json")
    assert run.returncode == 1
    (joint,) = json.loads(run.stdout)["joints"]
    assert (joint["fault_code"], joint["level"]) == ("INTERFERENCE", "error")


def test_the_tour_s_way_to_set_parameters(arm: Rig) -> None:
    def set_them(*values: str) -> tuple[int, str]:
        command = [sys.executable, SET_PARAMETERS, f"{arm.process.namespace}/hd_diag", *values]
        run = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
        return run.returncode, run.stdout + run.stderr

    values = ("shoulder.eccentricity.magnitude=7e-6", "shoulder.torque=1.0")
    assert set_them(*values) == (0, "in force\n")
    arm.values("shoulder", lambda values: values["eccentricity_um"] == "7")
    code, said = set_them("shoulder.eccentricity.magnitude=0.0", "shoulder.ratio=3.0")
    assert (code, said[:9]) == (1, "refused: ")
    assert arm.values("shoulder")["eccentricity_um"] == "7"


def test_a_reader_that_has_enough(arm: Rig) -> None:
    with following("--namespace", arm.process.namespace) as process:
        line_with(process, "elbow: ")
        process.stdout.close()
        assert process.wait(LIMIT) == 0
        assert process.stderr.read() == ""
        process.stdout = None


def test_json_lines_until_a_signal(arm: Rig, tmp_path: Path) -> None:
    with following("--namespace", arm.process.namespace, "--json") as process:
        seen = [json.loads(next(process.stdout)) for _ in range(2)]
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=LIMIT)
        assert (process.returncode, errors) == (128 + signal.SIGTERM, "")
    assert {entry["schema"] for entry in seen} == {"hd_diag/watch/1"}
    assert {joint["joint"] for joint in seen[1]["joints"]} == set(JOINTS)
    run = watch("--json", str(tmp_path / "no" / "folder.json"))
    assert run.returncode == 2
    assert "cannot be written" in run.stderr


def test_a_full_disk_under_its_lines_is_one_line(arm: Rig) -> None:
    run = watch("--namespace", arm.process.namespace, "--json", "/dev/full")
    told = "hd-diag: /dev/full: cannot be written: No space left on device\n"
    assert (run.returncode, run.stderr) == (2, told)


def test_a_timeout_is_one_line_with_what_is_there(arm: Rig, waiting: list[subprocess.Popen[str]]) -> None:
    (shown, said), (nothing, why), (_, nobody) = (each.communicate(timeout=LIMIT) for each in waiting)
    assert [each.returncode for each in waiting] == [2, 2, 1]
    assert (shown.count(" elbow: "), nothing, nobody) == (1, "", "no node /nobody/hd_diag\n")
    assert f"no report of elbow_9 within {TIMEOUT} s" in said
    assert all(f"{arm.process.namespace}/hd_diag {joint}" in said for joint in JOINTS)
    assert why.startswith(f"hd-diag: no report of an hd_diag node within {TIMEOUT} s: ")
    assert f"there is {arm.process.namespace}/hd_diag" in why
    assert why.count("\n") == 1


def test_hostile_diagnostics_do_no_harm() -> None:
    """Over DDS on /diagnostics, which the nodes of these tests do not use."""
    node = rclpy.create_node("hostile")
    publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    text = "[red]\x1b[2J\x1b]0;title\x07\u202e" + "x" * 100_000
    values = [KeyValue(key=text, value=text), KeyValue(key="samples", value="9" * 5000)]
    evil = DiagnosticStatus(level=b"\x63", name=f"hd_diag: {text}", message=text, values=values)
    plain = DiagnosticStatus(level=b"\x01", name=text, message=text, hardware_id=text)
    with following() as process:
        shown = lambda: select.select([process.stdout], [], [], 0.1)[0]  # noqa: E731
        wait_for(lambda: shown() and publisher.get_subscription_count())
        for _ in range(5):
            publisher.publish(DiagnosticArray(status=[evil, plain]))
        line = line_with(process, "[red]\\x1b[2J", "LEVEL 99")
        assert line.rstrip("\n").isprintable()
        assert len(line) < 4000
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=LIMIT)
        assert (process.returncode, errors) == (130, "")
    node.destroy_node()
