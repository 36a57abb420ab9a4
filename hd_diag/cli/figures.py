"""``hd-diag figures``: the model's counterparts of the paper's figures, and a drawing of the drive."""

from __future__ import annotations

from pathlib import Path

from hd_diag.cli.examples import load_example
from hd_diag.cli.joints import configured
from hd_diag.cli.lines import tell
from hd_diag.cli.options import check_files
from hd_diag.cli.targets import Problem, writing
from hd_diag.report.pictures.canvas import save

_CAPTIONS = "figures.md"


def figures(out: Path, config_file: str | None, format: str) -> None:
    """Do what ``hd-diag figures`` is asked for."""
    joint = configured(config_file).joints[0]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Problem(f"{out}: cannot be made: {error.strerror}") from error
    entries = load_example("paper_figures").figures(joint.drive)
    drawing = out / f"drive.{format}"
    check_files((*(out / f"{name}.{format}" for name, *_ in entries), drawing, out / _CAPTIONS))
    captions = [f"Drive of {joint.name}; claims are those of Dong et al. (2019), sections 4.2, 4.3 and 5."]
    for name, title, figure, claims in entries:
        file, wrong = out / f"{name}.{format}", " **This does not agree.**"
        listed = [f"* ({c.letter}) {c.text}{'' if c.holds else wrong}" for c in claims]
        with writing(file) as place:
            save(figure, place)
        captions.append("\n".join([f"## {title}\n\n![{title}]({file.name})\n", *listed]))
        for line in (f"{file}: {title}", *listed):
            tell(line)
    with writing(drawing) as place:
        save(load_example("eccentric_drive").drive_picture(joint.drive), place)
    tell(f"{drawing}: what is eccentric to what, positive directions, interference")
    with writing(out / _CAPTIONS) as place:
        place.write_text("\n\n".join(captions) + "\n", encoding="utf-8")
    tell(f"{out / _CAPTIONS}: captions")
