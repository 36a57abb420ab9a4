"""Simulated robot joints: what encoders and torque sensor report during a test motion, and bags of it."""

from hd_diag.simulation.bag import write_bag
from hd_diag.simulation.joint import START, Noise, Samples, SimulatedJoint, simulate
from hd_diag.simulation.motion import Motion

__all__ = ["START", "Motion", "Noise", "Samples", "SimulatedJoint", "simulate", "write_bag"]
