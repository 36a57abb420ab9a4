"""The one exception of a fleet run."""

from __future__ import annotations


class FleetError(RuntimeError):
    """A run that cannot begin or go on; the text says why in one line."""
