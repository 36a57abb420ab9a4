"""Pictures of the example drive, and the model's answers to the paper's claims: paper.md."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from parts import width

# The example drive's catalogue page: its geometry is drawn.
PAGE = "--size 25 --ratio 100 --rated-torque 56 --k1 3.1e4 --k2 5.0e4 --k3 5.7e4 --t1 14 --t2 48"


@contextmanager
def drawn() -> Iterator[Path]:
    """A folder with the pictures as the code draws them now, and the captions."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = ["--out", str(folder / "gear.yaml"), "--figure", str(folder / "tooth_pair.svg")]
        for words in (["figures", "--out", name], ["gear", *PAGE.split(), *made]):
            command = [sys.executable, "-m", "hd_diag", *words]
            subprocess.run(command, cwd=name, check=True, stdout=subprocess.DEVNULL)
        width.draw(folder)
        yield folder


def captions(folder: Path) -> str:
    """The captions of the figures, with their pictures where the pages have them."""
    return (
        (folder / "figures.md").read_text(encoding="utf-8").replace("](figure_", "](figures/figure_").strip()
    )
