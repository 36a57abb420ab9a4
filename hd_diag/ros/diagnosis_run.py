"""Diagnoses the log's last minutes in a separate process, one at a time, at low priority."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from hd_diag.bag import BagError
from hd_diag.bag.errors import lock
from hd_diag.config import parameter_file
from hd_diag.config.configuration import Config
from hd_diag.formatting import visible

# Lowest priority: samples come first. If the node is killed, the kernel ends the process.
_BENEATH = ("nice", "-n", "19", "setpriv", "--pdeathsig", "TERM")
_ENDINGS = (".json", ".html", ".txt")  # verdict, page, output of the command
_PATIENCE = 5.0  # from SIGTERM to SIGKILL [s]
_LONGEST = 500  # characters of a verdict or a reason

Files = Callable[[], Sequence[Path] | None]


class DiagnosisRun:
    """Runs ``hd-diag diagnose`` on files and publishes its JSON.

    `facts` hold the state, and each joint's last verdict with its time. If a process fails or is killed,
    `facts` and the node's output say so.
    """

    def __init__(self, publish: Callable[[str], Any], logger: Any) -> None:
        self._publish, self._logger = publish, logger
        self._process: subprocess.Popen[bytes] | None = None
        self._stem: Path | None = None  # of the output files; None: no diagnosis is wanted
        self._at = 0.0
        self._kept = ExitStack()  # files that nobody may delete while they are read
        self._facts: dict[str, str] = {"diagnosis_state": "none"}

    @property
    def is_busy(self) -> bool:
        """Whether a diagnosis is wanted or under way."""
        return self._stem is not None

    @property
    def facts(self) -> Mapping[str, str]:
        """For the diagnostics."""
        return self._facts

    def ask(self, bag: Path, at: float) -> str:
        """Request a diagnosis, not before a ``time.monotonic`` [s]; return its JSON's path, beside a bag."""
        name = f"verdict_{time.strftime('%Y-%m-%d_%H-%M-%S')}"
        self._stem = bag.with_name(f"{bag.stem}_{name}") if bag.suffix else bag / name
        self._at = at
        self._tell(f"waits for the log to be written: {self._stem}.json")
        return f"{self._stem}.json"

    def look(self, config: Config, files: Files) -> None:
        """Begin the requested diagnosis once its files are there; collect it once it has ended."""
        if self._stem is None or time.monotonic() < self._at:
            return
        try:
            if self._process is None:
                if (found := files()) is not None:
                    self._begin(self._stem, config, found)
            elif (code := self._process.poll()) is not None:
                stem, self._process, self._stem = self._stem, None, None
                self._kept.close()
                self._take(stem, code)
        except (OSError, ValueError) as error:
            self.fail(str(error))

    def close(self) -> None:
        """End the process and its children."""
        self._kept.close()
        if self._process is None or self._process.poll() is not None:
            return
        os.killpg(self._process.pid, signal.SIGTERM)
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def _begin(self, stem: Path, config: Config, files: Sequence[Path]) -> None:
        if not (files := self._keep(files)):
            raise BagError(stem, "there is no file of the log to diagnose")
        own = stem.with_name(f"{stem.name}.yaml")
        stem.parent.mkdir(parents=True, exist_ok=True)  # the log's folder may have been deleted as old
        own.write_text(_configuration(stem, config), encoding="utf-8")
        self._keep([own])
        places = [str(stem.with_name(f"{stem.name}{ending}")) for ending in _ENDINGS]
        command = [*_BENEATH, sys.executable, "-m", "hd_diag", "diagnose", *map(str, files)]
        options = ["--config", str(own), "--json", places[0], "--report", places[1]]
        with open(places[2], "wb") as said:
            self._process = subprocess.Popen(
                [*command, *options],
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=said,
                start_new_session=True,
            )
        self._tell(f"diagnoses {len(files)} file{'s' * (len(files) > 1)}: {places[0]}")

    def _keep(self, files: Sequence[Path]) -> list[Path]:
        """The files that still exist, locked so that the log does not delete them during the diagnosis."""
        there = []
        for file in files:
            with suppress(FileNotFoundError):
                opened = self._kept.enter_context(file.open("rb"))
                there.append(file)
                with suppress(BagError):  # its writer holds the lock, and keeps the file
                    lock(opened.fileno(), file)
        return there

    def _take(self, stem: Path, code: int) -> None:
        """Publish a process's result; ValueError with the reason if there is none."""
        if code < 0:
            raise ValueError(f"was ended by {signal.Signals(-code).name}")
        place = stem.with_name(f"{stem.name}.json")
        if not place.is_file():
            said = stem.with_name(f"{stem.name}.txt").read_text(encoding="utf-8", errors="replace")
            raise ValueError((said.strip().splitlines() or [f"ended with {code}"])[-1])
        text = place.read_text(encoding="utf-8")
        content, when = json.loads(text), time.strftime("%Y-%m-%dT%H:%M:%S%z")
        for each in content.get("joints", [content]):
            found = str(each.get("verdict") or f"not judged: {each.get('error', '')}")
            self._facts[f"verdict.{each['joint']}"] = visible(found, _LONGEST)
            self._facts[f"verdict_time.{each['joint']}"] = when
        self._publish(text)
        self._tell(f"done: {place}")

    def fail(self, reason: str) -> None:
        """End the diagnosis and report the reason."""
        with suppress(ProcessLookupError):
            self.close()
        self._process = self._stem = None
        self._facts["diagnosis_state"] = visible(f"failed: {reason}", _LONGEST)
        self._logger.error(f"diagnosis {self._facts['diagnosis_state']}")

    def _tell(self, what: str) -> None:
        self._facts["diagnosis_state"] = visible(what, _LONGEST)
        self._logger.info(f"diagnosis {self._facts['diagnosis_state']}")


def _configuration(stem: Path, config: Config) -> str:
    """Text of a parameter file with the node's present values; the models in force are written beside it."""
    flat = dict(config.flat)
    for joint in config.joints:
        if joint.model is not None:
            file = stem.with_name(f"{stem.name}_{joint.name}_model.json")
            file.write_text(joint.model_text, encoding="utf-8")
            flat[f"{joint.name}.model_file"] = str(file.absolute())
    return parameter_file.text(flat)
