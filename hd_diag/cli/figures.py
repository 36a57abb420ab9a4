"""``hd-diag figures``: the model's counterparts of the paper's Figs. 5, 6 and 7, with captions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hd_diag.cli.options import CONFIG, Problem, configured, verb

if TYPE_CHECKING:  # slow to import: only where figures are drawn
    from matplotlib.figure import Figure

    from hd_diag.drive import Drive
    from hd_diag.report.paper_figures import Claim

_RESOLUTION = 200.0  # of PNG files [dots per inch]
_CAPTIONS = "figures.md"


@verb("figures --out figures --format png")
@click.option(
    "--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder for the files."
)
@CONFIG
@click.option(
    "--format",
    "kind",
    type=click.Choice(["svg", "png", "pdf"]),
    default="svg",
    show_default=True,
    help="Of the figures.",
)
def figures(out: Path, config_file: str | None, kind: str) -> None:
    """Draw the model's counterparts of the paper's Figs. 5, 6 and 7.

    For the first configured joint: the neutral layer's motion, backlash and load over the teeth, one tooth
    over time, for eccentricities from none to 23 µm. figures.md gets captions with the numbers that the
    paper's claims come to.
    """
    joint = configured(config_file).joints[0]
    entries = _drawn(joint.drive)
    captions = [f"Drive of {joint.name}; claims are those of Dong et al. (2019), sections 4.2, 4.3 and 5."]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, title, figure, claims in entries:
            _save(figure, out / f"{name}.{kind}", kind)
            captions.append(f"## {title}\n\n![{title}]({name}.{kind})\n\n{_told(claims)}")
        (out / _CAPTIONS).write_text("\n\n".join(captions) + "\n", encoding="utf-8")
    except OSError as error:
        raise Problem(f"{error.filename}: cannot be written: {error.strerror}") from error
    for name, title, _, claims in entries:
        click.echo(f"{out / f'{name}.{kind}'}: {title}\n{_told(claims)}")
    click.echo(f"{out / _CAPTIONS}: captions")


def _drawn(drive: Drive) -> list[tuple[str, str, Figure, tuple[Claim, ...]]]:
    """File name, title, figure and claims of each."""
    from hd_diag.report.paper_figures import neutral_layer, teeth_at_once, tooth_over_time
    from hd_diag.report.pictures.paper_figure_5 import paper_figure_5
    from hd_diag.report.pictures.paper_figure_6 import paper_figure_6
    from hd_diag.report.pictures.paper_figure_7 import paper_figure_7

    layer, teeth, tooth = neutral_layer(drive), teeth_at_once(drive), tooth_over_time(drive)
    fifth = paper_figure_5(
        layer.stations,
        layer.from_long_axis,
        layer.displacement,
        layer.direction,
        layer.change,
        layer.eccentricity,
    )
    sixth = paper_figure_6(teeth.eccentricity, teeth.tooth, teeth.backlash, teeth.load, teeth.torque)
    near = (tooth.near_backlash, tooth.near_load)
    seventh = paper_figure_7(tooth.eccentricity, tooth.angle, tooth.backlash, tooth.load, near, tooth.torque)
    return [
        ("figure_5", "Motion of the neutral layer (as Fig. 5)", fifth, layer.claims),
        ("figure_6", "Backlash and load of all teeth at one moment (as Fig. 6)", sixth, teeth.claims),
        ("figure_7", "One tooth over time (as Fig. 7)", seventh, tooth.claims),
    ]


def _told(claims: tuple[Claim, ...]) -> str:
    """Claims as a list."""
    return "\n".join(
        f"* ({c.letter}) {c.text}{'' if c.holds else ' **This does not agree.**'}" for c in claims
    )


def _save(figure: Figure, path: Path, kind: str) -> None:
    """The same figure is the same file: no date in it."""
    from hd_diag.report.pictures.canvas import styled

    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}[kind]
    with styled():
        figure.savefig(path, format=kind, dpi=_RESOLUTION, metadata=undated, facecolor="white")
