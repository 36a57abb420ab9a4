"""Coloured noise: an autoregressive model of the residual, and the filter that whitens each run."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_toeplitz, toeplitz

from hd_diag.arrays import Floats, Integers

ORDER = 20
"""Order of the autoregressive model [samples]."""

_LEAST = 1e-9  # least share of white noise in the variance


@dataclass(frozen=True)
class Whitening:
    """Autoregressive noise ``e_t = sum a_k e_{t-k} + w_t``.

    Attributes
    ----------
    coefficients : ndarray, shape (ORDER,)
        The values a_k.
    scale : float
        Standard deviation of w [rad].
    slow, kept : float
        Slow noise that no model describes, in addition: its standard deviation after whitening [-], and the
        share of it that a row keeps from the previous one.
    """

    coefficients: Floats
    scale: float
    slow: float = 0.0
    kept: float = 0.0

    def __call__(self, columns: Floats, run: Integers) -> Floats:
        """Whitened columns, (n,) or (n, k), in units of the innovation.

        The filter restarts where the run (n,) changes. Each of the first ORDER samples of a run is predicted
        from all samples before it in the run.
        """
        if not columns.size:
            return np.zeros_like(columns)
        from hd_diag.diagnosis import kernel  # late: it imports numba

        taps = np.concatenate(([1.0], -self.coefficients)) / self.scale
        wide = np.ascontiguousarray(columns.reshape(run.size, -1))
        edges = _edges(run)
        white = kernel.filtered(wide, taps, edges)
        begun = edges[:-1, None] + np.arange(ORDER)
        inside = begun < edges[1:, None]
        white[begun[inside]] = (self._beginning @ wide[np.where(inside, begun, 0)])[inside]
        if self.slow:
            white = kernel.innovations(white, edges, self.slow, self.kept)[0]
        return np.asarray(white.reshape(columns.shape))

    def drawn(self, size: int, rng: np.random.Generator) -> Floats:
        """Random noise with this spectrum [rad], shape (size,): white noise through the inverse filters."""
        white, taps = np.fft.rfft(rng.standard_normal(size)), np.append(1.0, -self.coefficients)
        if self.slow:
            part = np.fft.rfft(rng.standard_normal(size)) / np.fft.rfft([1.0, -self.kept], size)
            white += self.slow * np.sqrt(1.0 - self.kept**2) * part
        return np.asarray(self.scale * np.fft.irfft(white / np.fft.rfft(taps, size), size))

    @property
    def key(self) -> tuple[Hashable, ...]:
        """Values that identify this noise model, for caches."""
        return self.coefficients.tobytes(), self.scale, self.slow, self.kept

    def logarithm(self, run: Integers) -> float:
        """Half the log determinant of the whitened noise's covariance; zero without slow noise; run (n,)."""
        from hd_diag.diagnosis import kernel  # late: it imports numba

        none = np.empty((run.size, 0))
        return kernel.innovations(none, _edges(run), self.slow, self.kept)[1] if self.slow else 0.0

    @cached_property
    def _beginning(self) -> Floats:
        """Whitening matrix of the first samples of a run (ORDER, ORDER): inverse root of their covariance.

        The predictor of each order gives that of the next lower one (Levinson's recursion, backwards).
        """
        found, taps, variance = np.zeros((ORDER, ORDER)), self.coefficients, self.scale**2
        for order in range(ORDER - 1, -1, -1):
            last = taps[order]
            rest = max(1.0 - last**2, _LEAST)
            taps, variance = (taps[:order] + last * taps[:order][::-1]) / rest, variance / rest
            found[order, : order + 1] = np.append(-taps[::-1], 1.0) / np.sqrt(variance)
        return found


def bounds(run: Integers) -> list[tuple[int, int]]:
    """First row and end (exclusive) of every run."""
    return list(pairwise(_edges(run).tolist()))


def _edges(run: Integers) -> Integers:
    return np.concatenate(([0], np.flatnonzero(np.diff(run)) + 1, [run.size]))


def numbered(change: npt.NDArray[np.bool_]) -> Integers:
    """Stretch number (n,) of each row, from zero; a stretch ends after each row with a `change` (n - 1,)."""
    return np.concatenate(([0], np.cumsum(change))).astype(np.int64)


def spans(rows: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First row and end (exclusive) of every stretch of true rows (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], rows, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def slices(time: Floats, run: Integers, seconds: float) -> Integers:
    """Stretch number (n,) of each row, from zero; runs (n,) are divided into stretches of some seconds."""
    if not run.size:
        return np.empty(0, dtype=np.int64)
    edges = bounds(run)
    begun = np.repeat([time[begin] for begin, _ in edges], [end - begin for begin, end in edges])
    change = (np.diff((time - begun) // seconds) != 0) | (np.diff(run) != 0)
    return numbered(change)


def whitening(residual: Floats, run: Integers, fitted: Floats | None = None) -> Whitening:
    """The noise model of a residual (n,) [rad]: Yule-Walker with covariances pooled over the runs (n,).

    `fitted` are the orthonormal columns (n, k) of the fit. They absorbed a share of the white noise, which is
    restored here; otherwise slow parts of the noise would look significant.
    """
    covariance, taken, count = np.zeros(ORDER + 1), np.zeros(ORDER + 1), 0
    for begin, end in bounds(run):
        part = residual[begin:end]
        if part.size <= ORDER:
            continue
        part = part - part.mean()
        covariance += _products(part)
        count += part.size
        if fitted is not None:
            taken += _products(fitted[begin:end])
    white = covariance[0] / max(count - taken[0], 1.0)
    return whitening_of((covariance + white * taken) / max(count, 1))


def _products(values: Floats) -> Floats:
    """Sums of products of values (n,) or (n, k) at lags 0 to ORDER, shape (ORDER + 1,)."""
    size = values.shape[0]
    return np.array([float(np.vdot(values[lag:], values[: size - lag])) for lag in range(ORDER + 1)])


def whitening_of(covariance: Floats) -> Whitening:
    """The noise model with covariances at lags 0 to ORDER [rad^2], shape (ORDER + 1,).

    Estimates may not be positive definite; just enough white noise is then added.
    """
    if not covariance[0] > 0.0:
        return Whitening(np.zeros(ORDER), 1e-12)
    least = float(np.linalg.eigvalsh(toeplitz(covariance))[0])
    covariance = covariance.copy()
    covariance[0] += max(_LEAST * covariance[0] - least, 0.0)
    coefficients = solve_toeplitz(covariance[:-1], covariance[1:])
    innovation = covariance[0] - float(coefficients @ covariance[1:])
    return Whitening(coefficients, float(np.sqrt(max(innovation, 1e-6 * covariance[0]))))
