"""What a configured joint is, in a catalogue's numbers, and what is wrong with it as a gear."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from hd_diag.config.configuration import Config, JointConfig
from hd_diag.config.defaults import EXAMPLE, Page, page_of
from hd_diag.config.parameters import of_joint
from hd_diag.drive import Drive
from hd_diag.gear.characteristics import Characteristics, ToothLoads, characteristics, slot_shift

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
    warnings = [
        *_overlap(perfect.loads, joint),
        *_stiffness(perfect, page),
        *_load(perfect.loads.rated, drive, joint),
    ]
    warnings += _dissimilar(drive) if page else []
    return Assessment(found, page, warnings)


def _overlap(found: ToothLoads, joint: JointConfig) -> list[str]:
    if found.overlap <= max(0.0, _BY_ITSELF * joint.limits["overlap"].warn):
        return []
    return [
        f"the lobes overlap by {found.overlap * 1e6:.3g} µm without eccentricity, which presses a tooth with "
        f"{found.idle:.3g} N without torque: neutral curve and slots do not fit each other"
    ]


def _dissimilar(drive: Drive) -> list[str]:
    geometry = drive.mesh.geometry
    if geometry.flexspline_teeth >= _DISSIMILAR_TEETH:
        return []
    shift = slot_shift(EXAMPLE.mesh.geometry, geometry)
    share = shift / (geometry.flexspline_tip - geometry.flexspline_root)
    return [
        f"{geometry.flexspline_teeth} teeth of the flexspline: slots have to lie {shift * 1e6:.0f} µm "
        f"further out than at ratio 100, {100.0 * share:.0f} % of a tooth's height; such gears have another "
        "profile and deformation, and what depends on them (backlash of single teeth, first interference, "
        "tooth forces) is a guess"
    ]


def _stiffness(found: Characteristics, page: Page | None) -> list[str]:
    if page is None:
        return []
    pairs = zip(_STEPS, found.stiffness.tolist(), page.stiffness, strict=True)
    return [
        f"{name.upper()} is {reached:.3g} N m/rad, {reached / given:.2g} times what gear.{name} gives "
        f"({given:.3g}): compliances or T1, T2 are not those of the page"
        for name, reached, given in pairs
        if not 1.0 / _FAR < reached / given < _FAR
    ]


def _load(rated: float, drive: Drive, joint: JointConfig) -> list[str]:
    force, torque = joint.limits["peak_tooth_load"], joint.limits["torque"]
    problems = []
    if math.isnan(rated):
        problems.append(f"the teeth cannot bear the rated torque, {drive.rated_torque:g} N m")
    elif force.level(rated):
        problems.append(
            f"the rated torque, {drive.rated_torque:g} N m, puts {rated:.3g} N on a tooth: more "
            f"than limits.peak_tooth_load.warn, {force.warn:g} N"
        )
    if torque.level(abs(joint.torque) / drive.rated_torque):
        problems.append(
            f"torque, {joint.torque:g} N m, is {abs(joint.torque) / drive.rated_torque:.2g} times the rated "
            f"torque: more than limits.torque.warn, {torque.warn:g}"
        )
    return problems
