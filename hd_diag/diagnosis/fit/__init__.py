"""Fits: noise, the model's own parameters, the linearised fit, joint refinement."""
