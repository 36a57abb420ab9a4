"""Physical causes of transmission error that the model leaves out: one file and one line here for each."""

from __future__ import annotations

from hd_diag.effects import (
    bearing_passage,
    circular_spline_form,
    circular_spline_pitch,
    coulomb_windup,
    coupling_misalignment,
    encoder_interpolation,
    flexspline_pitch,
    hysteresis,
    input_encoder_eccentricity,
    motor_current,
    output_encoder_eccentricity,
    output_encoder_interpolation,
    output_runout,
    ratio_error,
    resonance,
    stream_delay,
    thermal_drift,
    tooth_damage,
    tooth_skip,
    torque_gain,
    torque_offset,
    torque_sensor_ripple,
    torsional_hardening,
    viscous_windup,
    wear_backlash,
)
from hd_diag.effects.effect import Effect

Catalogue = tuple[Effect, ...]

CATALOGUE: Catalogue = (
    output_runout.EFFECT,
    output_encoder_eccentricity.EFFECT,
    circular_spline_form.EFFECT,
    coupling_misalignment.EFFECT,
    bearing_passage.EFFECT,
    circular_spline_pitch.EFFECT,
    flexspline_pitch.EFFECT,
    tooth_damage.EFFECT,
    wear_backlash.EFFECT,
    torsional_hardening.EFFECT,
    hysteresis.EFFECT,
    coulomb_windup.EFFECT,
    viscous_windup.EFFECT,
    input_encoder_eccentricity.EFFECT,
    encoder_interpolation.EFFECT,
    output_encoder_interpolation.EFFECT,
    stream_delay.EFFECT,
    thermal_drift.EFFECT,
    ratio_error.EFFECT,
    tooth_skip.EFFECT,
    resonance.EFFECT,
    torque_offset.EFFECT,
    torque_gain.EFFECT,
    torque_sensor_ripple.EFFECT,
    motor_current.EFFECT,
)
