"""What ``hd-diag mesh`` takes, and its help."""

from __future__ import annotations

from hd_diag.cli import options


@options.verb("mesh --config arm.yaml --joint elbow --torque 14")
@options.CONFIG
@options.JOINT
@options.shown("--input-angle", 0.0, "Reported input angle [rad].")
@options.shown("--torque", 0.0, "Torque M [N m].")
@options.JSON
def mesh() -> None:
    """Show backlash and load of every tooth, torsion and transmission error at one angle and torque.

    Torsion and loads are those of a torque M that turns the cup counter-clockwise (M > 0 bears on + flanks).
    The transmission error is the drive's when it exerts M on the link, whose reaction on the cup is -M for an
    output at the flexspline; "as_driven" holds torsion and loads of that state, which the node publishes.
    """
