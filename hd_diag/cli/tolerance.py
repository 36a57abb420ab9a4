"""``hd-diag tolerance``: the eccentricity and tilt an assembly may have, and what a tolerance yields."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from hd_diag.cli.joints import chosen_joint, configured
from hd_diag.cli.lines import number_table, show_table, tell
from hd_diag.cli.progress import showing
from hd_diag.cli.targets import Problem, write_json, writing
from hd_diag.cli.verbs.drives import LIMITS
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.config.defaults import page_of
from hd_diag.config.parameters import of_joint
from hd_diag.formatting import words
from hd_diag.gears.page import ASSUMED_PROFILE
from hd_diag.model.threads import cores
from hd_diag.process_pool import ProcessPool
from hd_diag.tolerance import limit
from hd_diag.tolerance.assembly import FACTORS
from hd_diag.tolerance.evaluation import CRITERIA
from hd_diag.tolerance.study import (
    Interference,
    Question,
    Study,
    Tilts,
    document,
    limits_and_spreads,
    study,
    yielded,
)


def tolerance(
    config_file: str | None, joint: str | None, json_file: str | None, figure: Path | None, **given: Any
) -> None:
    """Run ``hd-diag tolerance``."""
    config = configured(config_file)
    chosen = chosen_joint(config, joint)
    try:
        question = _question(config, chosen, given)
        with showing() as part, ProcessPool(given["jobs"] or cores()) as pool:

            def counted(what: str, steps: int) -> Callable[[], None]:
                advance, done = part(what), itertools.count(1)
                advance(0, steps)
                return lambda: advance(next(done), steps)

            found = study(question, pool, counted)
    except ValueError as error:
        raise Problem(f"{chosen.name}: {error}") from error
    if figure:
        from hd_diag.report.pictures.tolerance import save, tolerance_picture  # late: matplotlib is slow

        with writing(figure) as place:
            save(tolerance_picture(found), place)
    if write_json(json_file, document(chosen.name, found)):
        _show(chosen.name, found)
        if page_of(of_joint(config.flat, chosen.name)):
            tell(f"{ASSUMED_PROFILE.capitalize()}.")


def _question(config: Config, joint: JointConfig, given: dict[str, Any]) -> Question:
    samples, largest = given["sensitivity_samples"], given["largest_um"]
    if samples & (samples - 1) or samples == 1:
        raise Problem(f"--sensitivity-samples must be a power of two from 2 on, not {samples}")
    limits, spreads = limits_and_spreads(config.flat, joint.name)
    for option, (name, unit, *_) in LIMITS.items():
        if given[option] is not None:
            limits[name] = given[option] * unit
            if not math.isfinite(limits[name]):
                raise Problem(f"the limit of {name} must be finite")
    return Question(
        joint.drive,
        np.array(given["torques"] or (joint.drive.rated_torque,), dtype=np.float64),
        limits,
        spreads,
        limit.largest_eccentricity(joint.drive) if largest is None else largest * 1e-6,
        given["samples"],
        samples,
        given["seed"],
        given["target"],
    )


def _show(joint: str, found: Study) -> None:
    question = found.question
    tell(f"{joint}: eccentricity up to {question.largest * 1e6:.3g} µm, in all directions")
    tell(_first_interference(found.interference, question))
    for torque, row in zip(question.torque, found.limits, strict=True):
        title, most = f"Limits at {torque:g} N m", question.largest * 1e6
        show_table(
            _limit_table(question, title, "[µm]", most, [(each, each.eccentricity * 1e6) for each in row])
        )
    allowed = found.allowed
    least = f"Allowed: {allowed.eccentricity * 1e6:.2f} µm, by {allowed.criterion}" if allowed else None
    tell(least or "No limit is reached.")
    if found.tilts is not None:
        _show_tilts(question, found.tilts)
    if found.assemblies is not None:
        _show_assemblies(found)
    if found.sensitivity is not None:
        show_table(_sensitivity_table(found))
    pitch, step = question.drive.mesh.geometry.slot_pitch, question.largest / limit.STEPS * 1e6
    angle, turn = limit.RESOLUTION
    tell(
        f"Resolution: eccentricity in steps of {step:.2g} µm (where a criterion jumps: "
        f"{step / limit.FINE_STEPS:.2g} µm), then solved to {limit.ROOT_TOLERANCE * 1e6:.0e} µm; angle from "
        f"the long axis {angle * 1e3:.2g} mrad, wave generator {turn * pitch * 1e6:.2g} µrad."
    )


def _first_interference(first: Interference, question: Question) -> str:
    if first.clearance < 0.0 and first.all_teeth.eccentricity == 0.0:
        return (
            "As built, without eccentricity, teeth of the lobe at tooth 0 overlap by "
            f"{-first.clearance * 1e6:.3f} µm, and no rotation of the cup frees the teeth of "
            "both lobes: a preload."
        )
    return (
        f"Interference of the lobe at tooth 0 begins at {_um(first.across, question)} across the long axis "
        f"(the paper's arrangement; {first.clearance * 1e6:.3f} µm of backlash without eccentricity), at "
        f"{_um(first.any_direction.eccentricity, question)} in the worst direction; "
        f"from {_um(first.all_teeth.eccentricity, question)} on no rotation of the cup frees the "
        "teeth of both lobes."
    )


def _um(eccentricity: float, question: Question) -> str:
    if math.isfinite(eccentricity):
        return f"{eccentricity * 1e6:.2f} µm"
    return f"more than {question.largest * 1e6:.3g} µm"


def _show_tilts(question: Question, tilts: Tilts) -> None:
    for torque, row in zip(question.torque, tilts.limits, strict=True):
        title, most = f"Limits of a tilt alone at {torque:g} N m", tilts.largest * 1e3
        show_table(_limit_table(question, title, "[mrad]", most, [(each, each.tilt * 1e3) for each in row]))
    allowed = tilts.allowed
    least = f"Allowed without eccentricity: {allowed.tilt * 1e3:.3f} mrad" if allowed else None
    tell(f"{least}, by {allowed.criterion}" if allowed else "No limit is reached by a tilt alone.")


def _limit_table(
    question: Question, title: str, unit: str, most: float, row: list[tuple[limit.DisplacementLimit, float]]
) -> Table:
    """Table of limits; `row` has each limit and the displacement that reaches it, in `unit`, up to `most`."""
    columns = ("limit", "without", f"at\n{unit}", "direction\n[rad]", "\n[deg]", "input\n[rad]")
    table = number_table("criterion", *columns, title=title)
    for criterion, (each, reaches) in zip(CRITERIA, row, strict=True):
        values = (f"{value * criterion.scale:.4g}" for value in (each.limit, each.without))
        place: tuple[str, ...] = f"> {most:.4g}", "not reached"
        if each.reached:
            toward, worst = each.worst.direction, each.worst.wave_generator_angle
            angle = limit.input_angle(question.drive, worst)
            at = f"{reaches:.3f}"
            place = at, f"{toward:.3f}", f"{math.degrees(toward):.1f}", f"{angle:.4f}"
        table.add_row(f"{criterion.name} [{criterion.shown}]", *values, *place)
    return table


def _show_assemblies(found: Study) -> None:
    drawn, question = found.assemblies, found.question
    assert drawn is not None
    columns = ("all (95 %)", *(criterion.brief for criterion in CRITERIA))
    title = f"Share of {question.samples} assemblies within the limits [%]"
    table = number_table("to [µm]", *columns, title=title)
    for k, value in enumerate(drawn.tolerances):
        t = drawn.together
        together = f"{100 * t.share[k]:.1f} ({100 * t.low[k]:.1f}-{100 * t.high[k]:.1f})"
        table.add_row(f"{value * 1e6:.2f}", together, *(f"{100 * s.share[k]:.1f}" for s in drawn.each))
    show_table(table)
    tell(yielded(question, drawn))


def _sensitivity_table(found: Study) -> Table:
    assert found.sensitivity is not None
    # Estimates of an index near zero may be negative; a share may not.
    estimates = found.sensitivity.first.value, found.sensitivity.total.value
    first, total = (np.maximum(each, 0.0) for each in estimates)
    title = "What matters at the configured tolerances: total (first) Sobol index [%]"
    table = number_table("spread of", *(criterion.brief for criterion in CRITERIA), title=title)
    for i in np.argsort(-np.nan_to_num(total).mean(axis=0), kind="stable"):
        pairs = zip(total[:, i], first[:, i], strict=True)
        table.add_row(words(FACTORS[i]), *(f"{100 * t:.0f} ({100 * f:.0f})" for t, f in pairs))
    return table
