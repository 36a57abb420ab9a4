"""``hd-diag check``: whether a configuration is valid, and what it describes."""

from __future__ import annotations

import math

from hd_diag.cli.joints import configured
from hd_diag.cli.lines import tell
from hd_diag.cli.targets import Problem, write_json
from hd_diag.config import gear_file
from hd_diag.config.assessment import Assessment, assess
from hd_diag.config.configuration import JointConfig
from hd_diag.formatting import ARCSEC
from hd_diag.gears.characteristics import Characteristics
from hd_diag.gears.page import ASSUMED_PROFILE
from hd_diag.model.cams import Points


def check(config_file: str, json_file: str | None) -> None:
    """Run ``hd-diag check``."""
    config = configured(config_file)
    for joint in config.joints:
        check_fields(config_file, joint)
    found = {joint.name: assess(config, joint) for joint in config.joints}
    content = {"schema": "hd_diag/check/1", "valid": True, "parameters": dict(config.flat)}
    if write_json(json_file, content | {"joints": {name: each.content() for name, each in found.items()}}):
        for joint in config.joints:
            describe(joint, found[joint.name])
        tell(f"{config_file}: valid")


def check_fields(config_file: str, joint: JointConfig) -> None:
    """Raise a Problem if a signal's ROS 2 Jazzy type lacks its field; only bags know other types."""
    if not joint.mapped:
        return
    from hd_diag.messages.field_path import path_in  # late: slow, and rarely needed
    from hd_diag.messages.schemas import jazzy

    for name, signal in joint.mapped.items():
        if signal.type_name in jazzy().fielddefs:
            try:
                path_in(jazzy(), signal.type_name, signal)
            except ValueError as error:
                raise Problem(f"{config_file}: {name}.field: {error}") from error


def describe(joint: JointConfig, assessed: Assessment) -> None:
    """Print a joint's signals and drive, and the drive's characteristics."""
    drive, found = joint.configured, assessed.found
    mesh = drive.mesh
    names = zip(joint.signals, (joint.input_joint, joint.output_joint), strict=False)
    ends = [f"{s.field} ({s.topic or s.name})" if s else name for s, name in names]
    tell(
        f"{joint.name}: {ends[0]} -> {ends[1]}, ratio {drive.kinematics.ratio:g}, "
        f"{mesh.geometry.flexspline_teeth}/{mesh.geometry.circular_spline_teeth} teeth, "
        f"rated {drive.rated_torque:g} N m, eccentricity {abs(mesh.eccentricity) * 1e6:g} µm"
    )
    radius, cam = mesh.geometry.curve.radius, mesh.geometry.neutral_curve
    tell(f"  module {found.module * 1e3:.4g} mm, radius of the neutral layer {radius * 1e3:.4g} mm")
    if isinstance(cam, Points):
        rms, most = (1e6 * each for each in cam.residual)
        tell(f"  neutral_curve.points are off the fitted curve by {rms:.3g} µm rms, {most:.3g} µm at most")
    for line in gear_file.reached(assessed) if assessed.page else [_stiffness(found)]:
        tell(f"  {line}")
    pressed = found.loads.overlap > 0.0
    gap, told = ("overlap", ", their preload") if pressed else ("clearance", "")
    tell(
        f"  at rest: lost motion {found.lost_motion / ARCSEC:.3g} arcsec, least backlash "
        f"{found.least_backlash * 1e6:.3g} µm, {gap} of the lobes "
        f"{abs(found.loads.overlap) * 1e6:.3g} µm{told}"
    )
    if assessed.page:
        tell(f"  {ASSUMED_PROFILE}")
    tell(f"  {_errors(found, 0.5 * drive.rated_torque)}")
    for warning in assessed.warnings:
        tell(f"  warning: {warning}")


def _errors(found: Characteristics, torque: float) -> str:
    def listed(*points: tuple[float, float]) -> str:
        return ", ".join(f"{size / ARCSEC:.3g} at {e * 1e6:.3g} µm" for e, size in points)

    limit = "" if math.isnan(found.limit[0]) else f"; {listed(found.limit)}, the tolerance's limit by overlap"
    return (
        f"transmission error by eccentricity, order 2 of the input at {torque:g} N m [arcsec]: "
        f"{listed(*found.errors)}{limit}"
    )


def _stiffness(found: Characteristics) -> str:
    listed = ", ".join(f"K{i} {value:.3g}" for i, value in enumerate(found.stiffness, 1))
    return f"{listed} N m/rad (T1 {found.t1:.3g}, T2 {found.t2:.3g} N m)"
