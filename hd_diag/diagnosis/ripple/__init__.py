"""Ripple of a torque over position: what a joint with one angle tells of its gear."""
