"""What ``hd-diag ripple`` takes, and its help."""

from __future__ import annotations

from hd_diag.cli import options


@options.verb("ripple joint.mcap --config arm.yaml")
@options.records
@options.JSON
def ripple() -> None:
    """Find periodic torque ripple at the gear's orders, for robots that report one angle for each joint.

    With one angle and a torque or a current, neither the transmission error nor an eccentricity can be
    measured; a periodic ripple of the torque can. Friction, gravity and inertia are removed as smooth parts.
    A line is reported only if it has the same phase in all stretches of the motion and is larger than the
    orders beside it. Several bags are recordings of the same joint. If a joint cannot be judged, stderr says
    so, the other joints are judged, and the exit code is 2.
    """
