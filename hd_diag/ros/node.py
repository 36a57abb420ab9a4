"""The rclpy node: joint states in, transmission error, tooth arrays and diagnostics out, all of it logged."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.clock import JumpThreshold, ROSClock
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.logging import get_logger, set_logger_level
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import ok, try_shutdown

from hd_diag.bag import RELIABLE
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.config.json_shape import reader
from hd_diag.formatting import visible
from hd_diag.gears.characteristics import tooth_loads
from hd_diag.memory import give_back, map_large_arrays
from hd_diag.messages.publications import TEMPERATURE, temperature_topic
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.replay.map_builder import MapBuilder
from hd_diag.replay.preparation import compile_apart, prepare
from hd_diag.replay.recorded_monitor import Session
from hd_diag.ros.absences import absences
from hd_diag.ros.arguments import check_arguments, parameter_files, read_in_every_namespace, reason, unread
from hd_diag.ros.faults import Console
from hd_diag.ros.log_writer import LogWriter
from hd_diag.ros.message_types import definition_of
from hd_diag.ros.parameter_server import ParameterServer
from hd_diag.ros.publishers import Publishers
from hd_diag.ros.publishing import Publishing
from hd_diag.ros.recording import Recording
from hd_diag.ros.stop_signals import ignore_signals, note_signals
from hd_diag.ros.subscriptions import (
    INPUT_DEPTH,
    Reader,
    SignalInput,
    SignalTopic,
    Waiting,
    check_types,
    sources,
    subscribe_temperature,
)
from hd_diag.ros.withheld import Withheld
from hd_diag.streams.rules import CLOCK_JUMP

_QOS = RELIABLE._replace(depth=INPUT_DEPTH)
_LOOP_PERIOD = 0.05  # longest sleep between looks at the clock, the log and finished maps [s]
_GATHER = 1.0 / 60.0  # least time between batches of samples: one frame of a display [s]
_TOGETHER = 64  # most messages processed at once
_BEHIND = 0.1  # age of a waiting sample above which the node does less other work [s]
_CATCH_UP = 0.5  # longest wait of a change for earlier samples [s]
_LATE = 1.0  # wait of a sample or standstill of the node above which a warning is given [s]
_LEAST_SHARE = 2.0**-12
_WINDOW = 1.0  # period over which spare computing time is judged [s]
# Interpreter's switch interval, for when a thread builds a map [s]: a tenth of a sample at 1 kHz. Python's
# default of 5 ms would let samples pile up.
_SWITCH_INTERVAL = 1e-4


class DiagnosticNode(Node):
    """Node that runs one `Session` on live messages.

    Model files with relative paths are searched for in `model_folders`, then in the working directory.
    """

    def __init__(self, model_folders: Sequence[Path] = ()) -> None:
        super().__init__(
            "hd_diag", automatically_declare_parameters_from_overrides=True, start_parameter_services=False
        )
        self._server = ParameterServer(self, reader(*model_folders))
        config = self._server.config
        check_types(config)
        joints = [joint.name for joint in config.joints]
        self._last_time = 0
        self._latencies: list[int] = []
        self._sources = sources(config, self.resolve_topic_name)
        self._log = LogWriter(config.log, {s.type_name: definition_of(s.type_name) for s in self._sources})
        self._publishing = Publishing(self, joints, self._log)
        own = {s.topic for joint in config.joints for s in joint.mapped.values() if s.topic}
        self._names = self._publishing.names | {topic: self.resolve_topic_name(topic) for topic in own}
        self._session = Session(
            config, self._publishing.emit, self.get_fully_qualified_name(), dict(self._names)
        )
        self._session.start(self._now())
        self._recording = Recording(self, self._log, self._session, self._now)
        self._console = Console(self.get_logger())
        prepare(config)
        self._builder = MapBuilder()
        self._build_maps(config.joints)
        self._next_report = self._next_look = time.monotonic()
        self._waiting = Waiting()
        self._readers = [source.reader() for source in self._sources]
        self._inputs = [
            SignalInput(self, source, partial(self._waiting.put, source, reader))
            for source, reader in zip(self._sources, self._readers, strict=True)
        ]
        self._seen = Publishers(self, self._inputs)
        self._withheld = Withheld(self, self._inputs)
        self._told_lost, self._busy, self._worked, self._paced = 0, 0.0, 0.0, 0.0
        self._turned, self._stood_still = math.inf, 0.0  # start of the last loop, longest loop [s]
        for joint in config.joints:
            if joint.signals.temperature is None:
                take = partial(self._survive, "a temperature was dropped", self._temperature, joint.name)
                subscribe_temperature(self, joint.name, take)
        every = JumpThreshold(
            min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self._jumps = self.get_clock().create_jump_callback(every, post_callback=self._on_clock)
        refused = "parameters were accepted and are not in force"
        self._server.serve(partial(self._survive, refused, self._put_in_force))

    def housekeeping(self) -> None:
        """Do what is due by the clock: reports, finished maps, flushes of the log, checks of publishers."""
        now = time.monotonic()
        if now >= self._next_look:
            if self._log.flush_if_due():
                self._session.start_again(self._now())
            self._take_maps()
            self._pace(now)
            for each in self._inputs:
                each.follow_publishers()
            self._survive("a look at publishers failed", self._seen.look)
            silences = [*self._session.monitor.silence(time.monotonic_ns()).values()]
            self._survive("a look for messages failed", self._withheld.look, silences)
            self._survive("a diagnosis failed", self._recording.look)
            if now >= self._next_report:
                period = 1.0 / self._session.config.diagnostics_rate
                self._next_report = max(self._next_report + period, now)
                self._survive("a report failed", self._report)
                if self._log.split_if_due(self._last_time):  # after a report: no sample awaits one
                    self._session.start_again(self._now())
            self._next_look = min(now + _LOOP_PERIOD, self._next_report)

    def spin_once(self, executor: Any) -> None:
        """Do what is due, take new messages, process the oldest samples; errors do not end the node.

        Samples gather for `_GATHER` after the last batch: in a batch each costs less than a third. A sample
        that comes later, as at a lower rate, does not wait.
        """
        begin = time.monotonic()
        self._stood_still, self._turned = max(self._stood_still, begin - self._turned), begin
        self.housekeeping()
        try:
            if not self._waiting and not self._is_simulated:
                until = min(self._worked + _GATHER, self._next_report)
                time.sleep(max(0.0, until - time.monotonic()))
            take_all(executor)  # DDS may silently drop messages that wait there
            if not self._waiting:
                executor.spin_once(timeout_sec=max(0.0, self._next_look - time.monotonic()))
        except ExternalShutdownException:
            raise
        except Exception as error:  # samples wait: go on after any error
            self.get_logger().error(f"a request was dropped: {error!r}", throttle_duration_sec=5.0)
        if self._waiting:
            self._work()

    @property
    def _is_simulated(self) -> bool:
        """Whether time is simulated: messages of the clock then come as well, and may not wait."""
        clock = self.get_clock()
        return isinstance(clock, ROSClock) and clock.ros_time_is_active

    def close(self) -> None:
        """Report once more and finish the log."""
        with contextlib.suppress(Exception):
            self._report()
        self._recording.close()
        self._seen.close()
        self._withheld.close()
        self._builder.close()
        self._log.close()

    def _now(self) -> int:
        """Time of reception [ns]: system time, forced to rise so that the log keeps the order of events."""
        self._last_time = max(self._last_time + 1, time.time_ns())
        return self._last_time

    def _survive(self, what: str, action: Callable[..., None], *arguments: Any) -> Exception | None:
        """Call an action; print and return its exception instead of ending the node."""
        try:
            action(*arguments)
        except Exception as error:
            self.get_logger().error(f"{what}: {error!r}", throttle_duration_sec=5.0)
            return error
        return None

    def _pace(self, now: float) -> None:
        """Publish fewer arrays and drawings while samples wait: samples come first. More once none do."""
        share = before = self._session.monitor.share
        is_over = now - self._paced > _WINDOW
        if self._waiting.age > _BEHIND:
            share = max(_LEAST_SHARE, 0.5 * before) if self._session.monitor.has_arrays else before
        elif is_over and not self._waiting and self._busy < 0.5 * (now - self._paced):
            share = min(1.0, 2.0 * before)
        if share != before:
            self._session.pace(self._now(), share)
            what = f"{100.0 * share:.3g} % of the per-tooth arrays and drawings are published"
            why = "the node cannot keep up: " if share < before else ""
            self.get_logger().warning(f"{why}{what}", throttle_duration_sec=5.0)
        if share != before or is_over:
            self._paced, self._busy = now, 0.0

    def _work(self) -> None:
        """Process the oldest waiting samples."""
        begin, some = time.perf_counter_ns(), self._waiting.some(_TOGETHER)
        error = self._survive("messages were dropped", self._signals, some)
        for _ in some if error is not None else ():
            self._session.monitor.reject(f"{type(error).__name__}: {error}")
        self._latencies.append(time.perf_counter_ns() - begin)
        self._busy += self._latencies[-1] * 1e-9
        self._worked = time.monotonic()

    def _signals(self, some: Sequence[tuple[SignalTopic, Reader, bytes]]) -> None:
        received, heard = np.array([self._now() for _ in some]), np.full(len(some), time.monotonic_ns())
        for _, each in groupby(zip(some, received.tolist(), strict=True), lambda each: id(each[0][0])):
            taken, times = zip(*each, strict=True)
            source = taken[0][0]
            self._log.write_some(source.topic, source.type_name, [data for *_, data in taken], times, _QOS)
        self._session.messages(received, [(reader, data) for _, reader, data in some], heard)

    def _temperature(self, joint: str, data: bytes) -> None:
        self._log.write(self._names[temperature_topic(joint)], TEMPERATURE, data, self._now())
        self._session.temperature(joint, data)

    def _report(self) -> None:
        latency = np.percentile(self._latencies, 99) * 1e-3 if self._latencies else float("nan")
        self._latencies.clear()
        lost = self._waiting.dropped + sum(each.lost for each in self._inputs)
        faults = self._seen.faults(self._session.config.joints)
        if lost > self._told_lost:
            faults.append(f"{lost - self._told_lost} messages were lost since the last report")
        late = max(self._waiting.longest, self._waiting.age)
        if late > _LATE:
            faults.append(f"the node cannot keep up: messages waited up to {late:.1f} s")
        if self._stood_still > _LATE:  # a stopped process stops DDS too, which then dates messages late
            faults.append(f"the node stood still for {self._stood_still:.1f} s")
        self._told_lost, self._waiting.longest, self._stood_still = lost, 0.0, 0.0
        facts = {
            "latency_p99_us": f"{latency:.1f}",
            **self._log.facts,
            **self._recording.facts,
            "lag_s": f"{self._session.lag:.6g}",
            "messages_lost": str(lost),
            "warning": "; ".join(faults),
            "array_share": f"{self._session.monitor.share:.6g}",
            **absences(self, [*zip(self._inputs, self._readers, strict=True)], self._session.config.joints),
        }
        silence = self._session.monitor.silence(time.monotonic_ns())
        statuses = self._session.tick(self._now(), self.get_clock().now().nanoseconds, facts, silence)
        self._console.follow(statuses)
        self._recording.follow(statuses)

    def _take_maps(self) -> None:
        while not self._builder.finished.empty():
            joint, table = self._builder.finished.get()
            if isinstance(table, Exception):
                self.get_logger().warning(f"{joint}: no map, predictions stay exact: {table}")
            elif self._session.use_map(self._now(), joint, table):
                self.get_logger().info(
                    f"{joint}: map in force up to {table.torque_limit:.0f} N m, "
                    f"error at most {table.error_bound / ARCSEC:.3f} arcsec"
                )
            if self._builder.finished.empty():
                give_back()

    def _on_clock(self, jump: Any) -> None:
        """Handle a clock set back, as by a short bag that starts again; stamps only show jumps of 1 s.

        Samples may come slightly before their clock: those less than half the jump ahead count as new.
        """
        if jump.delta.nanoseconds > 0:
            return
        self._catch_up()
        back = abs(jump.delta.nanoseconds)
        if back < CLOCK_JUMP:
            self._session.clock_set_back(self._now(), self.get_clock().now().nanoseconds + back // 2)

    def _catch_up(self) -> None:
        """Process the waiting samples before a change, for at most `_CATCH_UP`."""
        end = time.monotonic() + _CATCH_UP
        while self._waiting and time.monotonic() < end:
            self._work()

    def _build_maps(self, joints: Sequence[JointConfig]) -> None:
        for joint in joints:  # cached for the next report: while a map is built it takes ten times as long
            tooth_loads(joint.drive)
        for joint in joints:
            self._builder.request(joint)

    def _put_in_force(self, config: Config) -> None:
        self._catch_up()
        joints = {joint.name: joint for joint in config.joints}
        self._build_maps([joints[name] for name in self._session.configure(self._now(), config)])
        self._next_report = min(self._next_report, time.monotonic() + 1.0 / config.diagnostics_rate)


def take_all(executor: Any) -> None:
    """Let an executor do all pending work, one item at a time.

    One call of ``spin_until_future_complete`` with timeout 0 costs a third less. With pybind11 3, however,
    each such call leaks 32 bytes: 7 MB an hour at 1 kHz.
    """
    last = executor.create_task(int)  # runs after the pending work
    while not last.done() and ok():
        executor.spin_once(timeout_sec=0.0)


def main(
    args: Sequence[str] | None = None, stopped: Sequence[int] | None = None, config_file: str = ""
) -> int:
    """Run the node until SIGINT or SIGTERM; `args` is a command line like that of the process.

    `config_file`, one of its parameter files, is read whatever the node's name. `stopped` is a list in which
    the caller notes signals already: rclpy's own handlers would interrupt the writing of the log. Returns the
    exit code: 0 after a signal, 2 if the arguments or the configuration cannot be used.
    """
    arguments = list(sys.argv if args is None else args)
    stopped = note_signals() if stopped is None else stopped
    code = 0 if stopped else _run(arguments, stopped, config_file)
    ignore_signals()
    return code


def _run(arguments: list[str], stopped: Sequence[int], config_file: str) -> int:
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "0")  # ROS heeds neither variable
    set_logger_level("rcl", LoggingSeverity.FATAL)  # errors of a faulty file are reported below, more clearly
    try:
        sections = check_arguments(arguments, config_file)
        map_large_arrays()
        compile_apart(stopped, get_logger("hd_diag").info)
        if stopped:
            return 0
        with read_in_every_namespace(arguments, config_file) as words:
            rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
        set_logger_level("rcl", LoggingSeverity.UNSET)
        node = DiagnosticNode([file.parent for file in parameter_files(arguments)])
    except Exception as error:
        sys.stderr.write(f"hd_diag: {visible(reason(arguments, error))}\n")
        try_shutdown()
        return 2
    for said in unread(sections, node.get_fully_qualified_name()):
        node.get_logger().warning(said)
    executor = EventsExecutor()
    executor.add_node(node)
    sys.setswitchinterval(_SWITCH_INTERVAL)
    give_back()
    gc.freeze()  # objects that live as long as the node need no collection
    with contextlib.suppress(ExternalShutdownException):
        while not stopped and ok():
            node.spin_once(executor)
    node.close()
    try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
