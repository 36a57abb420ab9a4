"""Simulated robot joints: readings of encoders and torque sensor during a test motion, and bags of them."""

from hd_diag.simulation.bag import write_bag
from hd_diag.simulation.joint import START, Noise, Samples, SimulatedJoint, simulate
from hd_diag.simulation.motion import Motion

__all__ = ["START", "Motion", "Noise", "Samples", "SimulatedJoint", "simulate", "write_bag"]
