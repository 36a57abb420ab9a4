"""Harmonic drives in robot joints: mesh model, live diagnostics and criticism of the model by data."""

__version__ = "0.1.0"
