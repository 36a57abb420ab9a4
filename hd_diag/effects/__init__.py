"""Physical causes of transmission error that the model leaves out: one file and one line here for each."""

from __future__ import annotations

from importlib import import_module

from hd_diag.effects.effect import Effect

Catalogue = tuple[Effect, ...]

_NAMES = (
    "output_runout",
    "output_encoder_eccentricity",
    "circular_spline_form",
    "coupling_misalignment",
    "bearing_passage",
    "circular_spline_pitch",
    "flexspline_pitch",
    "tooth_damage",
    "wear_backlash",
    "torsional_hardening",
    "hysteresis",
    "coulomb_windup",
    "viscous_windup",
    "input_encoder_eccentricity",
    "encoder_interpolation",
    "output_encoder_interpolation",
    "stream_delay",
    "thermal_drift",
    "ratio_error",
    "tooth_skip",
    "resonance",
    "torque_offset",
    "torque_gain",
    "torque_sensor_ripple",
    "motor_current",
)

CATALOGUE: Catalogue = tuple(import_module(f"{__name__}.{name}").EFFECT for name in _NAMES)
