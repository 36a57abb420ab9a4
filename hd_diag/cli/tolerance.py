"""``hd-diag tolerance``: the eccentricity an assembly may have, and what a tolerance yields."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
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
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.formatting import json_ready
from hd_diag.model.threads import cores
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.process_pool import ProcessPool
from hd_diag.tolerance.assembly import ANGLES, FACTORS, WITHIN
from hd_diag.tolerance.criteria import CRITERIA
from hd_diag.tolerance.limit import (
    FINE_STEPS,
    RESOLUTION,
    ROOT_TOLERANCE,
    STEPS,
    Limit,
    input_angle,
    largest_eccentricity,
)
from hd_diag.tolerance.settings import settings
from hd_diag.tolerance.study import Progress as Steps
from hd_diag.tolerance.study import Question, Study, study

_UM = 1e-6
_FIGURES = (".png", ".svg", ".pdf")
# Options that take the place of configured limits: criterion and size of the option's unit.
_LIMITS = {
    "interference_um": ("interference", _UM),
    "overlap_um": ("overlap", _UM),
    "peak_load": ("peak_tooth_load", 1.0),
    "load_concentration": ("load_concentration", 1.0),
    "stiffness_loss": ("stiffness_loss", 1.0),
    "te_arcsec": ("transmission_error", ARCSEC),
}
_SHARE = click.FloatRange(0.0, 1.0)


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
@click.option("--interference-um", type=float, help="Limit on the overlap of teeth at one lobe [um].")
@click.option("--overlap-um", type=float, help="Limit on the overlap of both lobes, no torque [um].")
@click.option("--peak-load", type=click.FloatRange(0.0), help="Limit on the force on a flank [N].")
@click.option(
    "--load-concentration", type=click.FloatRange(1.0), help="Limit on largest over mean force [-]."
)
@click.option("--stiffness-loss", type=_SHARE, help="Limit on the share of torsional stiffness lost [-].")
@click.option("--te-arcsec", type=click.FloatRange(0.0), help="Limit on the error, peak to peak [arcsec].")
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
    _check_figure(figure_file)
    config = configured(config_file)
    chosen = chosen_joint(config, joint)
    try:
        question = _question(config, chosen, torques, options)
        with _bars() as progress, ProcessPool(jobs or cores()) as pool:
            found = study(question, pool, progress)
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
    given, drive = settings(config.flat, joint.name), joint.drive
    samples = options["sensitivity_samples"]
    if samples & (samples - 1) or samples == 1:
        raise Problem(f"--sensitivity-samples must be a power of two from 2 on, not {samples}")
    own = {
        name: options[option] * unit
        for option, (name, unit) in _LIMITS.items()
        if options[option] is not None
    }
    for name, limit in own.items():
        if not math.isfinite(limit):
            raise Problem(f"the limit of {name} must be finite")
    largest = options["largest_um"]
    return Question(
        drive,
        np.array(torques or (drive.rated_torque,), dtype=np.float64),
        {**given.limits, **own},
        given.spreads,
        largest_eccentricity(drive) if largest is None else largest * _UM,
        options["samples"],
        samples,
        options["seed"],
        options["target"],
    )


def _check_figure(path: Path | None) -> None:
    """Refuse before the work what cannot be drawn after it."""
    if path is None:
        return
    if path.suffix.lower() not in _FIGURES:
        raise Problem(f"{path}: a figure ends with {', '.join(_FIGURES)}")
    check_target(path)


@contextlib.contextmanager
def _bars() -> Iterator[Steps]:
    """A bar for each part of the work, on a terminal."""
    console = Console(stderr=True, quiet=not sys.stderr.isatty())
    bar = Progress(console=console, transient=True, disable=not console.is_terminal)

    def begin(what: str, steps: int) -> Callable[[], None]:
        task = bar.add_task(what, total=steps)
        return lambda: bar.advance(task)

    # Older releases of rich print an empty line at the end of a bar that never showed.
    with bar if console.is_terminal else contextlib.nullcontext():
        yield begin


def document(joint: str, found: Study) -> dict[str, Any]:
    """What `hd-diag tolerance --json` writes.

    Parameters
    ----------
    joint : str
    found : Study

    Returns
    -------
    dict
        Schema ``hd_diag/tolerance/1``; SI units; null where a limit is not reached.
    """
    question = found.question
    allowed = found.allowed
    content = {
        "schema": "hd_diag/tolerance/1",
        "joint": joint,
        "torques": question.torque.tolist(),
        "largest_eccentricity": question.largest,
        "resolution": {
            "eccentricity_step": question.largest / STEPS,
            "eccentricity_step_of_jumps": question.largest / STEPS / FINE_STEPS,
            "eccentricity_root": ROOT_TOLERANCE,
            "angle_from_long_axis": RESOLUTION[0],
            "wave_generator_angle": RESOLUTION[1] * question.drive.mesh.geometry.slot_pitch,
        },
        "interference": _interference(found),
        "limits": [
            {"torque": torque, "criteria": {limit.criterion: _limit(found, limit) for limit in row}}
            for torque, row in zip(question.torque.tolist(), found.limits, strict=True)
        ],
        "allowed": allowed and {"eccentricity": allowed.eccentricity, "criterion": allowed.criterion},
        "assemblies": _assemblies(found),
        "sensitivity": _sensitivity(found),
        "units": {
            "eccentricity": "m",
            "direction": "rad, in the housing",
            "angle": "rad",
            "torque": "N m",
            **{criterion.name: criterion.unit for criterion in CRITERIA},
        },
    }
    return dict(json_ready(content))


def _interference(found: Study) -> dict[str, Any]:
    first = found.interference
    return {
        "across_long_axis": {"eccentricity": first.across, "clearance": first.clearance},
        "any_direction": _limit(found, first.any_direction),
        "all_teeth": _limit(found, first.all_teeth),
    }


def _limit(found: Study, limit: Limit) -> dict[str, Any]:
    worst, scanned = limit.worst, limit.scanned
    return {
        "limit": limit.limit,
        "reached": limit.reached,
        "eccentricity": limit.eccentricity,
        "value_without": limit.without,
        "worst": {
            "value": worst.value,
            "direction": worst.direction,
            "direction_deg": math.degrees(worst.direction),
            "wave_generator_angle": worst.wave_generator_angle,
            "input_angle": input_angle(found.question.drive, worst.wave_generator_angle),
        },
        "curve": {"eccentricity": scanned[0].tolist(), "value": scanned[1].tolist()},
    }


def _assemblies(found: Study) -> dict[str, Any] | None:
    if found.assemblies is None:
        return None
    drawn = found.assemblies
    shares = {"all": drawn.together} | dict(zip((c.name for c in CRITERIA), drawn.each, strict=True))
    return {
        "samples": found.question.samples,
        "seed": found.question.seed,
        "angles_per_turn": ANGLES,
        "tolerances": drawn.tolerances.tolist(),
        "configured_tolerance": drawn.configured,
        "target": found.question.target,
        "tolerance_at_target": drawn.at_target,
        "yield": {
            name: {"share": s.share.tolist(), "low": s.low.tolist(), "high": s.high.tolist()}
            for name, s in shares.items()
        },
        "spreads": {
            name: {"distribution": spread.distribution, "size": spread.size}
            for name, spread in found.question.spreads.items()
        },
    }


def _sensitivity(found: Study) -> dict[str, Any] | None:
    s = found.sensitivity
    if s is None:
        return None
    orders = {"first": (s.first, s.first_low, s.first_high), "total": (s.total, s.total_low, s.total_high)}
    return {
        "samples": found.question.sensitivity_samples,
        "criteria": {
            criterion.name: {
                factor: {
                    order: dict(zip(("value", "low", "high"), (a[k, i] for a in arrays), strict=True))
                    for order, arrays in orders.items()
                }
                for i, factor in enumerate(FACTORS)
            }
            for k, criterion in enumerate(CRITERIA)
        },
    }


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


def _limit_table(found: Study, torque: float, row: list[Limit]) -> Table:
    columns = ("limit", "without", "at\n[um]", "direction\n[rad]", "\n[deg]", "input\n[rad]")
    table = _table(f"Limits at {torque:g} N m", "criterion", *columns)
    for criterion, limit in zip(CRITERIA, row, strict=True):
        values = (f"{value * criterion.scale:.4g}" for value in (limit.limit, limit.without))
        table.add_row(escape(f"{criterion.name} [{criterion.shown}]"), *values, *_place(found, limit))
    return table


def _place(found: Study, limit: Limit) -> tuple[str, ...]:
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
    s = found.sensitivity
    assert s is not None
    title = "What matters at the configured tolerances: total (first) Sobol index [%]"
    table = _table(title, "spread of", *(criterion.brief for criterion in CRITERIA))
    for i in np.argsort(-np.where(np.isfinite(s.total), s.total, 0.0).mean(axis=0), kind="stable"):
        pairs = zip(s.total[:, i], s.first[:, i], strict=True)
        table.add_row(FACTORS[i].replace("_", " "), *(f"{100 * t:.0f} ({100 * f:.0f})" for t, f in pairs))
    return table
