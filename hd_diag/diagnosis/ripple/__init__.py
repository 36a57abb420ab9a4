"""Ripple of a torque over position: analysis of the gear in a joint with one angle."""
