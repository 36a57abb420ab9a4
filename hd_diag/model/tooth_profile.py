"""Double-circular-arc flank: a hollow and a bulging arc, joined by their exact common tangent."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

Point = tuple[float, float]


@dataclass(frozen=True)
class DoubleArc:
    """Counter-clockwise flank of a tooth or wall of a slot in its frame: x outward, y counter-clockwise.

    The outer arc bulges counter-clockwise (tooth addendum, or the slot wall that mates with it); the inner
    arc is hollow (tooth dedendum, or the circular spline's own addendum). A common tangent joins them.

    Parameters
    ----------
    addendum_radius, dedendum_radius : float
        Radii of the outer and the inner arc [m].
    addendum_center, dedendum_center : (float, float)
        Their centres [m]; the outer one beyond the axis (y < 0), the inner one ahead of the flank (y > 0).
    """

    addendum_radius: float
    dedendum_radius: float
    addendum_center: Point
    dedendum_center: Point

    @cached_property
    def normal_angle(self) -> float:
        """Direction of the common tangent's normal, out of the tooth [rad].

        Raises
        ------
        ValueError
            If the arcs overlap, so that no line can touch both.

        Notes
        -----
        The line ``n . p = c`` touches both arcs if ``n . (C_f - C_a) = rho_a + rho_f``. There are two
        solutions; the flank is the one that meets the inner arc first (at smaller x).
        """
        dx = self.dedendum_center[0] - self.addendum_center[0]
        dy = self.dedendum_center[1] - self.addendum_center[1]
        reach = (self.addendum_radius + self.dedendum_radius) / math.hypot(dx, dy)
        if reach > 1.0:
            raise ValueError(
                "the addendum and dedendum arcs overlap: no common tangent joins them "
                f"(radii add up to {self.addendum_radius + self.dedendum_radius:.6g} m, "
                f"centres are {math.hypot(dx, dy):.6g} m apart)"
            )
        return math.atan2(dy, dx) - math.acos(reach)

    @cached_property
    def normal(self) -> Point:
        """Unit normal of the common tangent, out of the tooth."""
        return math.cos(self.normal_angle), math.sin(self.normal_angle)

    @cached_property
    def addendum_joint(self) -> Point:
        """Point where the outer arc meets the tangent [m]."""
        return (
            self.addendum_center[0] + self.addendum_radius * self.normal[0],
            self.addendum_center[1] + self.addendum_radius * self.normal[1],
        )

    @cached_property
    def dedendum_joint(self) -> Point:
        """Point where the tangent meets the inner arc [m]."""
        return (
            self.dedendum_center[0] - self.dedendum_radius * self.normal[0],
            self.dedendum_center[1] - self.dedendum_radius * self.normal[1],
        )

    def half_width(self, x: float) -> float:
        """Half the tooth's or slot's width at height ``x`` in the flank's frame [m]; nan beyond its arcs."""
        if x <= self.dedendum_joint[0]:
            reach = self.dedendum_radius**2 - (x - self.dedendum_center[0]) ** 2
            return self.dedendum_center[1] - math.sqrt(reach) if reach >= 0 else math.nan
        if x >= self.addendum_joint[0]:
            reach = self.addendum_radius**2 - (x - self.addendum_center[0]) ** 2
            return self.addendum_center[1] + math.sqrt(reach) if reach >= 0 else math.nan
        (x0, y0), (nx, ny) = self.addendum_joint, self.normal
        return y0 - (x - x0) * nx / ny
