"""What a user does with the log next: replay it, and ask what is wrong with the joint."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hd_diag.bag import BagReader

_LIMIT = 300.0  # for a verb to end, on a busy machine [s]
_INTERRUPTED = 130


@dataclass
class Aftermath:
    """Results of the verbs, and what did not hold, one line each."""

    replayed: int = 0
    verdict: dict[str, Any] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def look_back(folder: Path) -> Aftermath:
    """Replay, diagnose and report the log of a demo.

    Parameters
    ----------
    folder : Path
        The demo's, with ``log`` in it; takes ``replayed``, ``verdict.json`` and ``report.html``.

    Returns
    -------
    Aftermath
    """
    found = Aftermath()
    if _verb(found, "replay", str(folder / "log"), "--out", str(folder / "replayed")):
        before, after = (_outputs(folder / name) for name in ("log", "replayed"))
        found.replayed = sum(map(len, after.values()))
        different = sorted(topic for topic in before | after if before.get(topic) != after.get(topic))
        found.problems += [f"the replay's {topic} differs from what was published" for topic in different]
        if not found.replayed:
            found.problems.append("the replay published nothing")
    verdict, report = folder / "verdict.json", folder / "report.html"
    if _verb(found, "diagnose", str(folder / "log"), "--json", str(verdict), "--report", str(report)):
        found.verdict = json.loads(verdict.read_text(encoding="utf-8"))
    return found


def _verb(found: Aftermath, *arguments: str) -> bool:
    """Run a verb of the command line as a user would; whether it ended with code 0."""
    done = subprocess.run(
        [sys.executable, "-m", "hd_diag", *arguments],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=_LIMIT,
        check=False,
    )
    if done.returncode == _INTERRUPTED:
        raise KeyboardInterrupt
    if done.returncode:
        words = done.stderr.splitlines()[-1] if done.stderr else "nothing said"
        found.problems.append(f"hd-diag {arguments[0]} ended with code {done.returncode}: {words}")
    return done.returncode == 0


def _outputs(folder: Path) -> dict[str, list[bytes]]:
    """What the node published, message by message."""
    found: dict[str, list[bytes]] = defaultdict(list)
    with BagReader(folder) as reader:
        for batch in reader.batches(grouped=True):
            if batch.topic.name == "/diagnostics" or batch.topic.name.startswith("/hd_diag/"):
                found[batch.topic.name] += [bytes(message) for message in batch.messages()]
    return found
