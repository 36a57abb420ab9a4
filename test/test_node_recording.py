"""Snapshots and diagnoses beside a running node, by services and automatically, over DDS."""

import contextlib
import itertools
import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from cli_runner import hd_diag
from live import MS, START, parameters, with_log
from logs import content, whole
from player import Player
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from running import Rig, children, feed, running, stamp_of
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool

from hd_diag.bag import BagError, BagReader
from hd_diag.bag.recover import recover
from hd_diag.replay.replay import replay

pytestmark = pytest.mark.usefixtures("ros")
PATIENCE = 600.0  # for processes of lowest priority on a busy machine [s]
IDLE = "keeping the last 60 s"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp("recorded")
    given = with_log(folder / "log", mode="snapshot", before=60.0, after=0.3, topics="inputs")
    with running(folder, given | {"use_sim_time": True}) as rig:
        rig.values("joint_1", lambda values: values["prediction"] == "map")
        rig.log = folder / "log"  # type: ignore[attr-defined]
        yield rig


@pytest.fixture(scope="module")
def player(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Player:
    bag = tmp_path_factory.mktemp("simulated") / "joint.mcap"
    words = ("simulate", "--out", bag, "--duration", 6, "--rate", 250, "--eccentricity-um", 18)
    assert hd_diag(*words).exit_code == 0
    return Player(rig, bag)


def state(rig: Rig, key: str, text: str) -> dict[str, str]:
    return rig.values("joint_1", lambda values: values[key].startswith(text))


def asked(rig: Rig, service: str, *kind: type, **fields: bool) -> str:
    """Call a service and return the path that it gives."""
    ok, said = rig.call(service, *kind, **fields)
    assert ok, said
    return said


def test_a_snapshot_holds_what_was_before_it_and_replays(rig: Rig, player: Player, tmp_path: Path) -> None:
    """A new fault writes a snapshot; later data start a new one, with everything known."""
    sent = player.play(1.0, 1, ())
    values = rig.values("joint_1", lambda values: int(values["samples"]) >= sent - 50)
    assert values["samples_missed"] == values["messages_lost"] == "0", values
    log: Path = rig.log  # type: ignore[attr-defined]
    rig.until(log.exists, "snapshot of a fault")  # RESIDUAL, otherwise STALE
    state(rig, "log_state", IDLE)
    taken = asked(rig, "snapshot")
    state(rig, "log_state", IDLE)
    assert Path(taken).is_dir()
    counted, topic = 0, f"{rig.process.namespace}/joint_states"
    bags = sorted(log.iterdir())
    assert len(bags) >= 2
    for number, bag in enumerate(bags):
        whole(bag)
        replay(bag, tmp_path / f"{number}.mcap")
        logged, again = content(bag), content(tmp_path / f"{number}.mcap")
        counted += len(logged.get(topic, []))
        assert all(again[name] == logged[name] for name in logged)
    assert sent - 20 <= counted <= sent  # nothing waits between a snapshot and the memory's new beginning


def test_a_log_is_begun_and_ended(rig: Rig, player: Player) -> None:
    begun = asked(rig, "start_log")
    state(rig, "log_state", f"writing {begun}")
    assert asked(rig, "stop_log") == begun
    state(rig, "log_state", IDLE)
    assert rig.call("stop_log") == (False, "~/stop_log: nothing is being written")
    again = asked(rig, "log", SetBool, data=True)
    assert again != begun
    assert asked(rig, "log", SetBool, data=False) == again
    state(rig, "log_state", IDLE)


def test_it_diagnoses_without_losing_a_sample(rig: Rig, player: Player) -> None:
    """It answers at once and runs one at a time; late subscribers get the verdict, too."""
    player.play(2.0, 1, ())
    counts: list[str] = []
    # A busy node is still taking samples: it has them all when two reports agree.
    before = rig.values("joint_1", lambda v: counts.append(v["samples"]) or counts[-2:-1] == counts[-1:])
    verdict, begin = Path(asked(rig, "diagnose")), time.monotonic()
    ok, busy = rig.call("diagnose")
    assert (ok, time.monotonic() - begin < 10.0) == (False, True)
    assert busy.startswith("~/diagnose: one is under way: ")
    assert str(verdict) in busy
    sent = player.play(1.0, 1, ())
    rig.until(verdict.is_file, "verdict", PATIENCE)
    state(rig, "diagnosis_state", "done")
    values = rig.values("joint_1", lambda v: int(v["samples"]) == int(before["samples"]) + sent)
    assert (values["samples_missed"], values["messages_lost"]) == ("0", "0")
    result = json.loads(verdict.read_text())
    expected = ("hd_diag/diagnosis/1", str(verdict.with_suffix(".html")))
    assert (result["schema"], result["report"]) == expected
    assert "<html" in Path(result["report"]).read_text()
    for each in result["files"]:  # times equal those in the log
        with BagReader(each["path"]) as reader:
            assert (each["from"], each["to"]) == pytest.approx((reader.start * 1e-9, reader.end * 1e-9))
    assert max(each["to"] for each in result["files"]) == pytest.approx(time.time(), abs=PATIENCE)
    assert " ".join(result["verdict"].split()).startswith(values["verdict"].removesuffix("…"))
    assert len(values["verdict"]) > 100
    assert values["verdict_time"].startswith(time.strftime("%Y-"))
    with watching(rig) as (_, shows):
        rig.until(lambda: shows(f"verdict of {values['verdict_time']}: "), "verdict in watch")
        rig.until(lambda: all(map(shows, values["verdict"].split(";")[0].split())), "its words")
    heard: list[String] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    rig.node.create_subscription(String, "hd_diag/verdict", heard.append, latched)
    rig.until(lambda: heard, "latched verdict")
    assert json.loads(heard[0].data) == result


def test_diagnoses_that_are_killed_or_outlived(rig: Rig, player: Player) -> None:
    pid = rig.process.popen.pid
    for number in (signal.SIGKILL, signal.SIGINT):
        player.play(10.0, 1, ())  # an earlier diagnosis may have used data older than a snapshot
        asked(rig, "diagnose")
        state(rig, "diagnosis_state", "diagnoses")
        (child,) = rig.until(lambda: children(pid, b"diagnose"), "process")
        assert os.getpriority(os.PRIO_PROCESS, child) == 19
        if number == signal.SIGKILL:
            os.kill(child, number)
            state(rig, "diagnosis_state", "failed: was ended by SIGKILL")
    assert rig.process.end(signal.SIGINT) == 0
    assert children(pid, b"diagnose") == []
    assert not Path(f"/proc/{child}").exists()


@contextlib.contextmanager
def watching(rig: Rig) -> Iterator[tuple[int, Callable[[str], bool]]]:
    """`hd-diag watch` in a terminal: file for its keys, and a check for shown text."""
    screen, theirs = pty.openpty()
    verb = [sys.executable, "-m", "hd_diag", "watch", "--namespace", rig.process.namespace]
    process = subprocess.Popen(["setsid", "--ctty", *verb], stdin=theirs, stdout=theirs, stderr=theirs)
    shown = b""

    def shows(text: str) -> bool:
        nonlocal shown
        while select.select([screen], [], [], 0.0)[0]:
            shown += os.read(screen, 1 << 16)
        return text.encode() in shown

    try:
        yield screen, shows
    finally:
        process.kill()
        process.wait()


def test_without_a_log_there_is_no_diagnosis(tmp_path: Path) -> None:
    """A key of watch requests one in a terminal and shows the answer; motion requests one, too."""
    given = parameters(diagnostics_rate=10.0, diagnose__every=0.1)
    with running(tmp_path, given) as rig, watching(rig) as (screen, shows):
        rig.until(lambda: shows("joint_1"), "picture of watch")
        os.write(screen, b"d")
        rig.until(lambda: shows("no diagnosis: "), "answer in watch")
        feed(rig.publisher(), itertools.count(START, 10 * MS), 50, 100.0)
        state(rig, "diagnosis_state", "failed: ~/diagnose: there is no log: call ~/start_log")


def taken_in(bag: Path) -> list[int]:
    """Stamps [ns] of the joint states in a bag or in its readable part."""
    try:
        states = [found for topic, found in content(bag).items() if topic.endswith("/joint_states")]
    except BagError:
        return []
    return [stamp_of(deserialize_message(data, JointState)) for found in states for _, data in found]


def test_of_a_node_that_is_killed_what_is_on_disk_is_read(tmp_path: Path) -> None:
    """The disk has the first samples without a gap, and they replay; the rest was only in memory."""
    log, count = tmp_path / "log", 2000
    stamps = range(START, START + count * MS, MS)
    with running(tmp_path, with_log(log, mode="snapshot", before=60.0, after=60.0)) as rig:
        feed(rig.publisher(), iter(stamps), count)
        rig.values("joint_1", lambda values: int(values["samples"]) == count)
        assert not log.exists()
        taken = Path(asked(rig, "snapshot"))
        rig.until(lambda: taken_in(taken), "samples on the disk")
        rig.process.popen.kill()
        rig.process.popen.wait()
    (bag,) = log.iterdir()
    found = taken_in(bag)
    assert found == [*stamps[: len(found)]]
    with BagReader(bag) as reader:
        assert any("has no end" in problem for problem in reader.problems)
    recover(bag, tmp_path / "saved")
    replay(tmp_path / "saved", tmp_path / "again")
    logged, again = content(tmp_path / "saved"), content(tmp_path / "again")
    assert taken_in(tmp_path / "saved") == found
    for topic, messages in again.items():
        assert messages[: len(logged.get(topic, []))] == logged.get(topic, []), topic
