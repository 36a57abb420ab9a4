"""Recognises reported torques that no sensor measured."""

from __future__ import annotations

_PLACEHOLDERS = (1.0, 99.0, 999.0, 9999.0, 32767.0, 32768.0, 65535.0, 99999.0)  # of either sign [N m]
_LEAST_TORQUE = 1e-6  # smaller ones were not measured [N m]: they bend no gear by an arcsec


def no_torque(least: float, most: float) -> str:
    """End of a sentence on a torque that was not measured, from its range [N m]; empty if it was measured.

    A driver without a sensor reports nan or zero, or one of `_PLACEHOLDERS` all the time. Another constant
    may be a known load.
    """
    if not least <= most:
        return "is not a number throughout"
    largest = max(abs(least), abs(most))
    if largest <= _LEAST_TORQUE:
        return "is zero throughout" if largest == 0.0 else f"is never beyond {largest:.3g} N m"
    return f"is {least:.6g} N m throughout" if least == most and largest in _PLACEHOLDERS else ""
