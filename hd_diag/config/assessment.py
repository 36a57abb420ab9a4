"""Assessment of a configured joint: its characteristics in a catalogue's terms, and warnings as a gear."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.config.defaults import EXAMPLE, page_of
from hd_diag.config.parameters import of_joint
from hd_diag.gears.characteristics import (
    Characteristics,
    characteristics,
    mean_torsion,
    slot_shift,
    tooth_loads,
)
from hd_diag.gears.page import Page

_FAR = 1.5  # factor between reached and given stiffness that is warned of [-]
# Allowed overlap without eccentricity over its warning limit [-]; the second is for a drive with a page,
# whose torsion curve needs up to 0.3 among all gears of the table.
_BY_ITSELF, _BY_PAGE = 0.25, 0.5
_DISSIMILAR_TEETH = 100  # of a flexspline; gears with fewer hardly have the profile of ratio 100
_STEPS = ("k1", "k2", "k3")


@dataclass(frozen=True)
class Assessment:
    """A joint's characteristics, its catalogue page (None: it has none) and warnings, each one line.

    `torsion` (3, 8) compares the drive with the page: torque [N m], torsion of the page and of the drive
    without eccentricity [rad]; (3, 0) without a page.
    """

    found: Characteristics
    page: Page | None
    torsion: Floats
    warnings: list[str]

    def content(self) -> dict[str, Any]:
        """Content that `hd-diag check --json` and `gear --json` write for a joint; units are SI."""
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
            "errors": [{"eccentricity": e, "order_2": size} for e, size in (*found.errors, found.limit)],
            "peak_tooth_load": {"idle": found.loads.idle, "rated": found.loads.rated},
            "given": dict(zip(_STEPS, self.page.stiffness, strict=True)) if self.page else None,
            "torsion": dict(zip(("torque", "given", "reached"), self.torsion.tolist(), strict=True)),
            "warnings": self.warnings,
        }


def assess(config: Config, joint: JointConfig) -> Assessment:
    """Assessment of one joint of a configuration, as configured."""
    own = of_joint(config.flat, joint.name)
    page, drive = page_of(own), joint.configured
    t1, t2 = (page.t1, page.t2) if page else (own["gear.t1"], own["gear.t2"])
    overlap = own["tolerance.limits.overlap"]
    found = characteristics(drive, t1, t2, overlap)
    perfect = replace(drive, mesh=replace(drive.mesh, eccentricity=0.0, runout=0.0, tilt=0.0))
    torsion = np.zeros((3, 0))
    if page:
        torque = page.torques
        torsion = np.stack([torque, page.torsion(torque), mean_torsion(perfect, torque)])
    warnings = _warnings(characteristics(perfect, t1, t2, overlap), page, joint)
    return Assessment(found, page, torsion, list(warnings))


def _warnings(found: Characteristics, page: Page | None, joint: JointConfig) -> Iterator[str]:
    """Warnings of values that no gear has or that depart from the page; `found` is without eccentricity.

    A cup's coning presses the teeth by design, so only the middle section shows whether curve and slots fit.
    """
    drive, loads, limits = joint.configured, found.loads, joint.limits
    middle = replace(drive.mesh, geometry=replace(drive.mesh.geometry, sections=1), tilt=0.0)
    middle = replace(middle, eccentricity=0.0, runout=0.0)
    pressed = tooth_loads(replace(drive, mesh=middle)).overlap
    share = _BY_PAGE if page else _BY_ITSELF
    if pressed > max(0.0, share * limits["overlap"].warn):
        yield (
            f"the lobes overlap by {pressed * 1e6:.3g} µm without eccentricity, which presses a tooth "
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
