"""Health of one joint since the last report: fault codes, limits, and the numbers behind them."""

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
from hd_diag.gears.characteristics import ToothLoads, tooth_loads
from hd_diag.model.load_sharing import built_overlap
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.monitor.absence import absence, absence_of
from hd_diag.monitor.joint import Joint, Window
from hd_diag.monitor.publications import Status
from hd_diag.monitor.residual_orders import Order
from hd_diag.streams.alignment import Alignment

FAULT_CODES = (
    "STALE",
    "INPUT_INVALID",
    "OUT_OF_RANGE",
    "INTERFERENCE",
    "LOAD_CONCENTRATION",
    "RESIDUAL",
    "LOG_FAILED",
    "OK",
)
"""Fault codes; among several at the same level the first is reported."""

_ARCMIN = 60.0 * ARCSEC
# Angles over one turn of the wave generator for the peak-to-peak error: enough for the low orders of an
# eccentricity, and coprime with the tooth numbers so that they sample the ripple as well.
_ANGLES_OF_TURN = 257
_ANGLES_WITHOUT_MAP = 61
_RARE = 0.05  # share of the samples that may lie outside a model's range on either side
_MARGIN = 0.05  # share of a range by which a fit holds beyond it
_KELVIN = 2.0  # the same for a temperature [K]
# Typical causes of an order that repeats.
_TYPICAL = {
    "input 1": "typical of an input encoder or coupling off centre, or of a wave generator that runs out",
    "input 2": "typical of a wave generator off centre (eccentricity) or of a pitch error",
    "input 4": "typical of a circular spline out of round or of a pitch error",
    "output 1": "typical of an output encoder off centre or of a link that runs out",
}
_TIMES = {1: "once", 2: "twice"}
_CRITICISE = "the node's service ~/diagnose says why"
_MESH = (
    "minimum_backlash_um",
    "loaded_pairs",
    "peak_tooth_load_N",
    "load_concentration",
    "lost_motion_arcmin",
    "predicted_te_pp_arcsec",
)
_SURROUNDINGS = {
    "lag_s": "nan",
    "messages_lost": "0",
    "array_share": "1",
    "warning": "",
    "latency_p99_us": "nan",
    "log_state": "off",
    "log_lost": "0",
    "log_warning": "",
    "log_memory_s": "0.0",
    "log_memory_bytes": "0",
    "diagnosis_state": "none",
}
_OF_JOINT = ("verdict", "verdict_time")  # facts whose keys end with a dot and the joint's name

Fault = tuple[str, int, str]


def status(
    joint: Joint, window: Window, silence: float, facts: Mapping[str, str], streams: Alignment
) -> Status:
    """Status of a joint from its window since the last report.

    It has the fault code of the worst finding, and numbers in the units that their keys name. `silence` is
    the time since the joint's last input [s], `facts` are those of the caller.
    """
    config, state, residuals = joint.config, joint.state, window.residual
    angle, torque = (state["angle"], state["load"]) if joint.samples else (math.nan, math.nan)
    rms = float(np.std(residuals)) if residuals.size > 1 else math.nan
    orders, mesh, loads = joint.orders.known(), _mesh(joint), _loads(joint)
    order = max(orders, key=lambda order: (order.repeats, order.amplitude), default=Order())
    why = facts.get(absence_of(config.name)) or absence(joint, window, streams.before)
    stale = f"no valid sample for {silence:.1f} s: {why}"
    faults = _faults(joint, window, (silence, stale), facts, rms, mesh, loads) + _model_faults(joint, window)
    of_log = _log_faults(facts)
    faults += [*_order_faults(joint, orders), *of_log]
    faults = [*(fault for fault in faults if fault[1]), ("OK", 0, "OK")]
    code, level, message = max(faults, key=lambda fault: (fault[1], -FAULT_CODES.index(fault[0])))
    others = [window.others] if window.others else []  # they may cause a worse fault
    message = "; ".join(dict.fromkeys([message, *others, *(text for _, _, text in of_log)]))
    drive, table = config.drive, joint.table
    values: dict[str, str | float] = {
        "fault_code": code,
        "fault_codes": " ".join(dict.fromkeys(fault[0] for fault in faults[:-1])) or "OK",
        "eccentricity_um": abs(drive.mesh.eccentricity) * 1e6,
        "eccentricity_direction_deg": np.degrees(np.angle(drive.mesh.eccentricity)),
        "runout_um": abs(drive.mesh.runout) * 1e6,
        "input_angle_rad": angle,
        "torque_Nm": torque,
        "torque_not_measured": joint.no_torque,
        "temperature_C": joint.temperature,
        "prediction": "exact" if table is None else "map",
        "prediction_error_bound_arcsec": 0.0 if table is None else table.error_bound / ARCSEC,
        **_model_values(joint),
        **mesh,
        "interference": _truth(loads.real.overlap > built_overlap(drive.mesh.geometry)),
        "overlap_um": loads.real.overlap * 1e6,
        "idle_tooth_load_N": loads.real.idle,
        "rated_tooth_load_N": loads.real.rated,
        "tooth_load_margin_lost_percent": 100.0 * loads.margin_lost,
        "residual_rms_arcsec": rms / ARCSEC,
        "residual_mean_arcsec": float(np.mean(residuals)) / ARCSEC if residuals.size else math.nan,
        "residual_order": order.name,
        "residual_order_amplitude_arcsec": order.amplitude / ARCSEC,
        "residual_order_std_arcsec": order.std / ARCSEC,
        "residual_order_phase_deg": math.degrees(order.phase),
        "residual_order_repeats": _truth(order.repeats),
        "residual_order_limit_arcsec": config.limits["residual_order"].warn / ARCSEC,
        "sample_rate_hz": _rate(window),
        "samples": str(joint.samples),
        "samples_rejected": str(joint.rejected),
        "last_rejection": joint.last_rejection,
        "samples_missed": str(joint.lost.count),
        "outputs_unpaired": str(state["unpaired"]),
        "clock_jumps": str(state["clock_jumps"]),
        "stamps_zero": str(state["unstamped"]),
        "messages_without_joint": str(streams.foreign),
        "silence_s": silence,
        **{name: facts.get(name, usual) for name, usual in _SURROUNDINGS.items()},
        **{name: facts.get(f"{name}.{config.name}", "") for name in _OF_JOINT},
    }
    texts = {key: value if isinstance(value, str) else f"{float(value):.6g}" for key, value in values.items()}
    return Status(config.name, level, message, texts)


def _faults(
    joint: Joint,
    window: Window,
    silence: tuple[float, str],
    facts: Mapping[str, str],
    residual: float,
    mesh: Mapping[str, float],
    loads: _Loads,
) -> list[Fault]:
    limits, has_samples = joint.config.limits, joint.samples > 0
    seen = window.accepted + window.rejected
    share = window.rejected / seen if seen else 0.0
    torque = abs(joint.state["load"]) / joint.config.drive.rated_torque if has_samples else 0.0
    judged = [
        ("STALE", "silence", *silence),
        ("INPUT_INVALID", "rejected", share, f"{window.rejected} samples rejected: {joint.last_rejection}"),
        ("OUT_OF_RANGE", "torque", torque, f"torque is {torque:.2f} times the rated torque"),
    ]
    if has_samples:
        peak, ratio = mesh["peak_tooth_load_N"], mesh["load_concentration"]
        concentrated = f"peak tooth load is {ratio:.1f} times the mean"
        judged += [
            ("INTERFERENCE", "overlap", loads.real.overlap, _interference(loads)),
            ("LOAD_CONCENTRATION", "peak_tooth_load", peak, f"peak tooth load {peak:.1f} N"),
            ("LOAD_CONCENTRATION", "load_concentration", ratio, concentrated),
        ]
    rest = f"residual {residual / ARCSEC:.1f} arcsec rms; the measured error is not the predicted one"
    if joint.no_torque:
        rest = f"{rest}; no torque is measured: it {joint.no_torque}"
    judged.append(("RESIDUAL", "residual_rms", residual, f"{rest}; {_CRITICISE}"))
    found = [(code, limits[name].level(value), text) for code, name, value, text in judged]
    if warning := facts.get("warning"):
        found.append(("INPUT_INVALID", 1, warning))
    if window.others:
        found.append(("INPUT_INVALID", 1, window.others))
    return found


def _log_faults(facts: Mapping[str, str]) -> list[Fault]:
    """Faults of the log. They belong to no joint and never replace a joint's own fault."""
    state, warning = facts.get("log_state", ""), facts.get("log_warning", "")
    texts = [f"log {state}"] if state.startswith("failed") else []
    return [("LOG_FAILED", 1, text) for text in [*texts, *([f"log: {warning}"] if warning else [])]]


def _interference(loads: _Loads) -> str:
    """Text on how far the lobes overlap, and what that does to the teeth."""
    return (
        f"the lobes overlap by {loads.real.overlap * 1e6:.1f} µm; they press a tooth with "
        f"{loads.real.idle:.0f} N without torque; at the rated torque it bears {loads.real.rated:.0f} N, not "
        f"{loads.even.rated:.0f} N as if centred; {100.0 * loads.margin_lost:.0f} % of the margin to "
        f"{loads.limit:.0f} N is lost"
    )


class _Loads(NamedTuple):
    """Tooth loads of a joint as assembled (`real`) and if centred (`even`), and their limit [N]."""

    real: ToothLoads
    even: ToothLoads
    limit: float

    @property
    def margin_lost(self) -> float:
        """Share of the tooth load's margin at the rated torque that eccentricity, runout and tilt take."""
        margin = self.limit - self.even.rated
        return (self.real.rated - self.even.rated) / margin if margin > 0.0 else math.nan


def _loads(joint: Joint) -> _Loads:
    return _Loads(*_both_loads(joint.config.drive), joint.config.limits["peak_tooth_load"].warn)


@lru_cache(maxsize=512)
def _both_loads(drive: Drive) -> tuple[ToothLoads, ToothLoads]:
    """Tooth loads of a drive, as it is and without eccentricity, runout and tilt."""
    centred = replace(drive.mesh, eccentricity=0.0, runout=0.0, tilt=0.0)
    return tooth_loads(drive), tooth_loads(replace(drive, mesh=centred))


def _order_faults(joint: Joint, orders: Sequence[Order]) -> list[Fault]:
    """Faults of orders that repeat; with an extended model, also of output orders grown since its fit.

    Without a model the output's order is no finding: a torque that follows the link's angle has it too.
    """
    limit, known = joint.config.limits["residual_order"], joint.config.model is not None
    return [
        ("RESIDUAL", limit.level(order.amplitude), _order_in_words(order, known))
        for order in sorted(orders, key=lambda order: -order.amplitude)
        if order.repeats or (known and order.frame == "output")
    ]


def _order_in_words(order: Order, has_model: bool) -> str:
    """Text on one order."""
    times = _TIMES.get(order.number, f"{order.number} times")
    grown = " has grown since the model was fitted: it" if has_model else ""
    return (
        f"residual{grown} repeats {times} per {order.frame} turn with {order.amplitude / ARCSEC:.1f} arcsec "
        f"({order.name}); {_TYPICAL[order.name]}; {_CRITICISE}"
    )


def _model_faults(joint: Joint, window: Window) -> list[Fault]:
    """Faults of an extended model that is used outside its valid range."""
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
    """Text on how a quantity left its range since the last report, noise ignored; empty if it did not."""
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


def _mesh(joint: Joint) -> dict[str, float]:
    """Values of the teeth at the last sample, and the predicted peak-to-peak error over a turn at its torque.

    All are nan before the first sample.
    """
    if not joint.samples:
        return dict.fromkeys(_MESH, math.nan)
    drive, table = joint.config.drive, joint.table
    angle, torque = np.array([joint.state["angle"]]), np.array([joint.state["load"]])
    state = mesh_state(drive, angle, drive.frame.cup_torque(torque))
    count = _ANGLES_OF_TURN if table is not None else _ANGLES_WITHOUT_MAP
    turn = angle + 2.0 * np.pi * np.arange(count) / count
    span = np.ptp(transmission_error(drive, turn, np.repeat(torque, count), table))
    found = (
        state.minimum_backlash[0] * 1e6,
        state.loaded_pairs[0],
        state.peak_load[0],
        state.load_concentration[0],
        state.lost_motion[0] / _ARCMIN,
        span / ARCSEC,
    )
    return dict(zip(_MESH, found, strict=True))


def _truth(value: bool) -> str:
    return "true" if value else "false"


def _rate(window: Window) -> float:
    """Samples per second by their stamps [Hz]."""
    if window.accepted < 2 or window.stamps.size < 2:
        return 0.0
    span = int(window.stamps[-1] - window.stamps[0])
    return (window.accepted - 1) / (span * 1e-9) if span > 0 else math.nan
