"""Snapshots and diagnoses beside a running node: asked for by services, or begun by a joint's fault."""

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

_SILENCE = {"STALE"}  # a fault in which there is nothing to diagnose
_MOVED = 0.01  # turn of an input that is more than an encoder's noise [rad]


class Recording:
    """Services of a node for its log and its diagnosis, and what begins both without being asked.

    `now` gives the time of an event [ns].
    """

    def __init__(self, node: Node, log: LogWriter, session: Session, now: Callable[[], int]) -> None:
        self._log, self._session, self._now = log, session, now
        self._faults = Beginnings(session.config.log.before + session.config.log.after)
        self._angles: dict[str, float] = {}
        self._moved, self._seen = 0.0, time.monotonic()
        self._fault_waits = False  # for a diagnosis, while another is running
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
        """State of the diagnosis, and of each joint the last verdict."""
        return self._run.facts

    def follow(self, statuses: Sequence[Status]) -> None:
        """Look at a report: a fault that begins, or enough motion, begins what is configured."""
        config, now = self._session.config, time.monotonic()
        begun, every = self._begun(statuses), config.diagnose_every
        self._moved += self._is_turning(statuses) * (now - self._seen)
        self._seen = now
        if begun and config.log.mode == "snapshot" and config.log.path:
            with suppress(BagError):  # the log's state tells why
                self._record(config.log.after)
        self._fault_waits |= config.diagnose_on_fault and not begun <= _SILENCE
        if self._fault_waits or (every and self._moved >= every):
            self._diagnose_by_itself(config.log.after if begun else 0.0)

    def _begun(self, statuses: Sequence[Status]) -> set[Hashable]:
        """Faults that begin. One that comes back while a snapshot would hold it is in the files already."""
        begun: set[Hashable] = set()
        for joint, _, _, values in statuses:
            faults = set(values["fault_codes"].split()) - OF_NO_JOINT if values["samples"] != "0" else set()
            begun |= self._faults.of(joint, faults)
        return begun

    def _is_turning(self, statuses: Sequence[Status]) -> bool:
        """Whether an input has turned since it last did."""
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
            if state.startswith("failed"):  # each severity needs a line of its own, or rclpy raises
                self._logger.error(f"log {state}")
            else:
                self._logger.info(f"log {state}")
        self._run.look(self._session.config, self._files)

    def close(self) -> None:
        """End a diagnosis that runs."""
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
        """As `_diagnose_now`, unless a diagnosis is running; the state says why there is none."""
        if self._run.is_busy:
            return
        self._fault_waits = False
        try:
            self._diagnose_now(after)
        except BagError as error:
            self._run.fail(str(error))

    def _diagnose_now(self, after: float) -> str:
        """Have the log's last minutes in files, to be diagnosed once they are whole; where the result is."""
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
        """What is to be diagnosed; None while it is being written."""
        if self._log.will_end:
            return None
        if self._log.is_recording and self._log.split_if_due(self._now(), at_once=True):
            self._session.start_again(self._now())
        return self._log.finished(time.time() - self._session.config.log.before)


def _answering(action: Callable[[], str]) -> Callable[[Any, Any], Any]:
    """A service that answers with what an action gives, or why it gives nothing."""

    def answer(_: Any, response: Any) -> Any:
        try:
            response.success, response.message = True, action()
        except BagError as error:
            response.success, response.message = False, str(error)
        return response

    return answer
