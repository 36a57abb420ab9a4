"""What a configured joint is, in a catalogue's numbers, and what is wrong with it as a gear."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from hd_diag.config.configuration import Config, JointConfig
from hd_diag.config.defaults import EXAMPLE, Page, page_of
from hd_diag.config.parameters import of_joint
from hd_diag.gear.characteristics import Characteristics, characteristics, slot_shift

_FAR = 1.5  # reached over given stiffness, either way [-]
_BY_ITSELF = 0.25  # of the overlap that is warned of, without any eccentricity [-]
_DISSIMILAR_TEETH = 100  # of a flexspline; with fewer the profile of ratio 100 is hardly a gear's
_STEPS = ("k1", "k2", "k3")


@dataclass(frozen=True)
class Assessment:
    """A joint's characteristics, its catalogue page (None: it has none) and warnings, each one line."""

    found: Characteristics
    page: Page | None
    warnings: list[str]

    def content(self) -> dict[str, Any]:
        """What `hd-diag check --json` and `gear --json` write of a joint; units are SI."""
        found = self.found
        return {
            "module": found.module,
            **dict(zip(_STEPS, found.stiffness.tolist(), strict=True)),
            "t1": found.t1,
            "t2": found.t2,
            "lost_motion": found.lost_motion,
            "least_backlash": found.least_backlash,
            "overlap": found.loads.overlap,
            "error_per_eccentricity": found.error_per_eccentricity,
            "peak_tooth_load": {"idle": found.loads.idle, "rated": found.loads.rated},
            "given": dict(zip(_STEPS, self.page.stiffness, strict=True)) if self.page else None,
            "warnings": self.warnings,
        }


def assess(config: Config, joint: JointConfig) -> Assessment:
    """Assessment of one of a configuration's joints as it is configured."""
    own = of_joint(config.flat, joint.name)
    page, drive = page_of(own), joint.configured
    steps = (page.t1, page.t2) if page else (own["gear.t1"], own["gear.t2"])
    found = characteristics(drive, *steps)
    mesh = drive.mesh
    perfect = found
    if mesh.eccentricity or mesh.runout:
        perfect = characteristics(replace(drive, mesh=replace(mesh, eccentricity=0.0, runout=0.0)), *steps)
    return Assessment(found, page, list(_warnings(perfect, page, joint)))


def _warnings(found: Characteristics, page: Page | None, joint: JointConfig) -> Iterator[str]:
    """What no gear has, or not the one of the page; the characteristics are those without eccentricity."""
    drive, loads, limits = joint.configured, found.loads, joint.limits
    if loads.overlap > max(0.0, _BY_ITSELF * limits["overlap"].warn):
        yield (
            f"the lobes overlap by {loads.overlap * 1e6:.3g} µm without eccentricity, which presses a tooth "
            f"with {loads.idle:.3g} N without torque: neutral curve and slots do not fit each other"
        )
    steps = zip(_STEPS, found.stiffness.tolist(), page.stiffness, strict=True) if page else ()
    for name, reached, given in steps:
        if not 1.0 / _FAR < reached / given < _FAR:
            yield (
                f"{name.upper()} is {reached:.3g} N m/rad, {reached / given:.2g} times what gear.{name} "
                f"gives ({given:.3g}): compliances or T1, T2 are not those of the page"
            )
    if math.isnan(loads.rated):
        yield f"the teeth cannot bear the rated torque, {drive.rated_torque:g} N m"
    elif limits["peak_tooth_load"].level(loads.rated):
        yield (
            f"the rated torque, {drive.rated_torque:g} N m, puts {loads.rated:.3g} N on a tooth: more "
            f"than limits.peak_tooth_load.warn, {limits['peak_tooth_load'].warn:g} N"
        )
    share = abs(joint.torque) / drive.rated_torque
    if limits["torque"].level(share):
        yield (
            f"torque, {joint.torque:g} N m, is {share:.2g} times the rated torque: more than "
            f"limits.torque.warn, {limits['torque'].warn:g}"
        )
    geometry = drive.mesh.geometry
    if page and geometry.flexspline_teeth < _DISSIMILAR_TEETH:
        shift = slot_shift(EXAMPLE.mesh.geometry, geometry)
        height = geometry.flexspline_tip - geometry.flexspline_root
        yield (
            f"{geometry.flexspline_teeth} teeth of the flexspline: slots have to lie {shift * 1e6:.0f} µm "
            f"further out than at ratio 100, {100.0 * shift / height:.0f} % of a tooth's height; such gears "
            "have another profile and deformation, and what depends on them (backlash of single teeth, first "
            "interference, tooth forces) is a guess"
        )
