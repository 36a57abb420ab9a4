"""Bags that no node would write: logs with damaged files, messages or events."""

import itertools
import json
import random
import re
import struct
from pathlib import Path

from bag_samples import cut_end, damaged, write_with_mcap
from cli_runner import runner
from click.testing import Result
from live import MS, RATIO, START, config, message
from logs import Log, messages_of

from hd_diag.bag import BagError, BagReader
from hd_diag.cli.verbs.bags import recover, replay
from hd_diag.diagnosis.record import RecordError
from hd_diag.messages.publications import STRING, read_string, resolved, string
from hd_diag.records.joint_record import read_bags
from hd_diag.replay.recorded_monitor import EVENTS, Session

JOINT_STATE = "sensor_msgs/msg/JointState"
CONFIG = config("a", "b", array_rate=5.0)
CONFIG_TEXT = json.dumps({"hd_diag": {"ros__parameters": dict(CONFIG.flat)}})
Message = tuple[str, str, bytes, int]


def log_of(path: Path) -> Path:
    """A small log like the node's, without maps, which take time."""
    log = Log(path, chunk_size=4000)
    session = Session(CONFIG, log)
    session.start(START)
    for i in range(1, 60):
        now = START + i * 4 * MS
        log.clock = itertools.count(now)
        position = {"a_motor": 0.01 * i, "a": 0.01 * i / RATIO, "b_motor": 0.0}
        log.receive(session, message(now, position, {"a": 1.0}))
        if i == 30:
            session.configure(now + 1, config("a", "b", array_rate=5.0, a__eccentricity__magnitude=5e-6))
        if i % 20 == 0:
            session.tick(now + 2, now, {"log_state": "off", "latency_p99_us": "50"})
    log.writer.close()
    return path


def spoiled_messages(messages: list[Message], chance: random.Random) -> list[Message]:
    """Messages with some damaged, repeated, moved in time, left out or put on another topic."""
    made = list(messages)
    for _ in range(chance.randint(1, 5)):
        at = chance.randrange(len(made))
        topic, kind, data, time = made[at]
        what = chance.randrange(6)
        if what == 0:
            made[at] = (topic, kind, damaged(data, chance), time)
        elif what == 1:
            time = chance.choice([0, max(0, time - 10**9), time + 10**9, 2**31 * 10**9, 2**62])
            made[at] = (topic, kind, data, time)
        elif what == 2:
            del made[at]
        elif what == 3:
            made.insert(at, (topic, kind, data[: chance.randrange(len(data) + 1)], time))
        elif what == 4 and kind == JOINT_STATE:
            place = chance.randrange(0, max(1, len(data) - 8))
            extreme = chance.choice([float("nan"), 1e308, -1e308, 5e-324, float("inf")])
            made[at] = (topic, kind, data[:place] + struct.pack("<d", extreme) + data[place + 8 :], time)
        else:
            topic = chance.choice(["/joint_states", "/x", "/hd_diag/events", "/hd_diag/residual", "x" * 3000])
            made[at] = (topic, kind, data, time)
        if not made:
            return messages[:1]
    return made


VALUES = ("null", "-1", "1e999", "NaN", '""', "[]", "{}", '"a"', "true", "1" * 30, "1e-320")


def spoiled_events(messages: list[Message], chance: random.Random) -> list[Message]:
    """Messages in which a value or a key of some events is replaced."""
    made = list(messages)
    events = [i for i, entry in enumerate(made) if entry[1] == STRING]
    for _ in range(chance.randint(1, 3)):
        at = chance.choice(events)
        topic, kind, data, time = made[at]
        try:
            text = read_string(data)
        except Exception:  # an earlier replacement has spoiled it
            continue
        tokens = list(re.finditer(r'"[^"]*"|-?\d[\d.e+-]*|true|false|null', text))
        if not tokens:
            continue
        token = chance.choice(tokens)
        value = chance.choice(VALUES) if chance.random() < 0.8 else chance.choice(tokens).group()
        made[at] = (topic, kind, string(text[: token.start()] + value + text[token.end() :]), time)
    return made


class Fuzz:
    """Pass damaged bags through the command line; anything but a proper answer is an error."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        self._chance = random.Random(seed)
        self._runner = runner()
        log = log_of(folder / "log.mcap")
        self._messages = messages_of(log, "/joint_states", resolved(EVENTS))
        foreign = [entry for entry in self._messages if entry[1] == JOINT_STATE]
        self._bags = [log.read_bytes(), cut_end(log, folder / "cut.mcap").read_bytes()]
        for compression in ("none", "lz4"):
            path = write_with_mcap(folder / "f.mcap", foreign, compression=compression, chunk_size=1500)
            self._bags.append(path.read_bytes())
        self._config = folder / "c.yaml"
        self._config.write_text(CONFIG_TEXT)
        self.bag = folder / "bag.mcap"
        self.counts = {"accepted": 0, "refused": 0}

    def turn(self) -> None:
        """Make a bag and pass it through a command."""
        self._make()
        arguments = [str(self.bag), "--out", str(self._folder / "out.mcap"), "--overwrite"]
        if self._chance.random() < 0.15:
            self.check(self._runner.invoke(replay, [*arguments, "--config", str(self._config)]))
        elif self._chance.random() < 0.15:
            self.check(self._runner.invoke(recover, arguments))
        else:
            self.check(self._runner.invoke(replay, arguments))
        if self._chance.random() < 0.1:
            self._diagnose()

    def check(self, result: Result) -> None:
        """Accept exit code 0 with a readable bag, or code 2 with one line."""
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        if result.exit_code == 0:
            with BagReader(self._folder / "out.mcap") as reader:
                assert not reader.problems
            self.counts["accepted"] += 1
            return
        assert result.exit_code == 2, result.exit_code
        assert result.stderr.count("\n") == 1, result.stderr
        assert len(result.stderr) < 1200, len(result.stderr)
        self.counts["refused"] += 1

    def _make(self) -> None:
        kind = self._chance.randrange(4)
        if kind == 0:
            self.bag.write_bytes(damaged(self._chance.choice(self._bags), self._chance))
        elif kind == 1:
            self.bag.write_bytes(self._chance.randbytes(self._chance.randrange(3000)))
        elif kind == 2:
            write_with_mcap(self.bag, spoiled_messages(self._messages, self._chance))
        else:
            write_with_mcap(self.bag, spoiled_events(self._messages, self._chance))

    def _diagnose(self) -> None:
        """Read the bag as `hd-diag diagnose` does."""
        try:
            read_bags([self.bag], CONFIG.joints[0])
        except (BagError, RecordError) as error:
            if "\n" in str(error):
                raise AssertionError(f"not one line: {error}") from error
