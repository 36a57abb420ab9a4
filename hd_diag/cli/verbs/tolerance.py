"""What ``hd-diag tolerance`` takes, and its help."""

from __future__ import annotations

from collections.abc import Callable

import click

from hd_diag.cli import options

_SHARE = click.FloatRange(0.0, 1.0)
_LIMITS = {
    "interference_um": (click.FLOAT, "the overlap of teeth at one lobe [µm]"),
    "overlap_um": (click.FLOAT, "the overlap of both lobes, no torque [µm]"),
    "peak_load": (click.FloatRange(0.0), "the force on a flank [N]"),
    "load_concentration": (click.FloatRange(1.0), "largest over mean force [-]"),
    "stiffness_loss": (_SHARE, "the share of torsional stiffness lost [-]"),
    "te_arcsec": (click.FloatRange(0.0), "the error, peak to peak [arcsec]"),
}


def _limit_options(function: Callable[..., None]) -> Callable[..., None]:
    for name, (kind, what) in reversed(_LIMITS.items()):
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
    "--largest-um", type=float, help="Look for limits up to here [µm]. [default: a fifth of the module]"
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
def tolerance() -> None:
    """Compute how much eccentricity an assembly may have.

    For every criterion: the smallest eccentricity that exceeds its limit, over all directions and input
    angles. Then random assemblies are drawn from the configured tolerances: the share of good ones over the
    tolerance of the eccentricity, and which tolerance matters most. Limits and tolerances are in the section
    "tolerance" of the configuration; an option replaces a limit.
    """
