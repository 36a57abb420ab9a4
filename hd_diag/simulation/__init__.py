"""Simulated robot joints: what encoders and torque sensor report."""
