"""Standard methods on the same records: spectral peaks, LassoCV, and PySINDy's sequential threshold.

All methods start where the package starts its search: at the residual of the refitted model. The two
regressions use the package's own dictionary, including the derivatives of the model.
"""

from __future__ import annotations

import importlib.util
import time
import warnings
from collections.abc import Callable

import numpy as np
import scoring
from challenge import records

from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.diagnosis.fit.refit import refit
from hd_diag.model.torsion_map import ARCSEC

ROWS = 6000
GRID_POINTS = 4  # per effect with nonlinear values
WORTH_NAMING = 0.25 * ARCSEC  # [rad rms]
PER_TURN = 256
TIMES_FLOOR = 8.0  # ratio of a spectral peak to the median around it

# Cycles per input turn, their tolerance, and the causes usually blamed for them.
KNOWN_ORDERS = (
    (0.01, 0.003, ["output_runout", "output_encoder_eccentricity"]),
    (0.44, 0.03, ["bearing_passage"]),
    (1.0, 0.004, ["input_encoder_eccentricity"]),
    (2.0, 0.008, ["circular_spline_pitch"]),
    (2.02, 0.008, ["flexspline_pitch"]),
    (4.0, 0.008, ["circular_spline_form", "circular_spline_pitch"]),
    (4.04, 0.008, ["flexspline_pitch"]),
    (6.0, 0.008, ["circular_spline_form"]),
    *((float(n), 0.008, ["encoder_interpolation"]) for n in (8, 12, 16, 20, 24, 32)),
)

Named = tuple[list[list[str]], list[float]]


def fft(bench: LinearisedFit) -> Named:
    """Spectral peaks of the residual over the input angle, at the orders that textbooks know."""
    bench_left = bench.residual - bench.residual.mean()
    cell = np.round(bench.signals.wave_generator_angle * PER_TURN / (2.0 * np.pi)).astype(np.int64)
    cell -= cell.min()
    total, count = np.bincount(cell, bench_left), np.bincount(cell)
    mean = np.where(count > 0, total / np.maximum(count, 1), 0.0)
    filled = max(float((count > 0).mean()), 1e-9)
    amplitude = np.abs(np.fft.rfft(mean)) * 2.0 / (mean.size * filled)
    order = np.arange(amplitude.size) * PER_TURN / mean.size
    named: list[list[str]] = []
    sizes: list[float] = []
    for place, half, names in KNOWN_ORDERS:
        inside = np.abs(order - place) <= max(half, 0.6 * PER_TURN / mean.size)
        around = (order > 0.0) & (np.abs(order - place) < 0.3 * place + 0.1)
        if not (inside & around).any() or names in named:
            continue
        peak = float(amplitude[inside].max())
        if peak > TIMES_FLOOR * np.median(amplitude[around]) and peak > np.sqrt(2.0) * WORTH_NAMING:
            named.append(names)
            sizes.append(peak / np.sqrt(2.0))
    return named, sizes


def dictionary(bench: LinearisedFit) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Centred columns of unit rms, the residual [rad], and the effect of each column ("" for the model)."""
    parts, owners = [bench.always()], [""] * bench.always().shape[1]
    for effect in bench.data.searched:
        if not effect.testable(bench.signals)[0]:
            continue
        grid = bench.data.grid(effect)
        for point in grid[:: max(len(grid) // GRID_POINTS, 1)][:GRID_POINTS]:
            parts.append(bench.columns(effect, point))
            owners += [effect.name] * parts[-1].shape[1]
    rows = slice(None, None, max(bench.residual.size // ROWS, 1))
    columns, left = np.concatenate([part[rows] for part in parts], axis=1), bench.residual[rows]
    spread = columns.std(axis=0)
    moving = spread > 1e-9 * np.abs(columns).max(axis=0)
    centered = (columns - columns.mean(axis=0))[:, moving] / spread[moving]
    return (
        centered,
        left - left.mean(),
        [owner for owner, moves in zip(owners, moving, strict=True) if moves],
    )


def _named(columns: np.ndarray, owners: list[str], weights: np.ndarray) -> Named:
    """Effects whose fitted contribution is large enough to name, and its rms [rad]."""
    named, sizes = [], []
    for name in dict.fromkeys(owner for owner in owners if owner):
        own = np.array([owner == name for owner in owners])
        size = float(np.std(columns[:, own] @ weights[own]))
        if size > WORTH_NAMING:
            named.append([name])
            sizes.append(size)
    return named, sizes


def lasso(bench: LinearisedFit) -> Named:
    """LassoCV over five contiguous folds."""
    from sklearn.linear_model import LassoCV

    columns, left, owners = dictionary(bench)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = LassoCV(cv=5, max_iter=5000, fit_intercept=False).fit(columns, left / ARCSEC)
    return _named(columns, owners, fit.coef_ * ARCSEC)


def sindy(bench: LinearisedFit) -> Named:
    """PySINDy's sequential threshold least squares; the threshold is the smallest rms worth naming."""
    from pysindy import STLSQ

    columns, left, owners = dictionary(bench)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = STLSQ(threshold=WORTH_NAMING / ARCSEC, alpha=1e-3).fit(columns, left[:, None] / ARCSEC)
    return _named(columns, owners, np.asarray(fit.coef_).ravel() * ARCSEC)


METHODS: dict[str, tuple[str, Callable[[LinearisedFit], Named]]] = {
    "FFT peaks": ("numpy", fft),
    "LassoCV": ("sklearn", lasso),
    "PySINDy STLSQ": ("pysindy", sindy),
}


def available() -> list[str]:
    """Methods whose package is installed."""
    return [name for name, (package, _) in METHODS.items() if importlib.util.find_spec(package)]


def scores(made: records.Record, family: str, seed: int) -> list[scoring.Score]:
    """Scores of all available baselines."""
    record = scoring.prepared(made)
    configured = scoring.configured(made)
    found_parameters = refit(record, configured, np.random.default_rng(0)).parameters
    bench = linearise(record, configured, found_parameters)
    found = []
    for name in available():
        begin = time.process_time()
        named, sizes = METHODS[name][1](bench)
        found.append(scoring.scored(name, made, family, seed, named, sizes))
        found[-1].seconds = time.process_time() - begin
    return found
