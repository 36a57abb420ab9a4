"""``hd-diag tolerance``: the eccentricity an assembly may have, and what a tolerance yields."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hd_diag.cli import options
from hd_diag.cli.progress import showing
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.formatting import ARCSEC, words
from hd_diag.model.threads import cores
from hd_diag.process_pool import ProcessPool
from hd_diag.tolerance import limit
from hd_diag.tolerance.assembly import FACTORS
from hd_diag.tolerance.criteria import CRITERIA
from hd_diag.tolerance.document import document, yielded
from hd_diag.tolerance.study import Question, Study, limits_and_spreads, study

_UM = 1e-6
_SHARE = click.FloatRange(0.0, 1.0)
# Options that take the place of configured limits: criterion, unit in SI, range, help.
_LIMITS = {
    "interference_um": ("interference", _UM, click.FLOAT, "the overlap of teeth at one lobe [um]"),
    "overlap_um": ("overlap", _UM, click.FLOAT, "the overlap of both lobes, no torque [um]"),
    "peak_load": ("peak_tooth_load", 1.0, click.FloatRange(0.0), "the force on a flank [N]"),
    "load_concentration": ("load_concentration", 1.0, click.FloatRange(1.0), "largest over mean force [-]"),
    "stiffness_loss": ("stiffness_loss", 1.0, _SHARE, "the share of torsional stiffness lost [-]"),
    "te_arcsec": ("transmission_error", ARCSEC, click.FloatRange(0.0), "the error, peak to peak [arcsec]"),
}


def _limit_options(function: Callable[..., None]) -> Callable[..., None]:
    for name, (_, _, kind, what) in reversed(_LIMITS.items()):
        function = click.option(f"--{name.replace('_', '-')}", type=kind, help=f"Limit on {what}.")(function)
    return function


@options.verb("tolerance --config arm.yaml --joint elbow --te-arcsec 20")
@options.CONFIG
@options.JOINT
@click.option(
    "--torque",
    "torques",
    type=float,
    multiple=True,
    help="On the link [N m]; repeatable. [default: the rated torque]",
)
@_limit_options
@click.option(
    "--largest-um", type=float, help="Look for limits up to here [um]. [default: a fifth of the module]"
)
@options.shown("--samples", 500, "Assemblies to draw; 0 = none.", type=click.IntRange(0, 1_000_000))
@options.shown(
    "--sensitivity-samples",
    128,
    "For the Sobol indices, a power of two; 0 = none.",
    type=click.IntRange(0, 1 << 20),
)
@options.shown("--seed", 0, "Of the random assemblies.", type=click.IntRange(0))
@options.shown("--target", 0.95, "Share of assemblies that shall be good [-].", type=_SHARE)
@options.JOBS
@options.JSON
@options.figure_option("the result")
def tolerance(
    config_file: str | None, joint: str | None, json_file: str | None, figure: Path | None, **given: Any
) -> None:
    """Say what eccentricity an assembly may have.

    For every criterion the eccentricity that first exceeds its limit, over all directions and input angles;
    then assemblies drawn from the configured tolerances: the share within the limits against the tolerance of
    the eccentricity, and which tolerance matters. Limits and tolerances are in the configuration's section
    "tolerance"; an option takes a limit's place.
    """
    config = options.configured(config_file)
    chosen = options.chosen_joint(config, joint)
    try:
        question = _question(config, chosen, given)
        with showing() as part, ProcessPool(given["jobs"] or cores()) as pool:

            def counted(what: str, steps: int) -> Callable[[], None]:
                advance, done = part(what), itertools.count(1)
                advance(0, steps)
                return lambda: advance(next(done), steps)

            found = study(question, pool, counted)
    except ValueError as error:
        raise options.Problem(f"{chosen.name}: {error}") from error
    if json_file:
        options.write_json(json_file, document(chosen.name, found))
    if figure:
        from hd_diag.report.pictures.tolerance import save, tolerance_picture  # matplotlib takes its time

        with options.writing(figure) as place:
            save(tolerance_picture(found), place)
    if json_file != "-":
        _show(chosen.name, found)


def _question(config: Config, joint: JointConfig, given: dict[str, Any]) -> Question:
    samples, largest = given["sensitivity_samples"], given["largest_um"]
    if samples & (samples - 1) or samples == 1:
        raise options.Problem(f"--sensitivity-samples must be a power of two from 2 on, not {samples}")
    limits, spreads = limits_and_spreads(config.flat, joint.name)
    for option, (name, unit, *_) in _LIMITS.items():
        if given[option] is not None:
            limits[name] = given[option] * unit
            if not math.isfinite(limits[name]):
                raise options.Problem(f"the limit of {name} must be finite")
    return Question(
        joint.drive,
        np.array(given["torques"] or (joint.drive.rated_torque,), dtype=np.float64),
        limits,
        spreads,
        limit.largest_eccentricity(joint.drive) if largest is None else largest * _UM,
        given["samples"],
        samples,
        given["seed"],
        given["target"],
    )


def _show(joint: str, found: Study) -> None:
    console, question = Console(), found.question
    console.print(
        f"[bold]{joint}[/bold]: eccentricity up to {question.largest * 1e6:.3g} um, in all directions"
    )
    first = found.interference
    console.print(
        f"Interference of the lobe at tooth 0 begins at {_um(first.across)} across the long axis (the "
        f"paper's arrangement; {first.clearance * 1e6:.3f} um of backlash without eccentricity), at "
        f"{_um(first.any_direction.eccentricity)} in the worst direction; from "
        f"{_um(first.all_teeth.eccentricity)} on no rotation of the cup frees the teeth of both lobes."
    )
    for torque, row in zip(question.torque, found.limits, strict=True):
        console.print(_limit_table(found, float(torque), row))
    allowed = found.allowed
    least = f"Allowed: {allowed.eccentricity * 1e6:.2f} um, by {allowed.criterion}" if allowed else None
    console.print(least or "No limit is reached.")
    if found.assemblies is not None:
        _show_assemblies(console, found)
    if found.sensitivity is not None:
        console.print(_sensitivity_table(found))
    pitch, step = question.drive.mesh.geometry.slot_pitch, question.largest / limit.STEPS * 1e6
    angle, turn = limit.RESOLUTION
    console.print(
        f"Resolution: eccentricity in steps of {step:.2g} um (where a criterion jumps: "
        f"{step / limit.FINE_STEPS:.2g} um), then solved to {limit.ROOT_TOLERANCE * 1e6:.0e} um; angle from "
        f"the long axis {angle * 1e3:.2g} mrad, wave generator {turn * pitch * 1e6:.2g} urad."
    )


def _um(eccentricity: float) -> str:
    return f"{eccentricity * 1e6:.2f} um" if math.isfinite(eccentricity) else "no eccentricity looked at"


def _table(title: str, *columns: str) -> Table:
    """The first column to the left, numbers to the right; fits 80 columns."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for k, column in enumerate(columns):
        table.add_column(escape(column), justify="right" if k else "left", no_wrap=True)
    return table


def _limit_table(found: Study, torque: float, row: list[limit.EccentricityLimit]) -> Table:
    columns = ("limit", "without", "at\n[um]", "direction\n[rad]", "\n[deg]", "input\n[rad]")
    table = _table(f"Limits at {torque:g} N m", "criterion", *columns)
    for criterion, each in zip(CRITERIA, row, strict=True):
        values = (f"{value * criterion.scale:.4g}" for value in (each.limit, each.without))
        place: tuple[str, ...] = f"> {found.question.largest * 1e6:.4g}", "not reached"
        if each.reached:
            toward, worst = each.worst.direction, each.worst.wave_generator_angle
            angle = limit.input_angle(found.question.drive, worst)
            at = f"{each.eccentricity * 1e6:.3f}"
            place = at, f"{toward:.3f}", f"{math.degrees(toward):.1f}", f"{angle:.4f}"
        table.add_row(escape(f"{criterion.name} [{criterion.shown}]"), *values, *place)
    return table


def _show_assemblies(console: Console, found: Study) -> None:
    drawn, question = found.assemblies, found.question
    assert drawn is not None
    columns = ("all (95 %)", *(criterion.brief for criterion in CRITERIA))
    table = _table(f"Share of {question.samples} assemblies within the limits [%]", "to [um]", *columns)
    for k, value in enumerate(drawn.tolerances):
        t = drawn.together
        together = f"{100 * t.share[k]:.1f} ({100 * t.low[k]:.1f}-{100 * t.high[k]:.1f})"
        table.add_row(f"{value * 1e6:.2f}", together, *(f"{100 * s.share[k]:.1f}" for s in drawn.each))
    console.print(table)
    console.print(yielded(question, drawn))


def _sensitivity_table(found: Study) -> Table:
    assert found.sensitivity is not None
    first, total = found.sensitivity.first.value, found.sensitivity.total.value
    title = "What matters at the configured tolerances: total (first) Sobol index [%]"
    table = _table(title, "spread of", *(criterion.brief for criterion in CRITERIA))
    for i in np.argsort(-np.nan_to_num(total).mean(axis=0), kind="stable"):
        pairs = zip(total[:, i], first[:, i], strict=True)
        table.add_row(words(FACTORS[i]), *(f"{100 * t:.0f} ({100 * f:.0f})" for t, f in pairs))
    return table
