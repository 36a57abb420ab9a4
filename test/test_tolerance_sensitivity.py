"""Sobol indices: closed forms of toy functions, through the code for assemblies."""

import numpy as np
from numpy.testing import assert_allclose

from hd_diag.tolerance.sensitivity import evaluations, indices

SLOPES = np.array([1.0, 2.0, 3.0, 0.0])
SHARES = SLOPES**2 / np.sum(SLOPES**2)


def linear(numbers: np.ndarray) -> np.ndarray:
    return (numbers @ SLOPES)[:, None]


def test_bounds_hold_the_truth() -> None:
    """Shares of a linear function follow its squared slopes; an unused input has none."""
    found = indices(linear, 4, 256, np.random.default_rng(3))
    assert found.first.value[0, 3] == found.total.value[0, 3] == 0.0
    for low, high in ((e.low, e.high) for e in (found.first, found.total)):
        assert np.all((low[0] <= SHARES) & (high[0] >= SHARES))
    assert np.all(found.total.high[0, :3] > found.total.low[0, :3])


def test_ishigami() -> None:
    """Ishigami and Homma (1990), a = 7, b = 0.1: published indices."""
    asked: list[int] = []

    def ishigami(numbers: np.ndarray) -> np.ndarray:
        asked.append(len(numbers))
        x = np.pi * (2 * numbers - 1)
        return (np.sin(x[:, 0]) * (1 + 0.1 * x[:, 2] ** 4) + 7 * np.sin(x[:, 1]) ** 2)[:, None]

    found = indices(ishigami, 3, 4096, np.random.default_rng(1))
    assert sum(asked) == evaluations(4096, 3) == 4096 * 5
    assert_allclose(found.first.value[0], [0.3139, 0.4424, 0.0], atol=0.02)
    assert_allclose(found.total.value[0], [0.5576, 0.4424, 0.2437], atol=0.02)


def test_an_output_that_never_changes_and_one_that_is_infinite() -> None:
    def model(numbers: np.ndarray) -> np.ndarray:
        columns = np.column_stack((numbers @ SLOPES, np.ones(len(numbers)), numbers @ SLOPES))
        columns[3, 2] = np.inf
        return columns

    found = indices(model, 4, 64, np.random.default_rng(0))
    assert np.isfinite(found.total.value[0]).all()
    assert np.all(found.total.value[1] == 0.0)
    for field in (found.first.value, found.total.value, found.total.low, found.first.high):
        assert np.isnan(field[2]).all()
