"""The numbers of a joint's diagnostics as a row of columns and in words, and the curve of its residuals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from hd_diag.formatting import visible

_BARS, _PLAIN_BARS = "▁▂▃▄▅▆▇█", ".:-=+*#@"
_LARGEST_WIDTH = 15  # of a number in words
_LONGEST = 500  # of a shown text [characters]

# Key in the diagnostics; its column: heading, digits, width; the same in words.
_NUMBERS = (
    ("eccentricity_um", ("eccen-", "tricity", "µm"), 1, 7, "configured eccentricity {} µm"),
    ("eccentricity_direction_deg", ("at", "", "deg"), 0, 5, "at {} deg;"),
    ("minimum_backlash_um", ("least", "backl.", "µm"), 1, 7, "least backlash {} µm;"),
    ("lost_motion_arcmin", ("lost", "motion", "arcmin"), 2, 6, "lost motion {} arcmin;"),
    ("loaded_pairs", ("loaded", "pairs", ""), 0, 6, "{} tooth pairs loaded,"),
    ("peak_tooth_load_N", ("peak", "load", "N"), 1, 6, "the most with {} N;"),
    ("predicted_te_pp_arcsec", ("pred.", "error", "arcsec"), 1, 6, "predicted error {} arcsec peak to peak;"),
    ("residual_rms_arcsec", ("resid.", "rms", "arcsec"), 2, 6, "residual {} arcsec rms;"),
    ("sample_rate_hz", ("rate", "", "Hz"), 0, 6, "{} samples/s"),
)

NUMBERS_WIDTH = sum(width + 1 for _, _, _, width, _ in _NUMBERS)
"""Characters in a row of numbers."""


def heading() -> list[str]:
    """Three lines that stand above a row of numbers."""
    return ["".join(f" {lines[i]:>{width}}" for _, lines, _, width, _ in _NUMBERS) for i in range(3)]


def row(value: Callable[[str], float]) -> str:
    """The numbers in their columns; `value` gives each by its key."""
    cells = ((shown_number(value(key), digits, width), width) for key, _, digits, width, _ in _NUMBERS)
    return "".join(f" {text:>{width}}" for text, width in cells)


def sentence(value: Callable[[str], float]) -> str:
    """The same numbers in words."""
    return " ".join(words.format(shown_number(value(key), digits)) for key, _, digits, _, words in _NUMBERS)


def shown_number(value: float, digits: int, width: int = _LARGEST_WIDTH) -> str:
    """A number with as many of its digits as a width allows; a dash where it is not finite."""
    if not math.isfinite(value):
        return "-"
    texts = [f"{value:.{places}f}" for places in range(digits, -1, -1)] + [f"{value:.0e}".replace("e+", "e")]
    return next((text for text in texts if len(text) <= width), "*" * width)


def spark(values: Sequence[float], width: int, is_ascii: bool = False) -> str:
    """The last values as a row of bars from zero to the largest; those that are not finite leave a gap."""
    bars, shown = _PLAIN_BARS if is_ascii else _BARS, values[-width:]
    largest = max((abs(value) for value in shown if math.isfinite(value)), default=0.0) or 1.0
    heights = (abs(value) / largest * len(bars) if math.isfinite(value) else None for value in shown)
    return "".join(" " if h is None else bars[min(int(h), len(bars) - 1)] for h in heights)


def shown_text(text: str) -> str:
    """Text of others without control characters, cut where it is too long."""
    return visible(text[:_LONGEST])
