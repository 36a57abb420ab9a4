"""Settings of a monitor: joints with their drives, names and limits; rates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hd_diag.drive import Drive
from hd_diag.streams.alignment import ELSEWHERE, Names
from hd_diag.streams.signals import ROLES, USUAL, JointSignals, Signal, key

if TYPE_CHECKING:
    from hd_diag.extended_model import ExtendedModel


@dataclass(frozen=True)
class Limit:
    """Thresholds of one quantity, in its unit."""

    warn: float
    error: float

    def level(self, value: float) -> int:
        """0, 1 (above warn) or 2 (above error), as in diagnostic_msgs/DiagnosticStatus; nan is 0."""
        return 2 if value > self.error else 1 if value > self.warn else 0


@dataclass(frozen=True)
class JointConfig:
    """One joint: its names in JointState, its drive, assumed torque [N m] and limits.

    With an extended model `drive` is the model's, refitted; `configured` is that of the parameters.
    `model_text` is the whole content of the model's file. `signals` are those outside their usual places;
    `input_divided` tells whether the input is reported at the output's side.
    """

    name: str
    input_joint: str
    output_joint: str
    drive: Drive
    torque: float
    limits: Mapping[str, Limit]
    configured: Drive
    model_file: str = ""
    model: ExtendedModel | None = None
    model_text: str = field(default="", repr=False)
    signals: JointSignals = USUAL
    input_divided: bool = False

    @property
    def mapped(self) -> dict[str, Signal]:
        """Signals outside their usual places, by the keys of their columns."""
        pairs = zip(ROLES, self.signals, strict=True)
        return {key(self.name, role): signal for role, signal in pairs if signal is not None}

    @property
    def names(self) -> Names:
        """Names and factors of the joint for the alignment of streams."""
        has = {
            role: key(self.name, role) for role, s in zip(ROLES, self.signals, strict=True) if s is not None
        }
        own = has.get("input", "")
        # A mapped angle comes without speed, a mapped velocity without angle.
        angle, speed = (ELSEWHERE, own) if self.signals.is_velocity else (own, own and ELSEWHERE)
        keys = angle, has.get("output", ""), has.get("torque", ""), speed
        ratio = self.drive.kinematics.ratio
        factor, velocity_ratio = ratio if self.input_divided else 1.0, ratio * self.signals.is_velocity
        counters = (0.0 if s is None else s.unit.counter for s in self.signals[:2])
        names = self.input_joint, self.output_joint
        return Names(*names, self.torque, keys, factor, velocity_ratio, *counters)


@dataclass(frozen=True)
class MonitorConfig:
    """Joints, and how often per-tooth arrays and drawings are published [Hz]; zero: never."""

    joints: tuple[JointConfig, ...]
    array_rate: float
    mesh_rate: float
