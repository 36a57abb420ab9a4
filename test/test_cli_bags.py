"""``hd-diag replay`` and ``recover`` for a user: exit codes, one-line errors, JSON, and files that remain."""

import io
import json
import re
import shutil
import signal
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import click
import numpy as np
import pytest
import yaml
from bag_samples import cut_end
from cli_runner import hd_diag
from click.testing import Result
from live import MS, START, message, parameters
from logs import content
from replay_fuzz import JOINT_STATE, Fuzz, log_of
from rich.console import Console

from hd_diag.bag import BagReader, BagWriter
from hd_diag.cli import progress as cli_progress
from hd_diag.cli.verbs.bags import recover, replay
from hd_diag.config.parameters import nested
from hd_diag.messages.encoding import encode_joint_states

Patch = pytest.MonkeyPatch
BOTH = pytest.mark.parametrize("command", [recover, replay], ids=["recover", "replay"])
COUNT, HOSTILE = 20_000, "/a\nb\x1b[2J\x07\u202e"


def written(path: Path, given: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump({"hd_diag": {"ros__parameters": nested(given)}}))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A configuration, a short log of the node, and a bag of twenty seconds."""
    made = tmp_path_factory.mktemp("bags")
    # The highest rate of arrays: the replay takes seconds, so that a test can interrupt it.
    written(made / "c.yaml", parameters("a", array_rate=1000.0))
    log_of(made / "log.mcap")
    angle = np.linspace(0.0, 450.0, COUNT)
    columns = np.column_stack((angle, angle / 30.0))
    rows = encode_joint_states(("a_motor", "a"), START + MS * np.arange(COUNT), columns)
    with BagWriter(made / "long.mcap") as writer:
        writer.write_many("/joint_states", JOINT_STATE, rows, START + MS * np.arange(COUNT))
    return made


def run(command: click.Command, *arguments: str | Path) -> Result:
    return hd_diag(command.name, *arguments)


# Reports ---


def test_a_replay_tells_what_it_did(folder: Path, tmp_path: Path) -> None:
    result = run(replay, folder / "log.mcap", "--out", tmp_path / "out", "--json", tmp_path / "r.json")
    assert (result.exit_code, result.stderr) == (0, "")  # no progress without a terminal
    assert "its own configuration followed" in result.stdout
    found = json.loads((tmp_path / "r.json").read_text())
    told = {"schema": "hd_diag/replay/1", "reproduced": True, "joints": ["a", "b"], "messages": 59 + 4}
    told |= {"written": sum(map(len, content(tmp_path / "out").values())), "problems": []}
    assert told.items() <= found.items()
    assert found["duration"] > 0.2
    assert content(tmp_path / "out") == content(folder / "log.mcap")


def test_rejections_and_absent_joints_are_told(folder: Path, tmp_path: Path) -> None:
    bag = tmp_path / "b.mcap"
    with BagWriter(bag) as writer:
        for i in (0, 1, 1, 2):
            writer.write("/joint_states", JOINT_STATE, message(START + i, {"a_motor": 0.1}), START + i)
    config = written(tmp_path / "c.yaml", parameters("a", "b"))
    result = run(replay, bag, "--config", config, "--out", tmp_path / "out.mcap")
    assert result.exit_code == 2  # for a joint that cannot be judged
    assert "a: 1 rejected, the last because: stamp of a_motor repeats the last" in result.stdout
    assert result.stderr == (
        f"hd-diag: b: no input angle ('b_motor') in {bag}; joint states there hold a_motor; its topics are "
        f"/joint_states; what could serve, and the mapping to paste: hd-diag topics {bag}\n"
    )


def test_a_bag_that_is_being_written_is_replayed_as_far_as_it_goes(folder: Path, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "live.mcap") as writer:
        for topic, messages in content(folder / "log.mcap").items():
            kind = "std_msgs/msg/String" if topic.endswith("events") else JOINT_STATE
            if topic in ("/joint_states", "/hd_diag/events"):
                for now, data in messages:
                    writer.write(topic, kind, data, now)
        writer.flush()
        result = run(replay, tmp_path / "live.mcap", "--out", tmp_path / "out.mcap")
    assert result.exit_code == 0
    assert result.stderr == "warning: live.mcap: is being written by another process\n"
    assert content(tmp_path / "out.mcap") == content(folder / "log.mcap")


def test_recover_tells_what_it_saved(folder: Path, tmp_path: Path) -> None:
    cut = cut_end(folder / "log.mcap", tmp_path / "cut.mcap")
    result = run(recover, cut, "--out", tmp_path / "out.mcap", "--json", tmp_path / "r.json")
    assert (result.exit_code, result.stderr, result.stdout[:6]) == (0, "", "saved ")
    assert json.loads((tmp_path / "r.json").read_text())["schema"] == "hd_diag/recovery/1"
    assert content(tmp_path / "out.mcap") == content(folder / "log.mcap")


def test_control_characters_of_a_file_do_not_reach_the_terminal(tmp_path: Path) -> None:
    out = tmp_path / "b.mcap"
    with BagWriter(tmp_path / "a.mcap") as writer:
        writer.write(HOSTILE, JOINT_STATE, message(START, {"a_motor": 0.1}), START)
    result = run(recover, tmp_path / "a.mcap", "--out", out)
    assert "  /a\\nb\\x1b[2J\\x07\\u202e: 1\n" in result.stdout
    assert result.stdout.replace("\n", "").isprintable()
    result = run(recover, tmp_path / "a.mcap", "--out", out, "--overwrite", "--json", "-")
    told = json.loads(result.stdout)
    assert (told["messages"], told["out"], result.stderr) == ({HOSTILE: 1}, [str(out)], "")


# Interruptions ---


def interrupting(monkeypatch: Patch, place: str, turn: int, number: signal.Signals = signal.SIGINT) -> None:
    """Raise a signal, by default Ctrl-C, in the given call of a function."""
    module, _, name = place.rpartition(".")
    before, calls = getattr(sys.modules[module], name), []

    def call(*arguments: Any, **options: Any) -> Any:
        calls.append(1)
        if len(calls) == turn:
            signal.raise_signal(number)
        return before(*arguments, **options)

    monkeypatch.setattr(sys.modules[module], name, call)


STOPPED = {
    recover: ("hd_diag.bag.recover._copy", ""),
    replay: ("hd_diag.replay.replay.temperature_changes", "what "),
}
BEGUN = {recover: ("hd_diag.bag.recover", "Scan"), replay: ("hd_diag.replay.replay", "sources_of")}


@pytest.mark.parametrize("name", ["out.mcap", "out"])
@BOTH
def test_ctrl_c_leaves_a_whole_bag_and_says_what_there_is(
    folder: Path, tmp_path: Path, monkeypatch: Patch, command: click.Command, name: str
) -> None:
    out, (place, what) = tmp_path / name, STOPPED[command]
    given = () if command is recover else ("--config", folder / "c.yaml")
    with monkeypatch.context() as patch:
        interrupting(patch, place, 2 if command is recover else 1)
        result = run(command, folder / "long.mcap", "--out", out, *given)
    with BagReader(out) as reader:
        assert not reader.problems
        counts = {topic.name: topic.count for topic in reader.topics}
    count = counts["/joint_states"]
    assert 0 < count < COUNT
    assert counts.get("/hd_diag/residual", count) == count
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (130, "", 1)
    assert result.stderr.startswith(f"hd-diag: interrupted: {out} holds {what}the first {count} messages")
    if command is recover:
        assert content(out)["/joint_states"] == content(folder / "long.mcap")["/joint_states"][:count]


def test_ctrl_c_while_the_result_is_read_back(folder: Path, tmp_path: Path, monkeypatch: Patch) -> None:
    interrupting(monkeypatch, "hd_diag.bag.recover._verify", 1)
    assert run(recover, folder / "long.mcap", "--out", tmp_path / "out.mcap").exit_code == 130


@BOTH
def test_ctrl_c_before_anything_is_written(
    folder: Path, tmp_path: Path, monkeypatch: Patch, command: click.Command
) -> None:
    module, name = BEGUN[command]
    monkeypatch.setattr(sys.modules[module], name, Mock(side_effect=KeyboardInterrupt))
    result = run(command, folder / "log.mcap", "--out", tmp_path / "out.mcap")
    assert (result.exit_code, result.stderr) == (130, "hd-diag: interrupted: nothing was written\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("command", "number"), [(recover, signal.SIGINT), (replay, signal.SIGTERM)])
def test_a_signal_keeps_what_was_to_be_replaced(
    folder: Path, tmp_path: Path, monkeypatch: Patch, command: click.Command, number: signal.Signals
) -> None:
    shutil.copy(folder / "log.mcap", tmp_path / "out.mcap")
    interrupting(monkeypatch, STOPPED[command][0], 2, number)
    given = ("--out", tmp_path / "out.mcap", "--overwrite")
    given += () if command is recover else ("--config", folder / "c.yaml")
    result = run(command, folder / "long.mcap", *given)
    line = f"hd-diag: interrupted: nothing was written, {tmp_path / 'out.mcap'} is as it was\n"
    assert (result.exit_code, result.stderr) == (128 + number, line)
    assert (tmp_path / "out.mcap").read_bytes() == (folder / "log.mcap").read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"]


@BOTH
def test_progress_has_a_rate_and_the_time_left(
    folder: Path, tmp_path: Path, monkeypatch: Patch, command: click.Command
) -> None:
    shown = io.StringIO()
    terminal = Console(file=shown, force_terminal=True, width=120, color_system=None)
    monkeypatch.setattr(cli_progress, "_on_terminal", lambda: True)
    monkeypatch.setattr("rich.console.Console", lambda stderr: terminal)
    given, unit = ((), "kB") if command is recover else (("--config", folder / "c.yaml"), "messages")
    assert run(command, folder / "long.mcap", "--out", tmp_path / "out.mcap", *given).exit_code == 0
    assert re.search(rf"{command.name} .* ([\d,]+) of \1 {unit}, [\d,.]+/(s|min)", shown.getvalue())


@pytest.mark.parametrize("turns", [40, pytest.param(3000, marks=pytest.mark.slow)])
def test_whatever_a_bag_holds_the_answer_is_proper(tmp_path: Path, turns: int) -> None:
    fuzz = Fuzz(tmp_path, seed=20)
    for _ in range(turns):
        fuzz.turn()
    assert min(fuzz.counts.values()) > turns / 8
