"""The sheet of every picture: its size, letters, and colours that a colour-blind reader can distinguish."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

WIDTH = 3.75
"""Width of every picture [inch]: that of a phone, so that letters keep their size there."""

_RESOLUTION = 200.0  # of PNG files [dots per inch]
_COLUMNS = 2  # of a legend: three do not fit a phone
_ROW = 12.5  # height of a legend's row [points]

INK = "#15181d"
"""Colour of letters, axes and measured values; a page may replace it by the colour of its own text."""

GRID = "#8a9099"

# Okabe and Ito's colours for all kinds of colour vision, darkened to 3:1 and more against white and black.
NOMINAL, REFIT, EXTENDED = "#d55e00", "#0072b2", "#00875f"
STAGES: tuple[tuple[str, Any], ...] = ((NOMINAL, (0, (2, 1.2))), (REFIT, (0, (6, 1.8))), (EXTENDED, "-"))
"""Colour and dashes of the model as configured, refitted and extended."""

ACCENT = "#a8508b"
SERIES = ("#0072b2", "#00875f", "#b07800", "#d55e00", "#a8508b", "#5a6b7b")
"""Colours of curves of one family, which also differ in their dashes."""

DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (2, 1.2)), (0, (6, 1.5, 1.5, 1.5)), (0, (1, 1)), "--")

STYLE: Any = {
    **dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize"), 8.5),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 8.0),
    **dict.fromkeys(("axes.edgecolor", "axes.labelcolor", "axes.titlecolor", "text.color"), INK),
    **dict.fromkeys(("xtick.color", "ytick.color"), INK),
    **dict.fromkeys(("figure.facecolor", "axes.facecolor", "savefig.facecolor"), "none"),
    "font.family": "DejaVu Sans",
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "legend.columnspacing": 1.2,
    "legend.borderaxespad": 0.0,
    "legend.borderpad": 0.0,
    "legend.labelspacing": 0.25,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.alpha": 0.35,
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "lines.linewidth": 1.3,
    # A name such as $\frac$ is letters, not mathematics.
    "text.parse_math": False,
    # Equal pictures give equal files: ids come from a fixed salt, letters stay letters.
    "svg.hashsalt": "hd_diag",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
    "path.simplify_threshold": 0.1,
}


@contextmanager
def styled() -> Iterator[None]:
    """Style of this package while a figure is drawn or written."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(STYLE)
        yield


drawn = styled()
"""Decorates a picture: it is drawn in this style whatever matplotlib is set to."""


def sheet(height: float, rows: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """An empty figure of a height [inch] with panels one above the other; options of `Figure.subplots`."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(rows, 1, squeeze=False, **options)
    return figure, list(axes[:, 0])


def titled(axes: Axes, title: str, raised: float = 0.0) -> None:
    """Put a title and a legend above the panel, where they cover nothing, `raised` by some points."""
    handles, labels = axes.get_legend_handles_labels()
    rows = -(-len(labels) // _COLUMNS)
    axes.set_title(title, pad=5.0 + raised + _ROW * rows)
    if rows:
        up = ScaledTranslation(0.0, (3.0 + raised) / 72.0, axes.figure.dpi_scale_trans)
        anchor = {"bbox_to_anchor": (0.0, 1.0), "bbox_transform": axes.transAxes + up}
        axes.legend(handles, labels, loc="lower left", ncols=_COLUMNS, **anchor)


def arrow(axes: Axes, start: complex, end: complex, colour: str, width: float, head: float) -> None:
    """A straight arrow from a point to another of the plane x + iy; width and head [points]."""
    style = {
        "arrowstyle": "-|>",
        "color": colour,
        "lw": width,
        "shrinkA": 0.0,
        "shrinkB": 0.0,
        "mutation_scale": head,
    }
    (x0, y0), (x1, y1) = ((complex(point).real, complex(point).imag) for point in (start, end))
    axes.annotate("", (x1, y1), (x0, y0), arrowprops=style)


def turn(axes: Axes, label: str) -> None:
    """An axis over one turn in degrees."""
    axes.set(xlim=(0.0, 360.0), xticks=range(0, 361, 60), xlabel=label)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as SVG, PDF or PNG, by the file's suffix; equal figures give equal files."""
    kind = path.suffix.removeprefix(".").lower()
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}[kind]
    with styled():
        figure.savefig(path, format=kind, dpi=_RESOLUTION, metadata=undated, facecolor="white")
