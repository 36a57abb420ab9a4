"""The numbers of a joint's diagnostics that are shown, their columns, and the curve of its residuals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hd_diag.formatting import visible

_BARS = "▁▂▃▄▅▆▇█"
_PLAIN_BARS = ".:-=+*#@"  # where the terminal has no others
_LARGEST_WIDTH = 15  # of a number in a plain line
_LONGEST = 500  # of a text that is shown [characters]


class _Number(NamedTuple):
    """A number: key in the diagnostics, heading of three lines, digits, width of its column."""

    key: str
    heading: tuple[str, str, str]
    digits: int
    width: int


_NUMBERS = (
    _Number("eccentricity_um", ("eccen-", "tricity", "µm"), 1, 7),
    _Number("eccentricity_direction_deg", ("at", "", "deg"), 0, 5),
    _Number("minimum_backlash_um", ("least", "backl.", "µm"), 1, 7),
    _Number("lost_motion_arcmin", ("lost", "motion", "arcmin"), 2, 6),
    _Number("loaded_pairs", ("loaded", "pairs", ""), 0, 6),
    _Number("peak_tooth_load_N", ("peak", "load", "N"), 1, 6),
    _Number("predicted_te_pp_arcsec", ("pred.", "error", "arcsec"), 1, 6),
    _Number("residual_rms_arcsec", ("resid.", "rms", "arcsec"), 2, 6),
    _Number("sample_rate_hz", ("rate", "", "Hz"), 0, 6),
)

_SENTENCE = (
    "configured eccentricity {} µm at {} deg; least backlash {} µm; lost motion {} arcmin; {} tooth pairs "
    "loaded, the most with {} N; predicted error {} arcsec peak to peak; residual {} arcsec rms; {} samples/s"
)

NUMBERS_WIDTH = sum(number.width + 1 for number in _NUMBERS)
"""Characters that a row of numbers takes."""


def heading() -> list[str]:
    """Three lines that stand above a row of numbers."""
    return ["".join(f" {number.heading[line]:>{number.width}}" for number in _NUMBERS) for line in range(3)]


def row(value: Callable[[str], float]) -> str:
    """The numbers in their columns; `value` gives each by its key."""
    return "".join(f" {shown_number(value(n.key), n.digits, n.width):>{n.width}}" for n in _NUMBERS)


def sentence(value: Callable[[str], float]) -> str:
    """The same numbers in words."""
    return _SENTENCE.format(*(shown_number(value(number.key), number.digits) for number in _NUMBERS))


def shown_number(value: float, digits: int, width: int = _LARGEST_WIDTH) -> str:
    """A number with as many of its digits as a width allows; a dash where it is not finite."""
    if not math.isfinite(value):
        return "-"
    for places in range(digits, -1, -1):
        if len(text := f"{value:.{places}f}") <= width:
            return text
    text = f"{value:.0e}".replace("e+", "e")
    return text if len(text) <= width else "*" * width


def spark(values: Sequence[float], width: int, is_ascii: bool = False) -> str:
    """The last values as a row of bars from zero to the largest; those that are not finite leave a gap."""
    bars = _PLAIN_BARS if is_ascii else _BARS
    sizes = [abs(value) if math.isfinite(value) else None for value in values[-width:]]
    largest = max((size for size in sizes if size is not None), default=0.0) or 1.0
    last = len(bars) - 1
    return "".join(" " if s is None else bars[min(int(len(bars) * (s / largest)), last)] for s in sizes)


def shown_text(text: str) -> str:
    """Text of others, without anything that a terminal obeys, and not without end."""
    return visible(text[:_LONGEST])
