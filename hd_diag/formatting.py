"""Numbers as people read them: µm, arcsec, degrees, with as many digits as their spread allows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

ARCSEC = math.pi / 648_000.0
"""One second of arc [rad]."""

_DIGITS = 3  # of a number without a spread
_MOST_DECIMALS = 6

SCALES = {
    "m": (1e-6, "µm"),
    "rad": (ARCSEC, "arcsec"),
    "rad/(N m)": (ARCSEC, "arcsec/(N m)"),
    "rad/K": (ARCSEC, "arcsec/K"),
    "m/N": (1e-9, "nm/N"),
    "s": (1e-6, "µs"),
    "rad/s": (math.tau, "per second"),
    "N m": (1.0, "N m"),
    "-": (1.0, ""),
}
"""Size and name of the displayed unit, by the SI unit."""


def number(value: float, spread: float = math.nan, digits: int = _DIGITS) -> str:
    """A number, rounded to the first digit of its spread; to the second if the first is a 1.

    The spread is a standard deviation. If it is nan or zero, the number has `digits` significant digits. A
    value that is not finite is shown as a dash.
    """
    if not math.isfinite(value):
        return "–"
    if not (math.isfinite(spread) and spread > 0.0):
        spread = abs(value) and 2.0 * 10.0 ** (math.floor(math.log10(abs(value))) + 1 - digits)
    decimals = 0
    if spread > 0.0:
        exponent = math.floor(math.log10(spread))
        decimals = (1 if spread < 2.0 * 10.0**exponent else 0) - exponent
    return _signed(f"{value:.{min(max(decimals, 0), _MOST_DECIMALS)}f}")


def rounded(value: float, digits: int = _DIGITS) -> float:
    """A number with `digits` significant digits."""
    return float(f"{value:.{digits}g}")


def _signed(text: str) -> str:
    """A number's text with a true minus sign, and with none before a zero."""
    return text.removeprefix("-") if not text.strip("-0.") else text.replace("-", "−")


def spread_number(value: float, spread: float, unit: str) -> str:
    """A number with its standard deviation and unit."""
    if not (math.isfinite(spread) and spread > 0.0):
        return f"{number(value)} {unit}".strip()
    return f"{number(value, spread)} ± {number(spread, spread)} {unit}".strip()


def si(value: float, spread: float, unit: str) -> str:
    """An SI value and its standard deviation in the displayed unit."""
    scale, shown = SCALES.get(unit, (1.0, unit))
    return spread_number(value / scale, spread / scale, shown)


def size(value: float, unit: str) -> str:
    """An SI value without a standard deviation in the displayed unit."""
    return si(value, math.nan, unit)


def direction(value: float, spread: float, period: float) -> str:
    """A direction [rad] in degrees, with its period."""
    angle, turn, std = (math.degrees(each) for each in (value % period, period, spread))
    shown = 0.0 if number(angle, std) == number(turn, std) else angle  # 180.00 modulo 180 is 0
    text = spread_number(shown, std, "°").replace(" °", "°")
    return f"{text} (modulo {math.degrees(period):.0f}°)" if period < 6.28 else text


def arcsec(value: float) -> str:
    """An angle [rad] in arcsec, to a hundredth."""
    return f"{_signed(f'{value / ARCSEC:.2f}')} arcsec" if math.isfinite(value) else "–"


def percent(share: float, decimals: int = 1) -> str:
    """A share in percent; one below the whole is never rounded up to it: 99.9 % is not all."""
    step = 10.0**-decimals
    shown = 100.0 - step if 100.0 - 0.5 * step <= 100.0 * share < 100.0 else 100.0 * share
    return f"{_signed(f'{shown:.{decimals}f}')} %" if math.isfinite(share) else "–"


def percents(low: float, high: float) -> str:
    """An interval in percent."""
    return f"{percent(low).removesuffix(' %')} to {percent(high)}"


def words(name: str) -> str:
    """A machine name in words."""
    return name.replace("_", " ")


def listed(names: Sequence[str], most: int) -> str:
    """Names separated by commas, at most `most` of them, then the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def visible(text: str, longest: int | None = None) -> str:
    """Text with escapes for characters that do not print or that change the direction of others.

    Text from a file may be hostile; it is cut to the `longest` number of characters.
    """
    part = text if longest is None else text[: longest + 1]
    shown = part if part.isprintable() else "".join(map(_spelled, part))
    return shown if longest is None or len(shown) <= longest else f"{shown[: longest - 1]}…"


def _spelled(c: str) -> str:
    return c if c.isprintable() else c.encode("unicode_escape").decode("ascii")


def json_ready(value: Any) -> Any:
    """A value as JSON can hold it: numbers that are not finite as None, numpy's types as Python's.

    Mappings, lists and tuples of any depth, numpy arrays and scalars; anything else stays.
    """
    if isinstance(value, Mapping):
        return {key: json_ready(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [json_ready(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
