"""``hd-diag figures``: the model's counterparts of the paper's figures, and a drawing of the drive."""

from __future__ import annotations

from pathlib import Path

import click

from hd_diag.cli.examples import load_example
from hd_diag.cli.options import CONFIG, configured, shown, verb, writing
from hd_diag.report.pictures.canvas import save
from hd_diag.report.pictures.eccentric_drive import drive_picture

_CAPTIONS = "figures.md"


@verb("figures --out figures --format png")
@click.option(
    "--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder for the files."
)
@CONFIG
@shown("--format", "svg", "Of the figures.", type=click.Choice(["svg", "png", "pdf"]))
def figures(out: Path, config_file: str | None, format: str) -> None:
    """Draw the model's counterparts of the paper's Figs. 5, 6 and 7.

    For the first configured joint: the neutral layer's motion, backlash and load over the teeth, one tooth
    over time, for eccentricities from none to 23 µm. figures.md gets captions with the numbers that the
    paper's claims come to. Beside them drive.*: what is eccentric to what, positive directions, where teeth
    interfere.
    """
    joint = configured(config_file).joints[0]
    entries = load_example("paper_figures").figures(joint.drive)
    captions = [f"Drive of {joint.name}; claims are those of Dong et al. (2019), sections 4.2, 4.3 and 5."]
    for name, title, figure, claims in entries:
        file, wrong = out / f"{name}.{format}", " **This does not agree.**"
        listed = "\n".join(f"* ({c.letter}) {c.text}{'' if c.holds else wrong}" for c in claims)
        with writing(file) as place:
            out.mkdir(parents=True, exist_ok=True)
            save(figure, place)
        captions.append(f"## {title}\n\n![{title}]({file.name})\n\n{listed}")
        click.echo(f"{file}: {title}\n{listed}")
    with writing(out / f"drive.{format}") as place:
        save(drive_picture(joint.drive), place)
    click.echo(f"{out / f'drive.{format}'}: what is eccentric to what, positive directions, interference")
    with writing(out / _CAPTIONS) as place:
        place.write_text("\n\n".join(captions) + "\n", encoding="utf-8")
    click.echo(f"{out / _CAPTIONS}: captions")
