"""The torsion curve: measured while the torque rises and falls, simulated, and its three stiffnesses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.drive import Drive
from hd_diag.formatting import number
from hd_diag.gears.characteristics import stiffness_steps
from hd_diag.gears.page import T1_SHARE, T2_SHARE, Page
from hd_diag.report.stages import EXTENDED, Band, Stages, band, mean_error

_BINS = 32
_NODES = 61
_BLOCKS = 24
_DRAWS = 1000
_LEAST_REACH = 0.3  # share of a torque range that the record must cover to measure its stiffness
_LEAST_SAMPLES = 200


@dataclass(frozen=True)
class Stiffness:
    """Torsional stiffness [N m/rad] within a range of torque [N m]; nan if it is not known.

    `configured` and `fitted` are secants of the simulated curves, averaged over the angle; `measured` is the
    inverse slope of the measured error over the torque, with its 95 % interval. `page` is the catalogue's.
    """

    name: str
    low: float
    high: float
    configured: float
    fitted: float
    page: float = float("nan")
    measured: float = float("nan")
    measured_low: float = float("nan")
    measured_high: float = float("nan")


def k_shown(stiffness: float) -> str:
    """Text of a stiffness [N m/rad] in 10⁴ N m/rad, as in a catalogue, with one more digit."""
    return number(1e-4 * stiffness)


@dataclass(frozen=True)
class Torsion:
    """Transmission error [rad] over torque [N m].

    `configured` and `fitted` are means over the angle, shape (nodes,); `low` and `high` are the least and the
    greatest of the fitted drive. `measured` holds the errors at rising and at falling torque, empty if they
    were not measured. `extended` holds that model's means over the same samples, empty without causes.
    """

    torque: Floats
    configured: Floats
    fitted: Floats
    low: Floats
    high: Floats
    stiffness: tuple[Stiffness, ...]
    measured: tuple[Band, ...] = ()
    extended: tuple[Floats, ...] = ()


def simulated(configured: Drive, fitted: Drive, most: float, page: Page | None) -> Torsion:
    """Curve of the model alone, up to a torque [N m]; T1 and T2 are the page's or shares of the rated one."""
    torque = most * np.linspace(-1.0, 1.0, _NODES)
    rated = configured.rated_torque
    ends = stiffness_steps(*((page.t1, page.t2) if page else (T1_SHARE * rated, T2_SHARE * rated)))
    given = np.array(page.stiffness) if page else np.full(3, np.nan)
    secants = np.stack(
        [ends[:-1], ends[1:], _secants(configured, ends), _secants(fitted, ends), given], axis=1
    )
    stiffness = tuple(Stiffness(f"K{n}", *row) for n, row in enumerate(secants.tolist(), start=1))
    return Torsion(torque, mean_error(configured, torque)[0], *mean_error(fitted, torque), stiffness)


def _secants(drive: Drive, ends: Floats) -> Floats:
    """Torque over torsion between the ends of the ranges, mean of both directions [N m/rad]."""
    error = mean_error(drive, np.concatenate((-ends[::-1], ends)))[0]
    torsion = 0.5 * (error[: ends.size][::-1] - error[ends.size :])
    return np.asarray(np.diff(ends) / np.diff(torsion))


def measured(found: Stages, configured: Drive, rng: np.random.Generator, page: Page | None) -> Torsion:
    """Measured and simulated curves; intervals of the stiffness come from a bootstrap over blocks."""
    record, torque = found.record, found.record.torque
    alone = simulated(configured, found.drive, max(float(np.max(np.abs(torque))), 1.0), page)
    if not record.has_torque:
        return alone
    rate = np.gradient(torque, record.time)
    edges = np.linspace(torque.min(), max(torque.max(), torque.min() + 1e-6), _BINS + 1)
    ways, extended = (rate > 0.0, rate <= 0.0), found.residual.get(EXTENDED)
    model = None if extended is None else found.measured - extended
    return replace(
        alone,
        stiffness=tuple(_with_slope(entry, found, rng) for entry in alone.stiffness),
        measured=tuple(band(torque[way], found.measured[way], edges) for way in ways),
        extended=() if model is None else tuple(band(torque[way], model[way], edges).mean for way in ways),
    )


def _with_slope(entry: Stiffness, found: Stages, rng: np.random.Generator) -> Stiffness:
    """The stiffness with its measured value, from both directions together, each with its own zero."""
    load = np.abs(found.record.torque)
    inside = (load >= entry.low) & (load <= entry.high)
    if inside.sum() < _LEAST_SAMPLES or np.ptp(load[inside]) < _LEAST_REACH * (entry.high - entry.low):
        return entry
    falls = found.record.torque[inside] < 0.0
    x, y = load[inside], np.where(falls, 1.0, -1.0) * found.measured[inside]
    # Sums in every block and direction, shape (blocks, 2, 5).
    group = 2 * (np.flatnonzero(inside) * _BLOCKS // load.size) + falls
    columns = (np.ones(x.size), x, y, x * y, x * x)
    sums = np.stack([np.bincount(group, column, 2 * _BLOCKS) for column in columns], axis=-1)
    sums = sums.reshape(_BLOCKS, 2, len(columns))
    draws = rng.integers(0, _BLOCKS, (_DRAWS, _BLOCKS))
    low, high = np.nanquantile([_slope(sums[draw].sum(axis=0)) for draw in draws], (0.025, 0.975))
    slope = _slope(sums.sum(axis=0))
    return replace(
        entry, measured=1.0 / slope, measured_low=float(1.0 / high), measured_high=float(1.0 / low)
    )


def _slope(sums: Floats) -> float:
    """Common slope of both directions about their own means [rad/(N m)]; nan where there is none."""
    count, x, y, xy, xx = np.maximum(sums[:, 0], 1.0), *sums[:, 1:].T
    spread = float(np.sum(xx - x * x / count))
    return float(np.sum(xy - x * y / count)) / spread if spread > 0.0 else float("nan")
