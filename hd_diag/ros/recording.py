"""Snapshots and diagnoses of a running node, requested by services or begun by a joint's fault or motion."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from hd_diag.bag import BagError
from hd_diag.monitor.publications import Status
from hd_diag.replay.recorded_monitor import Session
from hd_diag.ros.diagnosis_run import DiagnosisRun
from hd_diag.ros.faults import OF_NO_JOINT, Beginnings
from hd_diag.ros.log_writer import LogWriter

_SILENCE = {"STALE"}  # a fault without data to diagnose
_MOVED = 0.01  # rotation of an input above the noise of an encoder [rad]


class Recording:
    """Services of a node for its log and its diagnosis, and the conditions that begin both automatically.

    `now` returns the time of an event [ns].
    """

    def __init__(self, node: Node, log: LogWriter, session: Session, now: Callable[[], int]) -> None:
        self._log, self._session, self._now = log, session, now
        self._faults = Beginnings(session.config.log.before + session.config.log.after)
        self._angles: dict[str, float] = {}
        self._moved, self._seen = 0.0, time.monotonic()
        self._fault_waits = False  # whether a fault awaits its diagnosis while another one runs
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        verdicts = node.create_publisher(String, "~/verdict", latched)
        self._logger, self._shown = node.get_logger(), ""
        self._run = DiagnosisRun(lambda text: verdicts.publish(String(data=text)), self._logger)
        for name, action in (
            ("snapshot", self._snapshot),
            ("start_log", self._start),
            ("stop_log", self._stop),
            ("diagnose", self._diagnose),
        ):
            node.create_service(Trigger, f"~/{name}", _answering(action))
        node.create_service(SetBool, "~/log", self._set)

    @property
    def facts(self) -> Mapping[str, str]:
        """State of the diagnosis, and each joint's last verdict."""
        return self._run.facts

    def follow(self, statuses: Sequence[Status]) -> None:
        """Process a report: a new fault or enough motion begins the configured snapshot or diagnosis."""
        config, now = self._session.config, time.monotonic()
        begun, every = self._begun(statuses), config.diagnose_every
        self._moved += self._is_turning(statuses) * (now - self._seen)
        self._seen = now
        if begun and config.log.mode == "snapshot" and config.log.path:
            with suppress(BagError):  # the log's state says why
                self._record(config.log.after)
        self._fault_waits |= config.diagnose_on_fault and not begun <= _SILENCE
        if self._fault_waits or (every and self._moved >= every):
            self._diagnose_by_itself(config.log.after if begun else 0.0)

    def _begun(self, statuses: Sequence[Status]) -> set[Hashable]:
        """New faults. A fault that returns within the length of a snapshot is in the files already."""
        begun: set[Hashable] = set()
        for joint, _, _, values in statuses:
            faults = set(values["fault_codes"].split()) - OF_NO_JOINT if values["samples"] != "0" else set()
            begun |= self._faults.of(joint, faults)
        return begun

    def _is_turning(self, statuses: Sequence[Status]) -> bool:
        """Whether an input has turned by more than `_MOVED` since it last did."""
        turning = False
        for status in statuses:
            angle, before = float(status.values["input_angle_rad"]), self._angles.get(status.joint, math.nan)
            if not abs(angle - before) <= _MOVED:
                self._angles[status.joint] = angle
                turning |= math.isfinite(angle - before)
        return turning

    def look(self) -> None:
        """Show the log's state, begin a diagnosis once its files exist, and collect one that has ended."""
        state = self._log.state
        if state != self._shown:
            self._shown = state
            if state.startswith("failed"):  # two calls: rclpy raises if one call changes its severity
                self._logger.error(f"log {state}")
            else:
                self._logger.info(f"log {state}")
        self._run.look(self._session.config, self._files)

    def close(self) -> None:
        """End a running diagnosis."""
        self._run.close()

    def _snapshot(self) -> str:
        log = self._session.config.log
        if log.mode != "snapshot":
            raise BagError("~/snapshot", f"log.mode is {log.mode}, not snapshot: nothing is kept in memory")
        return self._record(log.after)

    def _start(self) -> str:
        return self._record(math.inf)

    def _stop(self) -> str:
        if not self._log.is_recording:
            raise BagError("~/stop_log", "nothing is being written")
        self._log.stop()
        return str(self._log.bags[-1]) if self._log.bags else self._log.state

    def _set(self, request: Any, response: Any) -> Any:
        return _answering(self._start if request.data else self._stop)(request, response)

    def _diagnose(self) -> str:
        return self._diagnose_now(0.0)

    def _record(self, seconds: float) -> str:
        if self._log.record(seconds):
            self._session.start_again(self._now())
        if self._log.state.startswith("failed"):
            raise BagError("log", self._log.state)
        return str(self._log.bags[-1])

    def _diagnose_by_itself(self, after: float) -> None:
        """As `_diagnose_now`, unless a diagnosis is running; the state shows a failure."""
        if self._run.is_busy:
            return
        self._fault_waits = False
        try:
            self._diagnose_now(after)
        except BagError as error:
            self._run.fail(str(error))

    def _diagnose_now(self, after: float) -> str:
        """Diagnose the log's last minutes once their files are complete; return the result's path."""
        config, self._moved = self._session.config.log, 0.0
        if self._run.is_busy:
            raise BagError("~/diagnose", f"one is under way: {self._run.facts['diagnosis_state']}")
        if config.mode == "snapshot":
            self._record(after)
        elif self._log.is_recording and not self._log.bags:
            raise BagError("~/diagnose", f"there is no log: {self._log.state}")
        elif not self._log.is_recording and not self._files():
            raise BagError("~/diagnose", "there is no log: call ~/start_log")
        return self._run.ask(self._log.bags[-1], time.monotonic() + after)

    def _files(self) -> Sequence[Path] | None:
        """Files to diagnose; None while they are being written."""
        if self._log.will_end:
            return None
        if self._log.is_recording and self._log.split_if_due(self._now(), at_once=True):
            self._session.start_again(self._now())
        return self._log.finished(time.time() - self._session.config.log.before)


def _answering(action: Callable[[], str]) -> Callable[[Any, Any], Any]:
    """Service that answers with an action's text, or with the reason for its failure."""

    def answer(_: Any, response: Any) -> Any:
        try:
            response.success, response.message = True, action()
        except BagError as error:
            response.success, response.message = False, str(error)
        return response

    return answer
