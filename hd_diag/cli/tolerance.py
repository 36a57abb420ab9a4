"""``hd-diag tolerance``: the eccentricity an assembly may have, and what a tolerance yields."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hd_diag.cli.options import (
    CONFIG,
    JOINT,
    JSON,
    Problem,
    check_target,
    chosen_joint,
    configured,
    verb,
    write_json,
)
from hd_diag.cli.progress import bar
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.formatting import ARCSEC
from hd_diag.model.threads import cores
from hd_diag.process_pool import ProcessPool
from hd_diag.tolerance.assembly import FACTORS, WITHIN
from hd_diag.tolerance.criteria import CRITERIA
from hd_diag.tolerance.document import document
from hd_diag.tolerance.limit import (
    FINE_STEPS,
    RESOLUTION,
    ROOT_TOLERANCE,
    STEPS,
    EccentricityLimit,
    input_angle,
    largest_eccentricity,
)
from hd_diag.tolerance.study import Question, Study, limits_and_spreads, study

_UM = 1e-6
_FIGURES = (".png", ".svg", ".pdf")
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


def _check_figure(context: click.Context, parameter: click.Parameter, path: Path | None) -> Path | None:
    """Refuse before the work what cannot be drawn after it."""
    if path is not None:
        if path.suffix.lower() not in _FIGURES:
            raise Problem(f"{path}: a figure ends with {', '.join(_FIGURES)}")
        check_target(path)
    return path


@verb("tolerance --config arm.yaml --joint elbow --te-arcsec 20")
@CONFIG
@JOINT
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
@click.option(
    "--samples",
    type=click.IntRange(0, 1_000_000),
    default=500,
    show_default=True,
    help="Assemblies to draw; 0 = none.",
)
@click.option(
    "--sensitivity-samples",
    type=click.IntRange(0, 1 << 20),
    default=128,
    show_default=True,
    help="For the Sobol indices, a power of two; 0 = none.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the random assemblies."
)
@click.option(
    "--target",
    type=_SHARE,
    default=0.95,
    show_default=True,
    help="Share of assemblies that shall be good [-].",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    help="Processes at a time. [default: one per core that is free to use]",
)
@JSON
@click.option(
    "--figure",
    "figure_file",
    type=click.Path(dir_okay=False, path_type=Path),
    callback=_check_figure,
    help="Draw the result: *.png, *.svg or *.pdf.",
)
def tolerance(
    config_file: str | None,
    joint: str | None,
    torques: tuple[float, ...],
    jobs: int | None,
    json_file: str | None,
    figure_file: Path | None,
    **options: Any,
) -> None:
    """Say what eccentricity an assembly may have.

    For every criterion the eccentricity that first exceeds its limit, over all directions and input angles;
    then assemblies drawn from the configured tolerances: the share within the limits against the tolerance of
    the eccentricity, and which tolerance matters. Limits and tolerances are in the configuration's section
    "tolerance"; an option takes a limit's place.
    """
    config = configured(config_file)
    chosen = chosen_joint(config, joint)
    try:
        question = _question(config, chosen, torques, options)
        with bar() as bars, ProcessPool(jobs or cores()) as pool:

            def part(what: str, steps: int) -> Callable[[], None]:
                return partial(bars.advance, bars.add_task(what, total=steps, rate=""))

            found = study(question, pool, part)
    except ValueError as error:
        raise Problem(f"{chosen.name}: {error}") from error
    if json_file:
        write_json(json_file, document(chosen.name, found))
    if figure_file:
        _draw(found, figure_file)
    if json_file != "-":
        _show(chosen.name, found)


def _question(
    config: Config, joint: JointConfig, torques: tuple[float, ...], options: dict[str, Any]
) -> Question:
    samples, largest = options["sensitivity_samples"], options["largest_um"]
    if samples & (samples - 1) or samples == 1:
        raise Problem(f"--sensitivity-samples must be a power of two from 2 on, not {samples}")
    limits, spreads = limits_and_spreads(config.flat, joint.name)
    for option, (name, unit, *_) in _LIMITS.items():
        if options[option] is not None:
            limits[name] = options[option] * unit
            if not math.isfinite(limits[name]):
                raise Problem(f"the limit of {name} must be finite")
    return Question(
        joint.drive,
        np.array(torques or (joint.drive.rated_torque,), dtype=np.float64),
        limits,
        spreads,
        largest_eccentricity(joint.drive) if largest is None else largest * _UM,
        options["samples"],
        samples,
        options["seed"],
        options["target"],
    )


def _draw(found: Study, path: Path) -> None:
    from hd_diag.report.pictures.tolerance import tolerance_picture  # here, because matplotlib takes its time

    try:
        tolerance_picture(found).savefig(path, dpi=200, facecolor="white", bbox_inches="tight")
    except OSError as error:
        raise Problem(f"{path}: cannot be written: {error.strerror}") from error


def _show(joint: str, found: Study) -> None:
    console = Console()
    question = found.question
    console.print(
        f"[bold]{joint}[/bold]: eccentricity up to {question.largest * 1e6:.3g} um, in all directions"
    )
    _show_interference(console, found)
    for torque, row in zip(question.torque, found.limits, strict=True):
        console.print(_limit_table(found, float(torque), row))
    allowed = found.allowed
    console.print(
        f"Allowed: {allowed.eccentricity * 1e6:.2f} um, by {allowed.criterion}"
        if allowed
        else "No limit is reached."
    )
    if found.assemblies is not None:
        _show_assemblies(console, found)
    if found.sensitivity is not None:
        console.print(_sensitivity_table(found))
    pitch = question.drive.mesh.geometry.slot_pitch
    console.print(
        f"Resolution: eccentricity in steps of {question.largest / STEPS * 1e6:.2g} um (where a "
        f"criterion jumps: {question.largest / STEPS / FINE_STEPS * 1e6:.2g} um), then solved to "
        f"{ROOT_TOLERANCE * 1e6:.0e} um; angle from the long axis {RESOLUTION[0] * 1e3:.2g} mrad, "
        f"wave generator {RESOLUTION[1] * pitch * 1e6:.2g} urad."
    )


def _show_interference(console: Console, found: Study) -> None:
    first = found.interference
    console.print(
        f"Interference of the lobe at tooth 0 begins at {_um(first.across)} across the long axis (the "
        f"paper's arrangement; {first.clearance * 1e6:.3f} um of backlash without eccentricity), at "
        f"{_um(first.any_direction.eccentricity)} in the worst direction; from "
        f"{_um(first.all_teeth.eccentricity)} on no rotation of the cup frees the teeth of both lobes."
    )


def _um(eccentricity: float) -> str:
    return f"{eccentricity * 1e6:.2f} um" if math.isfinite(eccentricity) else "no eccentricity looked at"


def _table(title: str, *columns: str) -> Table:
    """The first column to the left, numbers to the right; fits 80 columns."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for k, column in enumerate(columns):
        table.add_column(escape(column), justify="right" if k else "left", no_wrap=True)
    return table


def _limit_table(found: Study, torque: float, row: list[EccentricityLimit]) -> Table:
    columns = ("limit", "without", "at\n[um]", "direction\n[rad]", "\n[deg]", "input\n[rad]")
    table = _table(f"Limits at {torque:g} N m", "criterion", *columns)
    for criterion, limit in zip(CRITERIA, row, strict=True):
        values = (f"{value * criterion.scale:.4g}" for value in (limit.limit, limit.without))
        table.add_row(escape(f"{criterion.name} [{criterion.shown}]"), *values, *_place(found, limit))
    return table


def _place(found: Study, limit: EccentricityLimit) -> tuple[str, ...]:
    if not limit.reached:
        return f"> {found.question.largest * 1e6:.4g}", "not reached", "", ""
    worst = limit.worst
    angle = input_angle(found.question.drive, worst.wave_generator_angle)
    direction = f"{worst.direction:.3f}", f"{math.degrees(worst.direction):.1f}"
    return f"{limit.eccentricity * 1e6:.3f}", *direction, f"{angle:.4f}"


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
    share = f"{100 * question.target:g} % of the assemblies are"
    console.print(
        f"{share} within all limits up to a tolerance of {drawn.at_target * 1e6:.2f} um "
        f"({100 * WITHIN:g} % of eccentricities are within it; {drawn.configured * 1e6:.2f} um configured)."
        if math.isfinite(drawn.at_target)
        else f"{share} not within all limits even without eccentricity."
    )


def _sensitivity_table(found: Study) -> Table:
    assert found.sensitivity is not None
    first, total = found.sensitivity.first.value, found.sensitivity.total.value
    title = "What matters at the configured tolerances: total (first) Sobol index [%]"
    table = _table(title, "spread of", *(criterion.brief for criterion in CRITERIA))
    for i in np.argsort(-np.nan_to_num(total).mean(axis=0), kind="stable"):
        pairs = zip(total[:, i], first[:, i], strict=True)
        table.add_row(FACTORS[i].replace("_", " "), *(f"{100 * t:.0f} ({100 * f:.0f})" for t, f in pairs))
    return table
