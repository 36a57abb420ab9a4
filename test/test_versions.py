"""Versions in a log: named at its start, and told where a replay has others."""

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from cli_runner import hd_diag as command
from replay_fuzz import log_of

import hd_diag
from hd_diag.bag import BagReader, BagWriter
from hd_diag.messages.publications import STRING, read_string, string
from hd_diag.replay import versions
from hd_diag.replay.events import read_event
from hd_diag.replay.replay import replay


def rewritten(log: Path, path: Path, change: dict[str, Any]) -> Path:
    """The log as if other software had written it."""
    with BagReader(log) as reader, BagWriter(path) as writer:
        for batch in reader.batches():
            for time, data in zip(batch.log_time.tolist(), map(bytes, batch.messages()), strict=True):
                if batch.topic.type_name == STRING:
                    event = json.loads(read_string(data))
                    if event.get("new"):
                        event["versions"] = event["versions"] | change
                        data = string(json.dumps(event))
                writer.write(batch.topic.name, batch.topic.type_name, data, time)
    return path


def test_a_log_names_its_versions_and_the_same_ones_are_no_problem(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.mcap")
    with BagReader(log) as reader:
        batch = next(iter(reader.batches(["/hd_diag/events"])))
        event = read_event(bytes(next(batch.messages())))
    packages = {name: metadata.version(name) for name in ("numpy", "scipy", "numba")}
    own = {"hd_diag": hd_diag.__version__, "python": platform.python_version()}
    assert event["versions"] == versions.running() == own | packages
    assert replay(log, tmp_path / "out.mcap").problems == []


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"numpy": "1.0.0"}, f"numpy 1.0.0 (here {versions.running()['numpy']})"),
        ({"numba": "0.1\n"}, f"numba 0.1\\n (here {versions.running()['numba'] or 'absent'})"),
        ({"numpy": None, "cobol": "85"}, f"numpy absent (here {versions.running()['numpy']})"),
    ],
)
def test_other_versions_are_one_warning(tmp_path: Path, change: dict[str, Any], told: str) -> None:
    log = rewritten(log_of(tmp_path / "log.mcap"), tmp_path / "other.mcap", change)
    result = command("replay", log, "--out", tmp_path / "out.mcap")
    assert result.exit_code == 0
    assert result.stderr == f"warning: {log}: was recorded with {told}: outputs may differ by rounding\n"


@pytest.mark.parametrize("given", [[], "1.0", {"numpy": 1}, {"numpy": ["2"]}, None])
def test_versions_that_are_none_are_refused(given: Any) -> None:
    content = {"event": "configuration", "new": True, "parameters": {}, "versions": given}
    with pytest.raises(ValueError, match="versions"):
        read_event(string(json.dumps(content)))
