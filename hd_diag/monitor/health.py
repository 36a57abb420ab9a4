"""Verdict on one joint since the last report: fault codes, limits, and the numbers behind them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.drive import Drive, mesh_state, transmission_error
from hd_diag.extended_model import Range
from hd_diag.formatting import visible
from hd_diag.gear.characteristics import ToothLoads, tooth_loads
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.monitor.joint import Joint, Window
from hd_diag.monitor.publications import Status
from hd_diag.monitor.residual_orders import Order

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
# What is usual of an order that repeats.
_TYPICAL = {
    "input 1": "typical of an input encoder or coupling off centre, or of a wave generator that runs out",
    "input 2": "typical of a wave generator off centre (eccentricity) or of a pitch error",
    "input 4": "typical of a circular spline out of round or of a pitch error",
    "output 1": "typical of an output encoder off centre or of a link that runs out",
}
_TIMES = {1: "once", 2: "twice"}
_CRITICISE = "run 'hd-diag diagnose' on a log"

Fault = tuple[str, int, str]


class Around(NamedTuple):
    """What is known of a joint's surroundings at a report.

    Time since its last input [s]; ``log_state`` and ``latency_p99_us``; why the last sample that could not be
    used was refused; messages that named none of the configured joints.
    """

    silence: float
    facts: Mapping[str, str]
    last_rejection: str
    foreign: int


class _Mesh(NamedTuple):
    """The teeth at a joint's last sample, and the predicted error over a turn at its torque, in SI."""

    minimum_backlash: float
    loaded_pairs: float
    peak_load: float
    load_concentration: float
    lost_motion: float
    predicted_span: float


_NO_MESH = _Mesh(*[math.nan] * 6)


def reports(joint: Joint, windows: Sequence[Window], around: Sequence[Around]) -> list[Status]:
    """Status of a joint at each of some reports, of what happened since the one before.

    It has the fault code of the worst finding, and numbers in the units that their keys name.
    """
    fixed = _configuration_values(joint), _model_values(joint), _at_rest_values(joint)
    return [
        _status(joint, *each, fixed) for each in zip(windows, around, _meshes(joint, windows), strict=True)
    ]


def _status(
    joint: Joint, window: Window, around: Around, mesh: _Mesh | None, fixed: Sequence[dict[str, str]]
) -> Status:
    residual = float(np.std(window.residual)) if window.residual.size > 1 else math.nan
    mean = float(np.mean(window.residual)) if window.residual.size else math.nan
    order = max(window.orders, key=lambda order: (order.repeats, order.amplitude), default=Order())
    faults = _faults(joint, window, around, residual, mesh) + _model_faults(joint, window)
    faults += _order_faults(joint, window.orders)
    faults = [*(fault for fault in faults if fault[1]), ("OK", 0, "OK")]
    code, level, message = max(faults, key=lambda fault: (fault[1], -FAULT_CODES.index(fault[0])))
    angle, torque = window.last or (math.nan, math.nan)
    values = {
        "fault_code": code,
        "fault_codes": " ".join(dict.fromkeys(fault[0] for fault in faults[:-1])) or "OK",
        **fixed[0],
        "input_angle_rad": _number(angle),
        "torque_Nm": _number(torque),
        **fixed[1],
        **_mesh_values(mesh or _NO_MESH),
        **fixed[2],
        "residual_rms_arcsec": _number(residual / ARCSEC),
        "residual_mean_arcsec": _number(mean / ARCSEC),
        "residual_order": order.name,
        "residual_order_amplitude_arcsec": _number(order.amplitude / ARCSEC),
        "residual_order_std_arcsec": _number(order.std / ARCSEC),
        "residual_order_phase_deg": _number(math.degrees(order.phase)),
        "residual_order_repeats": "true" if order.repeats else "false",
        "residual_order_limit_arcsec": _number(joint.config.limits["residual_order"].warn / ARCSEC),
        "sample_rate_hz": _number(_rate(window)),
        "samples": str(window.samples),
        "samples_rejected": str(window.all_rejected),
        "last_rejection": around.last_rejection,
        "samples_missed": str(window.missed),
        "outputs_unpaired": str(window.unpaired),
        "clock_jumps": str(window.clock_jumps),
        "messages_without_joint": str(around.foreign),
        "silence_s": _number(around.silence),
        "lag_s": around.facts.get("lag_s", "nan"),
        "messages_lost": around.facts.get("messages_lost", "0"),
        "array_share": around.facts.get("array_share", "1"),
        "warning": around.facts.get("warning", ""),
        "latency_p99_us": around.facts.get("latency_p99_us", "nan"),
        "log_state": around.facts.get("log_state", "off"),
        "log_lost": around.facts.get("log_lost", "0"),
    }
    return Status(joint.config.name, level, message, values)


def _faults(joint: Joint, window: Window, around: Around, residual: float, mesh: _Mesh | None) -> list[Fault]:
    limits, silence, log = joint.config.limits, around.silence, around.facts.get("log_state", "")
    seen = window.accepted + window.rejected
    share = window.rejected / seen if seen else 0.0
    torque = abs(window.last[1]) / joint.config.drive.rated_torque if window.last else 0.0
    judged = [
        ("STALE", "silence", silence, f"no valid sample for {silence:.1f} s"),
        ("INPUT_INVALID", "rejected", share, f"{window.rejected} samples rejected: {around.last_rejection}"),
        ("OUT_OF_RANGE", "torque", torque, f"torque is {torque:.2f} times the rated torque"),
    ]
    if mesh is not None:
        loads, peak, ratio = tooth_loads(joint.config.drive), mesh.peak_load, mesh.load_concentration
        concentrated = f"peak tooth load is {ratio:.1f} times the mean"
        judged += [
            ("INTERFERENCE", "overlap", loads.overlap, _interference(joint, loads)),
            ("LOAD_CONCENTRATION", "peak_tooth_load", peak, f"peak tooth load {peak:.1f} N"),
            ("LOAD_CONCENTRATION", "load_concentration", ratio, concentrated),
        ]
    rest = f"residual {residual / ARCSEC:.1f} arcsec rms; the measured error is not the predicted one"
    judged.append(("RESIDUAL", "residual_rms", residual, f"{rest}; {_CRITICISE}"))
    found = [(code, limits[name].level(value), text) for code, name, value, text in judged]
    if warning := around.facts.get("warning"):
        found.append(("INPUT_INVALID", 1, warning))
    return [("LOG_FAILED", 1, f"log {log}"), *found] if log.startswith("failed") else found


def _interference(joint: Joint, loads: ToothLoads) -> str:
    """How far the lobes overlap, and what that does to the teeth."""
    even, limit = _even_loads(joint.config.drive).rated, joint.config.limits["peak_tooth_load"].warn
    return (
        f"the lobes overlap by {loads.overlap * 1e6:.1f} µm; they press a tooth with {loads.idle:.0f} N "
        f"without torque; at the rated torque it bears {loads.rated:.0f} N, not {even:.0f} N as if centred; "
        f"{100.0 * _margin_lost(joint):.0f} % of the margin to {limit:.0f} N is lost"
    )


@lru_cache(maxsize=512)
def _even_loads(drive: Drive) -> ToothLoads:
    """What the teeth of a drive bear without eccentricity."""
    return tooth_loads(replace(drive, mesh=replace(drive.mesh, eccentricity=0.0, runout=0.0)))


def _margin_lost(joint: Joint) -> float:
    """Part of what is left at the rated torque up to the limit of the tooth load that eccentricity takes."""
    loads, even = tooth_loads(joint.config.drive), _even_loads(joint.config.drive)
    margin = joint.config.limits["peak_tooth_load"].warn - even.rated
    return (loads.rated - even.rated) / margin if margin > 0.0 else math.nan


def _order_faults(joint: Joint, orders: Sequence[Order]) -> list[Fault]:
    """Orders that repeat, and of an extended model those of the output that have grown since it was fitted.

    Without one the output's own order is no finding: a torque that goes with the link's angle has it too.
    """
    limit, known = joint.config.limits["residual_order"], joint.config.model is not None
    return [
        ("RESIDUAL", limit.level(order.amplitude), _order_in_words(order, known))
        for order in sorted(orders, key=lambda order: -order.amplitude)
        if order.repeats or (known and order.frame == "output")
    ]


def _order_in_words(order: Order, has_model: bool) -> str:
    """An order in words."""
    times = _TIMES.get(order.number, f"{order.number} times")
    grown = " has grown since the model was fitted: it" if has_model else ""
    return (
        f"residual{grown} repeats {times} per {order.frame} turn with {order.amplitude / ARCSEC:.1f} arcsec "
        f"({order.name}); {_TYPICAL[order.name]}; {_CRITICISE}"
    )


def _model_faults(joint: Joint, window: Window) -> list[Fault]:
    """Where an extended model is outside its valid range."""
    model = joint.config.model
    if model is None:
        return []
    ranges, heat = model.ranges, np.array([joint.temperature])
    texts = [
        _outside("torque", window.torque, ranges.torque, "N m"),
        _outside("speed", window.speed, ranges.speed, "rad/s"),
        _outside("temperature", heat, ranges.temperature, "degC", _KELVIN),
    ]
    if math.isnan(joint.temperature) and "temperature" in model.needs:
        texts.append("temperature is not reported")
    return [("OUT_OF_RANGE", 1, f"outside the model's valid range: {text}") for text in texts if text]


def _outside(name: str, values: Floats, limits: Range | None, unit: str, margin: float = 0.0) -> str:
    """How a quantity left its range since the last report; single samples are noise. Empty if it did not."""
    values = values[np.isfinite(values)]
    if limits is None or not values.size:
        return ""
    margin = margin or _MARGIN * max(limits.high - limits.low, abs(limits.low), abs(limits.high))
    low, high = np.quantile(values, (_RARE, 1.0 - _RARE))
    worst = low if limits.low - low > high - limits.high else high
    inside = limits.low - margin <= worst <= limits.high + margin
    return "" if inside else f"{name} {worst:.3g}, not {limits.low:.3g} to {limits.high:.3g} {unit}"


def _model_values(joint: Joint) -> dict[str, str]:
    config = joint.config
    if config.model is None:
        return {"model": "", "model_effects": ""}
    digest = hashlib.sha256(config.model_text.encode()).hexdigest()
    return {
        "model": f"{visible(config.model_file)} sha256:{digest[:16]}",
        "model_effects": ", ".join(term.effect.name for term in config.model.effects),
    }


def _meshes(joint: Joint, windows: Sequence[Window]) -> list[_Mesh | None]:
    """The teeth at the last sample before each report, all at once; None before the first sample."""
    angle, torque = np.array([window.last for window in windows if window.last]).reshape(-1, 2).T.copy()
    if not angle.size:
        return [None] * len(windows)
    drive, table = joint.config.drive, joint.table
    state = mesh_state(drive, angle, drive.frame.cup_torque(torque))
    count = _ANGLES_OF_TURN if table is not None else _ANGLES_WITHOUT_MAP
    turns = angle[:, None] + 2.0 * np.pi * np.arange(count) / count
    errors = transmission_error(drive, turns.reshape(-1), np.repeat(torque, count), table)
    columns = [getattr(state, name).tolist() for name in _Mesh._fields[:-1]]
    found = map(_Mesh, *columns, np.ptp(errors.reshape(turns.shape), axis=1).tolist())
    return [next(found) if window.last else None for window in windows]


def _configuration_values(joint: Joint) -> dict[str, str]:
    drive, table = joint.config.drive, joint.table
    return {
        "eccentricity_um": _number(abs(drive.mesh.eccentricity) * 1e6),
        "eccentricity_direction_deg": _number(np.degrees(np.angle(drive.mesh.eccentricity))),
        "runout_um": _number(abs(drive.mesh.runout) * 1e6),
        **dict.fromkeys(("input_angle_rad", "torque_Nm"), "nan"),  # their places
        "temperature_C": _number(joint.temperature),
        "prediction": "exact" if table is None else "map",
        "prediction_error_bound_arcsec": _number(0.0 if table is None else table.error_bound / ARCSEC),
    }


def _at_rest_values(joint: Joint) -> dict[str, str]:
    """What the configured eccentricity does to the teeth, over a turn."""
    loads = tooth_loads(joint.config.drive)
    return {
        "interference": "true" if loads.overlap > 0.0 else "false",
        "overlap_um": _number(loads.overlap * 1e6),
        "idle_tooth_load_N": _number(loads.idle),
        "rated_tooth_load_N": _number(loads.rated),
        "tooth_load_margin_lost_percent": _number(100.0 * _margin_lost(joint)),
    }


def _mesh_values(mesh: _Mesh) -> dict[str, str]:
    return {
        "minimum_backlash_um": _number(mesh.minimum_backlash * 1e6),
        "loaded_pairs": str(mesh.loaded_pairs),
        "peak_tooth_load_N": _number(mesh.peak_load),
        "load_concentration": _number(mesh.load_concentration),
        "lost_motion_arcmin": _number(mesh.lost_motion / _ARCMIN),
        "predicted_te_pp_arcsec": _number(mesh.predicted_span / ARCSEC),
    }


def _number(value: float) -> str:
    return f"{float(value):.6g}"


def _rate(window: Window) -> float:
    """Samples per second by their stamps [Hz]."""
    if window.accepted < 2 or window.stamps.size < 2:
        return 0.0
    span = int(window.stamps[-1] - window.stamps[0])
    return (window.accepted - 1) / (span * 1e-9) if span > 0 else math.nan
