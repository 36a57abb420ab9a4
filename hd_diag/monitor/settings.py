"""What a monitor is set up with: joints with their drives, names, limits; rates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hd_diag.drive import Drive
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
    """One joint: the names it has in JointState, its drive, assumed torque [N m] and limits.

    With an extended model `drive` is the model's, refitted; `configured` is what the parameters say.
    `model_text` is the whole content of the model's file.
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


@dataclass(frozen=True)
class MonitorConfig:
    """Joints, and how often per-tooth arrays and drawings are published [Hz]; zero: never."""

    joints: tuple[JointConfig, ...]
    array_rate: float
    mesh_rate: float
