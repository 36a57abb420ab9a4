"""The configuration as the node's ROS parameters, checked as a whole at the start and on each change."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter_service import ParameterService

from hd_diag.config.configuration import Config, ConfigError, ModelText, resolve
from hd_diag.config.parameters import ROS_PARAMETERS, SIGNALS, ContentError, Parameter, parameters
from hd_diag.formatting import visible

# Longest time for reading a model file [s]: samples wait meanwhile in the subscription's queue.
_PATIENCE, _PATIENCE_AT_START = 0.25, 10.0
_LONGEST_REASON = 2000  # characters
_MAPPINGS = (*SIGNALS, "output_joint")  # beginnings of the parameters that map a joint's signals


class ParameterServer:
    """Parameters of a node that was made with its overrides declared, and without parameter services.

    `config` is the last accepted configuration. Raises ConfigError if the values given at the start are
    invalid.
    """

    def __init__(self, node: Node, model_text: ModelText) -> None:
        self._node = node
        self._model_text = model_text
        declared: dict[str, Any] = node.get_parameters_by_prefix("")
        given = {name: _plain(known.value) for name, known in declared.items() if _is_own(name)}
        self._reading: threading.Thread | None = None
        self.config = self._next = resolve(given, partial(self._read, patience=_PATIENCE_AT_START))
        self._known = parameters([joint.name for joint in self.config.joints])
        for name in given:
            node.undeclare_parameter(name)
        for name, spec in self._known.items():
            value, descriptor = self.config.flat[name], _descriptor(name, spec)
            node.declare_parameter(name, value, descriptor, ignore_override=True)

    def serve(self, apply: Callable[[Config], Any]) -> None:
        """Accept changes from now on; `apply` puts each accepted configuration in force."""

        def accept(_: Sequence[RosParameter]) -> None:
            self.config = self._next
            apply(self.config)

        self._node.add_pre_set_parameters_callback(self._checked)
        self._node.add_post_set_parameters_callback(accept)
        self._services = _Services(self._node)

    def _checked(self, changed: Sequence[RosParameter]) -> list[RosParameter]:
        """The changed parameters in their declared types, and the parameters that follow from them.

        A geometry, for example, follows from a catalogue page. Raises ConfigError for invalid values, and for
        parameters fixed at the start: no other process may choose where this one writes.
        """
        for parameter in changed:
            if parameter.name in self._known and _is_fixed(parameter.name):
                raise ConfigError(f"{parameter.name}: is fixed when the node starts (read-only)")
        self._next = self._candidate(changed)
        asked, before = {parameter.name for parameter in changed}, self.config.flat
        following = {n: v for n, v in self._next.flat.items() if v != before[n] and n not in asked}
        typed = [_as_declared(parameter, self._known.get(parameter.name)) for parameter in changed]
        return typed + [RosParameter(name, value=value) for name, value in following.items()]

    def _candidate(self, changed: Sequence[RosParameter]) -> Config:
        own = {p.name: _plain(p.value) for p in changed if _is_own(p.name)}
        for name, value in own.items():
            if value is None:
                raise ConfigError(f"{name}: cannot be removed")
        in_force = {joint.name: joint.model_text for joint in self.config.joints}

        def model_text(joint: str, path: str) -> str:
            """Read a model again only if its parameter is set: the file may have changed, or be gone."""
            kept = f"{joint}.model_file" not in own and in_force[joint]
            return kept or self._read(joint, path, _PATIENCE)

        try:
            candidate = resolve({**self.config.given, **own}, model_text)
        except ContentError as error:  # do not reveal contents: it may be any readable file
            raise ConfigError(error.discreet) from error
        return candidate

    def _read(self, joint: str, path: str, patience: float) -> str:
        """Text of a model file, read in a thread, because some disks, as of a network, may block for ever."""
        if self._reading is not None and self._reading.is_alive():
            raise ConfigError("cannot be read: the file before is still being read")
        found: queue.SimpleQueue[str | Exception] = queue.SimpleQueue()

        def read() -> None:
            try:
                found.put(self._model_text(joint, path))
            except Exception as error:
                found.put(error)

        self._reading = threading.Thread(target=read, name="model file", daemon=True)
        self._reading.start()
        try:
            result = found.get(timeout=patience)
        except queue.Empty:
            raise ConfigError(f"cannot be read: that takes longer than {patience:g} s") from None
        if isinstance(result, Exception):
            raise result
        return result


class _Services(ParameterService):
    """The parameter services of every node, made to answer every request.

    rclpy's own services raise instead of answering if a parameter has a type that ROS does not know.
    """

    def _set_parameters_callback(self, request: Any, response: Any) -> Any:
        response.results = [self._set([each]) for each in request.parameters]
        return response

    def _set_parameters_atomically_callback(self, request: Any, response: Any) -> Any:
        response.result = self._set(request.parameters)
        return response

    def _set(self, given: Sequence[Any]) -> SetParametersResult:
        try:
            changed = [RosParameter.from_parameter_msg(each) for each in given]
            return self._get_node().set_parameters_atomically(changed)
        except Exception as error:  # rclpy raises many kinds
            return SetParametersResult(successful=False, reason=visible(str(error), _LONGEST_REASON))


def _descriptor(name: str, spec: Parameter) -> ParameterDescriptor:
    """Descriptor of a parameter for tools: its range or choices as text, ranges of numbers as sliders too."""
    limits = f"{spec.low:g} to {spec.high:g}" if np.isfinite([spec.low, spec.high]).all() else ""
    descriptor = ParameterDescriptor(
        name=name,
        description=f"{spec.meaning}{f' [{spec.unit}]' if spec.unit else ''}",
        dynamic_typing=True,  # integers are accepted for floats: `_checked` converts them
        additional_constraints="one of " + ", ".join(spec.choices) if spec.choices else limits,
        read_only=_is_fixed(name),
    )
    if type(spec.default) is int and spec.choices:
        low, high = map(int, spec.choices)
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=high - low)]
    elif limits and type(spec.default) is int:
        descriptor.integer_range = [IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)]
    elif limits and type(spec.default) is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=spec.low, to_value=spec.high)]
    return descriptor


def _as_declared(parameter: RosParameter, spec: Parameter | None) -> RosParameter:
    """An integer as a float if a float was declared: readers look for it there."""
    is_number = spec is not None and isinstance(spec.default, float)
    if not is_number or parameter.type_ != RosParameter.Type.INTEGER:
        return parameter
    return RosParameter(parameter.name, RosParameter.Type.DOUBLE, float(parameter.value))


def _is_fixed(parameter: str) -> bool:
    """Whether a parameter is read only when the node starts.

    This includes all that map a joint's signals: topics are subscribed to at the start, and a log is
    replayed by the names at its beginning.
    """
    is_mapping = parameter.partition(".")[2].startswith(_MAPPINGS)
    return is_mapping or parameter == "joints" or parameter.startswith("log.")


def _is_own(parameter: str) -> bool:
    """Whether a parameter belongs to the configuration; every ROS node has some that do not."""
    return parameter.split(".")[0] not in ROS_PARAMETERS


def _plain(value: Any) -> Any:
    """A parameter's value in plain Python: arrays as lists."""
    return list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else value
