"""The real node over DDS against the replay of its own log and of a bag played to it."""

import itertools
import random
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from live import MS, RATIO, START, config, message, with_log
from logs import content, replayed, whole
from player import Player, angles
from running import running, stamp_of, values_of
from sensor_msgs.msg import JointState

from hd_diag.bag import BagWriter, recover
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.messages.publications import JOINT_STATE
from hd_diag.replay.replay import replay

# No message of zero bytes: after one, Fast DDS delivers nothing more from that publisher.
pytestmark = pytest.mark.usefixtures("ros")

HOSTILE = (
    b"\0\1\0\0",
    b"\0\1\0\0" + b"\xff" * 60,
    bytes(range(256)),
    message(START, {"a_motor": np.nan, "a": 0.0}),
    message(START, {"a_motor": 1.0, "a": np.inf}, {"a": np.nan}),
    message(START - 10**15, {"b_motor": 1.0}),
    message(START, {"a_motor": 1e308, "a": -1e308}),
    message(START, {"": 1.0, "x" * 5000: 2.0}),
    message(START, {"stranger": 1.0}),
    message(START, {}),
)


def turning(stamp: int) -> dict[str, float]:
    seconds = (stamp - START) * 1e-9
    angle, other = 12.0 * np.sin(1.1 * seconds), 20.0 * np.cos(0.7 * seconds)
    ripple = 1e-4 * np.sin(2.0 * angle)
    return {"a_motor": angle, "a": angle / RATIO + ripple, "b_motor": other, "b": other / RATIO}


def feed_roughly(publisher, stamps, count: int, chance: random.Random) -> None:
    """Publish two joints together and separately, with invalid messages in between."""
    begin, rate = time.monotonic(), 500.0  # [Hz]
    for number in range(count):
        stamp = next(stamps)
        every = turning(stamp)
        torque = {"a": 4.0 * np.sin(0.01 * number), "b": 2.0}
        if number % 50 < 40:
            publisher.publish(message(stamp, every, torque))
        else:
            publisher.publish(message(stamp, {k: every[k] for k in ("b_motor", "a_motor")}))
            publisher.publish(message(stamp - MS // 2, {k: every[k] for k in ("a", "b")}, torque))
        if number % 47 == 5:
            publisher.publish(chance.choice(HOSTILE))
        time.sleep(max(0.0, begin + (number + 1) / rate - time.monotonic()))


def test_a_replay_of_the_nodes_log_is_the_same_to_the_last_bit(tmp_path: Path) -> None:
    log = tmp_path / "log"
    given = with_log(log, "a", "b", overwrite=True) | {"diagnostics_rate": 5.0, "mesh_rate": 5.0}
    changes = [
        {"a__eccentricity__magnitude": 8e-6},
        {"a__limits__residual_rms__warn": 1e-6, "a__limits__residual_rms__error": 2e-6},
        {"array_rate": 50.0, "b__torque": -1.5},
        {"a__eccentricity__direction": 1.0, "b__runout__magnitude": 3e-6},
        {"diagnostics_rate": 10.0, "mesh_rate": 0.0},
        {"a__eccentricity__magnitude": 0.0, "b__rated_torque": 8.0},
    ]
    with running(tmp_path, given) as rig:
        publisher, stamps, chance = rig.publisher(), itertools.count(START, 2 * MS), random.Random(3)
        for change in changes:
            feed_roughly(publisher, stamps, 250, chance)
            assert all(result.successful for result in rig.set(**change))
        feed_roughly(publisher, stamps, 300, chance)
        # On a busy machine the node may be silent while samples wait.
        rig.values("b", lambda v: int(v["samples"]) > 1500 and float(v["silence_s"]) > 0.2)
        assert rig.process.end(signal.SIGINT) == 0
    result = replay(log, tmp_path / "again")
    live = content(log)
    assert result.reproduced
    assert content(tmp_path / "again") == live
    node = f"{rig.process.namespace}/hd_diag"
    assert min(len(live[f"{node}/{topic}"]) for topic in ("transmission_error", "residual")) > 1500
    assert len(live["/parameter_events"]) == 1 + sum(map(len, changes))
    assert len(live[f"{rig.process.namespace}/diagnostics"]) > 15
    assert result.rejected["a"] > 10
    assert {f"{node}/a/backlash", f"{node}/b/load", f"{node}/a/mesh", f"{node}/events"} <= live.keys()


def test_samples_come_before_arrays_and_the_replay_thins_out_alike(tmp_path: Path) -> None:
    """After a stop the node takes all samples but publishes few arrays."""
    joints, count = [f"j{number}" for number in range(7)], 600
    given = with_log(tmp_path / "log", *joints, overwrite=True)
    with running(tmp_path, given | {"mesh_rate": 60.0, "array_rate": 280.0}) as rig:
        publisher, stamps = rig.publisher(), itertools.count(START, 4 * MS)

        def recovers(values: dict[str, str]) -> bool:
            """The share of arrays doubles every second until it is complete."""
            shares = [float(values_of(array.status[-1])["array_share"]) for array in rig.reports]
            return values["samples"] == str(count) and min(shares) < shares[-1]

        rig.process.popen.send_signal(signal.SIGSTOP)
        for stamp in itertools.islice(stamps, count):
            angle = 1e-9 * (stamp - START)
            publisher.publish(message(stamp, {f"{joint}_motor": angle for joint in joints}))
        rig.process.popen.send_signal(signal.SIGCONT)
        rig.until(lambda: "% of the per-tooth arrays" in rig.process.output(), "fewer arrays")
        assert "keep up" in rig.process.output()
        assert rig.set(j0__torque=1.0)[0].successful
        rig.values("j6", recovers)
        assert rig.process.end() == 0
    live = replayed(tmp_path / "log")
    assert len(live[f"{rig.process.namespace}/hd_diag/j0/load"]) < 0.9 * count


RATE = 250.0  # [Hz]
STEP = round(1e9 / RATE)  # [ns]


def recorded(path: Path, seconds: float = 3.0) -> int:
    """Write a bag with log times a little after the stamps; returns the number of samples."""
    stamps = START + STEP * np.arange(round(seconds * RATE))
    columns = [list(turning(int(stamp)).values()) for stamp in stamps]
    efforts = np.tile([0.0, 1.5, 0.0, -1.0], (stamps.size, 1))
    rows = encode_joint_states(("a_motor", "a", "b_motor", "b"), stamps, columns, None, efforts)
    with BagWriter(path) as writer:
        writer.write_many("/joint_states", JOINT_STATE, rows, stamps + 300_000)
    return stamps.size


def test_a_bag_played_live_equals_its_replay(tmp_path: Path) -> None:
    bag, log, loops = tmp_path / "bag", tmp_path / "log.mcap", 3
    count = recorded(bag)
    dropped = {*range(20, 700, 45), 300, 301, 302}
    with running(tmp_path, with_log(log, "a", "b") | {"use_sim_time": True}) as rig:
        for joint in ("a", "b"):
            rig.values(joint, lambda values: values["prediction"] == "map")
        player = Player(rig, bag)
        published = player.play(4.0, loops, dropped)
        assert published == loops * (count - len(dropped))
        values = rig.values("a", lambda values: int(values["samples"]) == published)
        reported = stamp_of(rig.reports[-1])
        assert rig.process.end(signal.SIGINT) == 0
    assert START <= reported <= START + 3.1e9
    names = ("samples_missed", "clock_jumps", "samples_rejected")
    assert [int(values[name]) for name in names] == [loops * len(dropped), loops - 1, 0]
    replay(bag, tmp_path / "offline", config("a", "b"))
    node = f"{rig.process.namespace}/hd_diag"
    for topic in ("transmission_error", "measured_transmission_error", "residual"):
        offline = angles(tmp_path / "offline", f"/hd_diag/{topic}")
        assert len(offline) == count
        kept = [entry for number, entry in enumerate(offline) if number not in dropped]
        assert angles(log, f"{node}/{topic}") == kept * loops


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_killed_node_loses_less_than_a_second(tmp_path: Path, seed: int) -> None:
    """Samples that others received at least half a second before the last report are in the log."""
    log, chance = tmp_path / "log", random.Random(seed)
    given = with_log(log, "a", "b", overwrite=True, sync_period=0.0)  # does not depend on the disk
    with running(tmp_path, given) as rig:
        (errors,) = rig.hear({"hd_diag/transmission_error": JointState}).values()
        publisher, stamps = rig.publisher(), itertools.count(START, 2 * MS)
        acknowledged: list[tuple[float, int]] = []
        seconds = chance.uniform(1.5, 3.0)
        while not acknowledged or time.time() < acknowledged[0][0] + seconds:
            stamp = next(stamps)
            publisher.publish(message(stamp, turning(stamp), {"a": 1.0}))
            time.sleep(0.0015)
            rig.drain()
            now = time.time()
            acknowledged += [(now, stamp_of(m)) for m in errors[len(acknowledged) :]]
        rig.process.popen.kill()
        rig.process.popen.wait(60.0)
        last = stamp_of(rig.reports[-1]) * 1e-9
    assert recover(log, tmp_path / "saved").counts
    topics = (f"{rig.process.namespace}/{topic}" for topic in ("hd_diag/transmission_error", "joint_states"))
    saved, inputs = ([stamp for stamp, _ in angles(tmp_path / "saved", topic)] for topic in topics)
    safe = {stamp for when, stamp in acknowledged if when < last - 0.5}
    assert set() != safe <= set(saved)
    assert np.all(np.diff(saved) == 2 * MS)
    assert inputs[: len(saved)] == saved
    replay(tmp_path / "saved", tmp_path / "again")
    assert whole(tmp_path / "again")
