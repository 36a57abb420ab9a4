"""Verdict on one joint since the last report: fault codes, limits, and the numbers behind them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.drive import MeshState, mesh_state, transmission_error
from hd_diag.extended_model import Range
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.monitor.joint import Joint, Window
from hd_diag.monitor.publications import Status

FAULT_CODES = (
    "LOG_FAILED",
    "STALE",
    "INPUT_INVALID",
    "OUT_OF_RANGE",
    "INTERFERENCE",
    "LOAD_CONCENTRATION",
    "RESIDUAL",
    "OK",
)
"""Fault codes; of several at the same level the first is reported."""

_ARCMIN = 60.0 * ARCSEC
# Angles over one turn of the wave generator from which the peak-to-peak error is taken: enough for the low
# orders that an eccentricity causes, and coprime with the tooth numbers so that the ripple is met as well.
_ANGLES_OF_TURN = 257
_ANGLES_WITHOUT_MAP = 61
_RARE = 0.05  # share of the samples that may lie outside a model's range on either side
_MARGIN = 0.05  # of a range, by which it may be left: what was fitted does not end at once
_KELVIN = 2.0  # the same, of a temperature [K]

Fault = tuple[str, int, str]


def report(joint: Joint, silence: float, facts: Mapping[str, str], foreign: int) -> Status:
    """Status of a joint.

    Parameters
    ----------
    joint : Joint
        With what happened since the last report in its `window`.
    silence : float
        Time since its last input [s].
    facts : mapping
        ``log_state`` and ``latency_p99_us`` as the surroundings know them.
    foreign : int
        Messages that named none of the configured joints.

    Returns
    -------
    Status
        With the fault code of the worst finding, and numbers in the units that their keys name.
    """
    window = joint.window
    residual = float(np.std(window.residual)) if window.residual.size > 1 else math.nan
    mean = float(np.mean(window.residual)) if window.residual.size else math.nan
    state, turn = _mesh(joint)
    order, amplitude = _largest_order(joint)
    faults = _faults(joint, window, facts, silence, residual, state)
    faults += _model_faults(joint, window, order, amplitude)
    faults = [fault for fault in faults if fault[1]]
    faults.append(("OK", 0, "OK"))
    code, level, message = max(faults, key=lambda fault: (fault[1], -FAULT_CODES.index(fault[0])))
    values = {
        "fault_code": code,
        "fault_codes": " ".join(dict.fromkeys(fault[0] for fault in faults[:-1])) or "OK",
        **_configuration_values(joint),
        **_model_values(joint),
        **_mesh_values(state, turn),
        "residual_rms_arcsec": _number(residual / ARCSEC),
        "residual_mean_arcsec": _number(mean / ARCSEC),
        "residual_order": order,
        "residual_order_amplitude_arcsec": _number(amplitude / ARCSEC),
        "sample_rate_hz": _number(_rate(window)),
        "samples": str(joint.samples),
        "samples_rejected": str(joint.rejected),
        "last_rejection": joint.last_rejection,
        "samples_missed": str(joint.lost.count),
        "outputs_unpaired": str(joint.unpaired),
        "clock_jumps": str(joint.clock_jumps),
        "messages_without_joint": str(foreign),
        "silence_s": _number(silence),
        "latency_p99_us": facts.get("latency_p99_us", "nan"),
        "log_state": facts.get("log_state", "off"),
    }
    return Status(joint.config.name, level, message, values)


def _faults(
    joint: Joint,
    window: Window,
    facts: Mapping[str, str],
    silence: float,
    residual: float,
    state: MeshState | None,
) -> list[Fault]:
    limits = joint.config.limits
    seen = window.accepted + window.rejected
    share = window.rejected / seen if seen else 0.0
    torque = abs(joint.last[1]) / joint.config.drive.rated_torque if joint.last else 0.0
    found: list[Fault] = []
    if facts.get("log_state", "").startswith("failed"):
        found.append(("LOG_FAILED", 1, f"log {facts['log_state']}"))
    found.append(("STALE", limits["silence"].level(silence), f"no valid sample for {silence:.1f} s"))
    found.append(
        (
            "INPUT_INVALID",
            limits["rejected"].level(share),
            f"{window.rejected} rejected: {joint.last_rejection}",
        )
    )
    found.append(
        ("OUT_OF_RANGE", limits["torque"].level(torque), f"torque is {torque:.2f} times the rated torque")
    )
    if state is not None:
        found += _mesh_faults(joint, state)
    found.append(
        ("RESIDUAL", limits["residual_rms"].level(residual), f"residual {residual / ARCSEC:.1f} arcsec rms")
    )
    return found


def _largest_order(joint: Joint) -> tuple[str, float]:
    """The residual's largest followed order, such as ``input 2``, and its amplitude [rad]."""
    found = joint.orders.amplitudes()
    if not found:
        return "", float("nan")
    frame, order = max(found, key=lambda name: found[name])
    return f"{frame} {order}", found[frame, order]


def _model_faults(joint: Joint, window: Window, order: str, amplitude: float) -> list[Fault]:
    """What an extended model adds: its valid range, and orders that have grown since it was fitted."""
    model = joint.config.model
    if model is None:
        return []
    ranges = model.ranges
    found: list[Fault] = [
        ("OUT_OF_RANGE", 1, f"outside the model's valid range: {text}")
        for text in (
            _outside("torque", window.torque, ranges.torque, _margin(ranges.torque), "N m"),
            _outside("speed", window.speed, ranges.speed, _margin(ranges.speed), "rad/s"),
            _temperature_outside(joint, ranges.temperature, "temperature" in model.needs),
        )
        if text
    ]
    level = joint.config.limits["residual_order"].level(amplitude)
    text = f"order {order} of the residual has grown to {amplitude / ARCSEC:.1f} arcsec"
    return [*found, ("RESIDUAL", level, text)]


def _margin(limits: Range) -> float:
    return _MARGIN * max(limits.high - limits.low, abs(limits.low), abs(limits.high))


def _outside(name: str, values: Floats, limits: Range, margin: float, unit: str) -> str:
    """How a quantity left its range since the last report; single samples are noise. Empty if it did not."""
    values = values[np.isfinite(values)]
    if not values.size:
        return ""
    low, high = np.quantile(values, (_RARE, 1.0 - _RARE))
    worst = low if limits.low - low > high - limits.high else high
    inside = limits.low - margin <= worst <= limits.high + margin
    return "" if inside else f"{name} {worst:.3g}, not {limits.low:.3g} to {limits.high:.3g} {unit}"


def _temperature_outside(joint: Joint, limits: Range | None, needed: bool) -> str:
    if np.isnan(joint.temperature):
        return "temperature is not reported" if needed else ""
    now = np.array([joint.temperature])
    return _outside("temperature", now, limits, _KELVIN, "degC") if limits else ""


def _model_values(joint: Joint) -> dict[str, str]:
    config = joint.config
    if config.model is None:
        return {"model": "", "model_effects": ""}
    digest = hashlib.sha256(config.model_text.encode()).hexdigest()
    return {
        "model": f"{config.model_file} sha256:{digest[:16]}",
        "model_effects": ", ".join(term.effect.name for term in config.model.effects),
    }


def _mesh_faults(joint: Joint, state: MeshState) -> list[Fault]:
    limits = joint.config.limits
    overlap, peak = float(state.overlap[0]), float(state.peak_load[0])
    concentration = float(state.load_concentration[0])
    return [
        ("INTERFERENCE", limits["overlap"].level(overlap), f"the lobes overlap by {overlap * 1e6:.1f} um"),
        ("LOAD_CONCENTRATION", limits["peak_tooth_load"].level(peak), f"peak tooth load {peak:.1f} N"),
        (
            "LOAD_CONCENTRATION",
            limits["load_concentration"].level(concentration),
            f"peak tooth load is {concentration:.1f} times the mean",
        ),
    ]


def _mesh(joint: Joint) -> tuple[MeshState | None, Floats]:
    """Teeth at the last sample, and the predicted error over one wave generator turn at its torque [rad]."""
    if joint.last is None:
        return None, np.array([np.nan])
    drive = joint.config.drive
    angle, torque = (np.array([value]) for value in joint.last)
    state = mesh_state(drive, angle, drive.frame.cup_torque(torque))
    count = _ANGLES_OF_TURN if joint.table is not None else _ANGLES_WITHOUT_MAP
    turn = angle + 2.0 * np.pi * np.arange(count) / count
    return state, transmission_error(drive, turn, np.repeat(torque, count), joint.table)


def _configuration_values(joint: Joint) -> dict[str, str]:
    drive = joint.config.drive
    angle, torque = joint.last if joint.last else (np.nan, np.nan)
    return {
        "eccentricity_um": _number(abs(drive.mesh.eccentricity) * 1e6),
        "eccentricity_direction_deg": _number(np.degrees(np.angle(drive.mesh.eccentricity))),
        "runout_um": _number(abs(drive.mesh.runout) * 1e6),
        "input_angle_rad": _number(angle),
        "torque_Nm": _number(torque),
        "temperature_C": _number(joint.temperature),
        "prediction": "exact" if joint.table is None else "map",
        "prediction_error_bound_arcsec": _number(
            0.0 if joint.table is None else joint.table.error_bound / ARCSEC
        ),
    }


def _mesh_values(state: MeshState | None, turn: Floats) -> dict[str, str]:
    if state is None:
        keys = "minimum_backlash_um interference overlap_um loaded_pairs peak_tooth_load_N load_concentration"
        return dict.fromkeys([*keys.split(), "lost_motion_arcmin", "predicted_te_pp_arcsec"], "nan")
    return {
        "minimum_backlash_um": _number(state.minimum_backlash[0] * 1e6),
        "interference": "true" if state.interference[0] else "false",
        "overlap_um": _number(state.overlap[0] * 1e6),
        "loaded_pairs": str(int(state.loaded_pairs[0])),
        "peak_tooth_load_N": _number(state.peak_load[0]),
        "load_concentration": _number(state.load_concentration[0]),
        "lost_motion_arcmin": _number(state.lost_motion[0] / _ARCMIN),
        "predicted_te_pp_arcsec": _number(np.ptp(turn) / ARCSEC),
    }


def _number(value: float) -> str:
    return f"{float(value):.6g}"


def _rate(window: Window) -> float:
    """Samples per second by their stamps [Hz]."""
    if window.accepted < 2 or window.stamps.size < 2:
        return 0.0
    span = int(window.stamps[-1] - window.stamps[0])
    return (window.accepted - 1) / (span * 1e-9) if span > 0 else math.nan
