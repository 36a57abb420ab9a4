"""``hd-diag figures``: the model's counterparts of the paper's Figs. 5, 6 and 7, with captions."""

from __future__ import annotations

from pathlib import Path

import click

from hd_diag.cli.options import CONFIG, Problem, configured, verb
from hd_diag.report.paper_figures import Claim, neutral_layer, teeth_at_once, tooth_over_time
from hd_diag.report.pictures.canvas import save
from hd_diag.report.pictures.paper import figure_5, figure_6, figure_7

_CAPTIONS = "figures.md"
_TITLES = {
    "figure_5": "Motion of the neutral layer (as Fig. 5)",
    "figure_6": "Backlash and load of all teeth at one moment (as Fig. 6)",
    "figure_7": "One tooth over time (as Fig. 7)",
}


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
    layer, teeth, tooth = neutral_layer(joint.drive), teeth_at_once(joint.drive), tooth_over_time(joint.drive)
    drawings = figure_5(layer), figure_6(teeth), figure_7(tooth)
    lists = [_listed(claims) for claims in (layer.claims, teeth.claims, tooth.claims)]
    captions = [f"Drive of {joint.name}; claims are those of Dong et al. (2019), sections 4.2, 4.3 and 5."]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for (name, title), drawing, claims in zip(_TITLES.items(), drawings, lists, strict=True):
            save(drawing, out / f"{name}.{kind}")
            captions.append(f"## {title}\n\n![{title}]({name}.{kind})\n\n{claims}")
        (out / _CAPTIONS).write_text("\n\n".join(captions) + "\n", encoding="utf-8")
    except OSError as error:
        raise Problem(f"{error.filename}: cannot be written: {error.strerror}") from error
    for (name, title), claims in zip(_TITLES.items(), lists, strict=True):
        click.echo(f"{out / f'{name}.{kind}'}: {title}\n{claims}")
    click.echo(f"{out / _CAPTIONS}: captions")


def _listed(claims: tuple[Claim, ...]) -> str:
    return "\n".join(
        f"* ({c.letter}) {c.text}{'' if c.holds else ' **This does not agree.**'}" for c in claims
    )
