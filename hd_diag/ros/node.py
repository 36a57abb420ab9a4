"""The rclpy node: joint states in, transmission error, tooth arrays and diagnostics out, all of it logged."""

from __future__ import annotations

import contextlib
import gc
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.logging import set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import ok, remove_ros_args, try_shutdown
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from hd_diag.bag import Qos
from hd_diag.config.configuration import Config, ConfigError, load, parameters, resolve
from hd_diag.config.model_file import reader
from hd_diag.config.parameter_file import sections
from hd_diag.config.parameters import ROS_PARAMETERS, check_known
from hd_diag.drive import mesh_state, transmission_error
from hd_diag.messages.markers import MARKERS
from hd_diag.messages.publications import (
    DIAGNOSTICS,
    INPUT,
    JOINT_STATE,
    MULTI_ARRAY,
    TEMPERATURE,
    Encoded,
    published_topics,
    temperature_topic,
)
from hd_diag.model.torsion import limited_curves, torsion_table
from hd_diag.model.torsion_map import ARCSEC, TorsionMap
from hd_diag.monitor.joint import CLOCK_JUMP
from hd_diag.replay.map_builder import MapBuilder
from hd_diag.replay.recorded_monitor import Session
from hd_diag.ros.log_writer import Journal
from hd_diag.ros.stop_signals import ignore_signals, note_signals

_CLASSES = {
    JOINT_STATE: JointState,
    MULTI_ARRAY: Float64MultiArray,
    DIAGNOSTICS: DiagnosticArray,
    MARKERS: MarkerArray,
}
_INPUT_DEPTH = 2000  # samples that may wait while something else takes its time: two seconds of 1 kHz
_OUTPUT_DEPTH = 2000  # as much for those who listen
_LOOP_PERIOD = 0.05  # longest sleep between looks at the clock, the log and finished maps [s]
# Longest wait for the interpreter while a map is built beside [s]: a tenth of a sample at 1 kHz; Python's own
# 5 ms would let samples pile up.
_SWITCH_INTERVAL = 1e-4


class DiagnosticNode(Node):
    """Node that runs one `Session` on live messages.

    Parameters
    ----------
    model_folders : sequence of Path
        Where model files with relative paths are looked for before the present folder.
    """

    def __init__(self, model_folders: Sequence[Path] = ()) -> None:
        super().__init__("hd_diag", automatically_declare_parameters_from_overrides=True)
        self._model_file = reader(*model_folders)
        config = self._declare()
        self._last_time = 0
        self._latencies: list[int] = []
        self._journal = Journal(config.log)
        self._builder = MapBuilder()
        self._outputs = {
            topic: self.create_publisher(_CLASSES[kind], topic, _OUTPUT_DEPTH)
            for topic, kind in published_topics([joint.name for joint in config.joints]).items()
        }
        topics = [INPUT, *self._outputs, *(temperature_topic(joint.name) for joint in config.joints)]
        self._names = {topic: self.resolve_topic_name(topic) for topic in topics}
        self._session = Session(config, self._emit, self.get_fully_qualified_name(), dict(self._names))
        self._session.start(self._now())
        for joint in config.joints:
            self._builder.request(joint)
        self._next_report = self._next_look = time.monotonic()
        self._best_effort = self._unheard = False
        self.get_logger().info("preparing the model (the first time on a machine takes half a minute)")
        _warm_up(config)
        self._input = self._subscribe()
        for joint in config.joints:
            self._subscribe_temperature(joint.name)
        backward = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self._jumps = self.get_clock().create_jump_callback(backward, post_callback=self._on_jump)
        self.add_pre_set_parameters_callback(self._known)
        self.add_on_set_parameters_callback(self._validate)
        self.add_post_set_parameters_callback(self._apply)
        self._accepted = config
        self._told_log = ""
        self._tell_log()

    def housekeeping(self) -> float:
        """Do what is due by the clock: reports, finished maps, the log's flush, the publishers' reliability.

        Returns
        -------
        float
            Time until something may be due again [s].
        """
        now = time.monotonic()
        if now >= self._next_look:
            self._journal.flush_if_due()
            self._take_maps()
            self._hear_best_effort()
            self._tell_log()
            if now >= self._next_report:
                period = 1.0 / self._session.config.diagnostics_rate
                self._next_report = max(self._next_report + period, now)
                self._survive("a report failed", self._report)
            self._next_look = min(now + _LOOP_PERIOD, self._next_report)
        return max(0.0, self._next_look - now)

    def spin_once(self, executor: Any) -> None:
        """Do what is due, and take what comes until something may be due again; the node survives it all."""
        try:
            executor.spin_once(timeout_sec=self.housekeeping())
        except ExternalShutdownException:
            raise
        except Exception as error:  # such as a parameter of a type that ROS does not know
            self.get_logger().error(f"a request was dropped: {error!r}", throttle_duration_sec=5.0)
            time.sleep(_LOOP_PERIOD)  # whatever goes wrong may do so again at once

    def tell_files(self, held: Mapping[str, Sequence[Any]]) -> None:
        """Warn of parameter files that hold nothing for this node: ROS takes them without a word."""
        names = {self.get_name(), self.get_fully_qualified_name(), "**", "*"}
        for file, given in held.items():
            if not {str(name).rsplit("/", 1)[-1] for name in given} & names:
                others = ", ".join(sorted(map(str, given))) or "nothing"
                self.get_logger().warning(f"{file} has no section for {self.get_name()}, but {others}")

    def close(self) -> None:
        """Report once more and finish the log."""
        with contextlib.suppress(Exception):
            self._report()
        self._builder.close()
        self._journal.close()

    def _declare(self) -> Config:
        """Declare every parameter with the value given at the start, or its default."""
        declared: dict[str, Any] = self.get_parameters_by_prefix("")
        given = {name: _plain(known.value) for name, known in declared.items() if _is_own(name)}
        config = resolve(given, self._model_file)
        for name in given:
            self.undeclare_parameter(name)
        for name, spec in parameters([joint.name for joint in config.joints]).items():
            descriptor = ParameterDescriptor(
                description=f"{spec.meaning}{f' [{spec.unit}]' if spec.unit else ''}",
                dynamic_typing=True,  # an integer for a number is welcome: `_validate` checks
                additional_constraints=_constraints(spec.low, spec.high, spec.choices),
                read_only=name == "joints",
            )
            self.declare_parameter(name, config.flat[name], descriptor, ignore_override=True)
        return config

    def _now(self) -> int:
        """Time of reception [ns]: the system's, but rising: the log's order is the order of events."""
        self._last_time = max(self._last_time + 1, time.time_ns())
        return self._last_time

    def _subscribe(self) -> Any:
        reliability = ReliabilityPolicy.BEST_EFFORT if self._best_effort else ReliabilityPolicy.RELIABLE
        return self.create_subscription(
            JointState,
            INPUT,
            self._on_joint_state,
            QoSProfile(depth=_INPUT_DEPTH, reliability=reliability),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible_qos),
            raw=True,
        )

    def _subscribe_temperature(self, joint: str) -> None:
        topic = temperature_topic(joint)
        name = self._resolved(topic)

        def on_temperature(data: bytes) -> None:
            now = self._now()
            self._journal.write(name, TEMPERATURE, data, now)
            self._session.temperature(joint, data)

        profile = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(Temperature, topic, partial(self._take, on_temperature), profile, raw=True)

    def _survive(self, told: str, action: Callable[..., None], *arguments: Any) -> Exception | None:
        """Do something; whatever it raises is told instead of ending the node, and returned."""
        try:
            action(*arguments)
        except Exception as error:
            self.get_logger().error(f"{told}: {error!r}", throttle_duration_sec=5.0)
            return error
        return None

    def _take(self, action: Callable[..., None], *arguments: Any) -> None:
        """Take a message: whatever it does, it is counted and the node lives."""
        error = self._survive("a message was dropped", action, *arguments)
        if error is not None:
            self._session.monitor.reject(f"{type(error).__name__}: {error}")

    def _on_joint_state(self, data: bytes) -> None:
        begin = time.perf_counter_ns()
        self._take(self._joint_state, data)
        self._latencies.append(time.perf_counter_ns() - begin)

    def _joint_state(self, data: bytes) -> None:
        now = self._now()
        self._journal.write(self._input_topic, JOINT_STATE, data, now, _QOS)
        self._session.joint_state(now, data)

    @property
    def _input_topic(self) -> str:
        return self._resolved(INPUT)

    def _resolved(self, topic: str) -> str:
        name = self._names.get(topic)
        if name is None:
            name = self._names[topic] = self.resolve_topic_name(topic)
        return name

    def _emit(self, encoded: Encoded) -> None:
        """Publish and log; what has no publisher is for the log alone."""
        publisher = self._outputs.get(encoded.topic)
        name = self._resolved(encoded.topic)
        for row, received in zip(encoded.rows, encoded.received.tolist(), strict=True):
            data = bytes(row)
            self._journal.write(name, encoded.type_name, data, received)
            if publisher is not None:
                publisher.publish(data)

    def _report(self) -> None:
        latency = np.percentile(self._latencies, 99) * 1e-3 if self._latencies else float("nan")
        self._latencies.clear()
        facts = {"latency_p99_us": f"{latency:.1f}", "log_state": self._journal.state}
        self._session.tick(self._now(), self.get_clock().now().nanoseconds, facts)

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

    def _on_incompatible_qos(self, _: Any) -> None:
        self._unheard = True  # not now: the executor is still busy with the subscription

    def _hear_best_effort(self) -> None:
        """Subscribe with best effort once a publisher offers no more: nothing would arrive otherwise."""
        if self._unheard and not self._best_effort:
            self._best_effort = True
            self.destroy_subscription(self._input)
            self._input = self._subscribe()
            self.get_logger().info(f"{self._input_topic} is published with best effort: subscribed likewise")

    def _tell_log(self) -> None:
        state = self._journal.state
        if state != self._told_log:
            self._told_log = state
            if state.startswith("failed"):  # each severity needs a line of its own, or rclpy raises
                self.get_logger().error(f"log {state}")
            else:
                self.get_logger().info(f"log {state}")

    def _on_jump(self, jump: Any) -> None:
        """The clock was set back by less than stamps tell by themselves, as by a short bag that begins anew.

        Samples may come a little before their clock: those that are less than half the jump ahead are new.
        """
        back = abs(jump.delta.nanoseconds)
        if back < CLOCK_JUMP:
            self._session.clock_set_back(self._now(), self.get_clock().now().nanoseconds + back // 2)

    def _known(self, changed: Sequence[Parameter]) -> list[Parameter]:
        """The parameters, with numbers of the type that they were declared with; unknown ones are refused."""
        known = parameters([joint.name for joint in self._session.config.joints])
        try:
            check_known([parameter.name for parameter in changed if _is_own(parameter.name)], known)
        except ConfigError as error:
            raise _Unknown(str(error)) from error
        return [_as_declared(parameter, known.get(parameter.name)) for parameter in changed]

    def _validate(self, changed: Sequence[Parameter]) -> SetParametersResult:
        try:
            self._accepted = self._candidate(changed)
        except Exception as error:  # a ConfigError; whatever else a value does, the node lives
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _candidate(self, changed: Sequence[Parameter]) -> Config:
        own = {p.name: _plain(p.value) for p in changed if _is_own(p.name)}
        for name, value in own.items():
            if value is None:
                raise ConfigError(f"{name}: cannot be removed")
        in_force = {joint.name: joint for joint in self._session.config.joints}

        def model_text(joint: str, path: str) -> str:
            """A model is read again only where its parameter is set: the file may be another, or gone."""
            kept = f"{joint}.model_file" not in own and in_force[joint].model_text
            return kept or self._model_file(joint, path)

        return resolve({**self._session.config.flat, **own}, model_text)

    def _apply(self, _: Sequence[Parameter]) -> None:
        self._survive("parameters were accepted and are not in force", self._put_in_force, self._accepted)

    def _put_in_force(self, config: Config) -> None:
        joints = {joint.name: joint for joint in config.joints}
        for name in self._session.configure(self._now(), config):
            self._builder.request(joints[name])
        self._next_report = min(self._next_report, time.monotonic() + 1.0 / config.diagnostics_rate)
        if self._journal.configure(config.log):
            self._session.start_again(self._now())
            self._tell_log()


_QOS = Qos(depth=_INPUT_DEPTH)


class _Unknown(ParameterNotDeclaredException):
    """A parameter that the node does not have: rclpy answers with the text, and its own names nothing."""

    def __init__(self, reason: str) -> None:
        Exception.__init__(self, reason)


def _as_declared(parameter: Parameter, spec: Any) -> Parameter:
    """Integers as numbers where a number was declared: who reads them back looks there."""
    if spec is None or not isinstance(spec.default, float) or parameter.type_ != Parameter.Type.INTEGER:
        return parameter
    return Parameter(parameter.name, Parameter.Type.DOUBLE, float(parameter.value))


def _warm_up(config: Config) -> None:
    """Compute once what samples would have to wait for: constants, imports, machine code, also of maps."""
    nothing = np.zeros(1)
    for joint in config.joints:
        mesh = joint.drive.mesh
        curve = limited_curves(mesh, np.zeros(2), joint.drive.rated_torque)
        table = TorsionMap(mesh, *curve, joint.drive.rated_torque, 0.0)
        transmission_error(joint.drive, nothing, nothing)
        transmission_error(joint.drive, nothing, nothing, table)
        torsion_table(mesh, nothing, nothing)
        mesh_state(joint.drive, nothing, nothing)


def _is_own(parameter: str) -> bool:
    """Whether a parameter belongs to the configuration; every ROS node has some that do not."""
    return parameter.split(".")[0] not in ROS_PARAMETERS


def _plain(value: Any) -> Any:
    """A parameter's value as Python has it: arrays as lists."""
    return list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else value


def _constraints(low: float, high: float, choices: tuple[str, ...]) -> str:
    if choices:
        return "one of " + ", ".join(choices)
    return f"{low:g} to {high:g}" if np.isfinite([low, high]).all() else ""


def main(args: Sequence[str] | None = None, stopped: Sequence[int] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Parameters
    ----------
    args : sequence of str, optional
        Command line with ``--ros-args``; that of the process by default.
    stopped : sequence of int, optional
        Signals that came so far, where they are noted already; rclpy's own handlers would break into the
        writing of the log.

    Returns
    -------
    int
        Exit code: 0 after a signal, 2 where the arguments or the configuration cannot be used.
    """
    arguments = list(sys.argv if args is None else args)
    stopped = note_signals() if stopped is None else stopped
    code = 0 if stopped else _run(arguments, stopped)
    ignore_signals()
    return code


def _run(arguments: Sequence[str], stopped: Sequence[int]) -> int:
    set_logger_level("rcl", LoggingSeverity.FATAL)  # what it says of a faulty file is said below, better
    try:
        held = _checked(arguments)
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        set_logger_level("rcl", LoggingSeverity.UNSET)
        node = DiagnosticNode([Path(file).parent for file in _parameter_files(arguments)])
    except Exception as error:
        sys.stderr.write(f"hd_diag: {_reason(arguments, error)}\n")
        try_shutdown()
        return 2
    node.tell_files(held)
    executor = EventsExecutor()
    executor.add_node(node)
    sys.setswitchinterval(_SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()  # what lives as long as the node need not be looked at again
    with contextlib.suppress(ExternalShutdownException):
        while not stopped and ok():
            node.spin_once(executor)
    node.close()
    try_shutdown()
    return 0


class _UsageError(Exception):
    """Arguments that cannot be used."""


def _checked(arguments: Sequence[str]) -> dict[str, list[Any]]:
    """Names of the sections of each parameter file; refuses files and words that cannot be used."""
    unknown = remove_ros_args(list(arguments))[1:]
    if unknown:
        raise _UsageError(f"unknown arguments: {' '.join(unknown)} (those for ROS stand behind --ros-args)")
    held = {}
    for file in _parameter_files(arguments):
        try:
            held[file] = sections(file)
        except ConfigError as error:
            raise _UsageError(f"{file}: {error}") from error
    return held


def _parameter_files(arguments: Sequence[str]) -> list[str]:
    return [arguments[i + 1] for i, a in enumerate(arguments[:-1]) if a == "--params-file"]


def _reason(arguments: Sequence[str], error: Exception) -> str:
    """Why the node cannot start: the parameter file's own fault where it has one, which rcl words badly."""
    for file in _parameter_files(arguments) if not isinstance(error, _UsageError) else []:
        try:
            load(file)
        except ConfigError as found:
            return str(found)
    if type(error).__name__ == "UnknownROSArgsError":
        return f"unknown ROS arguments: {error}"
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(main())
