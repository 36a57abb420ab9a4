"""What ``hd-diag ripple`` takes, and its help."""

from __future__ import annotations

from hd_diag.cli import options


@options.verb("ripple joint.mcap --config arm.yaml")
@options.records
@options.JSON
def ripple() -> None:
    """Look for lines of the torque, or of a current, at the gear's orders over a turn of the output.

    For robots that report one angle a joint, with a torque or a current: no transmission error can be had of
    it, and no eccentricity. Friction, gravity and inertia are taken off as smooth parts. A line must have the
    same phase in all stretches of the motion, and stand out of the orders beside its own. Several bags are
    recordings of the same joint. A joint that cannot be judged is reported on stderr, the others go on, and
    the exit code is 2.
    """
