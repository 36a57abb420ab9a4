"""Evidence of sets of columns with sizes integrated out, against explicit densities and fits."""

import itertools
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from hd_diag.diagnosis.calibration import LARGER, LARGER_BY, SIZES, TEMPER
from hd_diag.diagnosis.evidence.evidence import Evidence

ROWS = 40
USUAL = {"remainder": np.array([0.3, 0.5, 0.2]), "cause": np.array([2.0, 0.7]), "other": np.array([1.5])}
CHOICES = {"remainder": (LARGER_BY, LARGER), "cause": (SIZES, LARGER), "other": (SIZES, 0.0)}
PRIOR = {name: (USUAL[name], *CHOICES[name]) for name in USUAL}
WIDTHS = [
    dict(zip(names, widths, strict=True))
    for count in range(4)
    for names in itertools.combinations(USUAL, count)
    for widths in itertools.product(*(CHOICES[name][0][::2] for name in names))
]
"""Sets of any groups at some widths."""

seeds = st.integers(0, 2**32 - 1)
sets = st.sampled_from(WIDTHS)
COPIES = 40  # more columns than one batch holds
few = settings(max_examples=40)


def beyond(choices: tuple[float, ...], width: float) -> int:
    """Number of choices from the usual width to a larger one."""
    return sum(1.0 < other <= width for other in choices)


class Problem(NamedTuple):
    """Columns (n, k) of the base and of every group, the target (n,), and the prior of the base."""

    base: np.ndarray
    groups: dict[str, np.ndarray]
    target: np.ndarray
    precision: np.ndarray
    mean: np.ndarray

    @property
    def evidence(self) -> Evidence:
        return self.evidence_of(*self.groups)

    def evidence_of(self, *names: str) -> Evidence:
        """Evidence of the base with some groups."""
        columns = np.concatenate([self.base, *(self.groups[name] for name in names)], axis=1)
        square = float(self.target @ self.target)
        normal = columns.T @ columns, columns.T @ self.target, square
        return Evidence.of(*normal, self.precision, self.mean, [(name, PRIOR[name]) for name in names])

    def joined(self, widths: dict[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns of a set (n, k), and mean and standard deviation of their coefficients (k,)."""
        columns = np.concatenate([self.base, *(self.groups[name] for name in widths)], axis=1)
        wide = [self.precision**-0.5, *(width * USUAL[name] for name, width in widths.items())]
        deviation = np.concatenate(wide)
        return columns, np.pad(self.mean, (0, deviation.size - self.mean.size)), deviation

    def density(self, widths: dict[str, float]) -> float:
        """Log density of the target at noise variance 1 / TEMPER, plus the penalty for larger widths."""
        columns, mean, deviation = self.joined(widths)
        covariance = np.eye(ROWS) / TEMPER + (columns * deviation**2) @ columns.T
        cost = sum(CHOICES[name][1] * beyond(CHOICES[name][0], width) for name, width in widths.items())
        return float(multivariate_normal(columns @ mean, covariance).logpdf(self.target)) + cost


def problem(seed: int) -> Problem:
    """Random similar columns, and a target that some of them explain."""
    random = np.random.default_rng(seed)
    base, common = random.normal(size=(ROWS, 3)), random.normal(size=(ROWS, 1))
    groups = {name: random.normal(size=(ROWS, usual.size)) + common for name, usual in USUAL.items()}
    part = sum(groups[name] @ (USUAL[name] * random.normal(size=USUAL[name].size)) for name in groups)
    target = base @ random.normal(size=3) + random.uniform(0.0, 3.0) * part + random.normal(size=ROWS)
    return Problem(base, groups, target, random.uniform(0.1, 10.0, 3), random.normal(size=3))


@few
@given(seeds, sets, sets)
def test_evidence_is_the_tempered_density(seed: int, one: dict[str, float], other: dict[str, float]) -> None:
    made = problem(seed)
    found, expected = (f(one) - f(other) for f in (made.evidence.log, made.density))
    assert found == pytest.approx(expected, abs=1e-7)


@few
@given(seeds, sets)
def test_a_gain_is_the_best_difference_of_two_sets(seed: int, widths: dict[str, float]) -> None:
    evidence = problem(seed).evidence
    rest = [name for name in USUAL if name not in widths]
    now, found = evidence.log(widths), evidence.gains(widths, rest)
    assert set(found) == set(rest)
    for name in rest:
        more = {w: evidence.log({**widths, name: w}) - now for w in CHOICES[name][0]}
        gain, width = found[name]
        assert gain == pytest.approx(max(more.values()), abs=1e-7)
        assert more[width] == pytest.approx(gain, abs=1e-7)


@few
@given(seeds, sets)
def test_tuned_widths_are_on_the_grid_and_no_worse_than_before(seed: int, widths: dict[str, float]) -> None:
    evidence = problem(seed).evidence
    best, found = evidence.tuned(widths)
    assert list(found) == list(widths)
    assert all(width in CHOICES[name][0] for name, width in found.items())
    assert best == evidence.log(found) >= evidence.log(widths)
    for name in widths:
        others = {one: width for one, width in widths.items() if one != name}
        assert others.items() <= evidence.tuned(widths, [name])[1].items()


@few
@given(seeds, st.sampled_from([(name, width) for name in USUAL for width in CHOICES[name][0]]))
def test_one_width_is_tuned_to_the_best_of_its_grid(seed: int, start: tuple[str, float]) -> None:
    name, width = start
    evidence = problem(seed).evidence
    best, found = evidence.tuned({name: width})
    every = {one: evidence.log({name: one}) for one in CHOICES[name][0]}
    assert (best, found[name]) == (max(every.values()), max(every, key=every.__getitem__))


@few
@given(seeds, sets)
def test_coefficients_are_those_of_ridge_regression(seed: int, widths: dict[str, float]) -> None:
    made = problem(seed)
    columns, mean, deviation = made.joined(widths)
    ridge = np.vstack((np.sqrt(TEMPER) * columns, np.diag(1.0 / deviation)))
    wanted = np.concatenate((np.sqrt(TEMPER) * made.target, mean / deviation))
    expected = np.linalg.lstsq(ridge, wanted)[0]
    base, groups = made.evidence.coefficients(widths)
    found = [base * made.precision**-0.5, *(groups[name] * USUAL[name] for name in widths)]
    assert_allclose(np.concatenate(found), expected, rtol=1e-7, atol=1e-9)


@few
@given(seeds, sets, st.sampled_from(sorted(USUAL)))
def test_information_is_what_the_set_cannot_imitate(seed: int, widths: dict[str, float], name: str) -> None:
    """Inverse of the group's block in the inverse of the full information, without the group's prior."""
    made = problem(seed)
    beside = {one: width for one, width in widths.items() if one != name}
    columns, _, deviation = made.joined(beside)
    own = made.groups[name] * USUAL[name]
    both = np.concatenate((columns * deviation, own), axis=1)
    prior = np.concatenate((np.ones(deviation.size), np.zeros(own.shape[1])))
    spread = np.linalg.inv(TEMPER * both.T @ both + np.diag(prior))[deviation.size :, deviation.size :]
    inner, whole = made.evidence.information(beside, name)
    assert_allclose(inner, np.linalg.inv(spread), rtol=1e-7, atol=1e-9)
    assert_allclose(whole, TEMPER * own.T @ own, rtol=1e-12)


@few
@given(seeds, sets)
def test_what_is_kept_apart_brings_the_same(seed: int, widths: dict[str, float]) -> None:
    made = problem(seed)
    names = [name for name in USUAL if name not in widths]
    columns = np.concatenate([made.base, *(made.groups[name] for name in widths)], axis=1)
    suffixes = ("", *(f" {number}" for number in range(COPIES)))
    apart = ((f"{name}{one}", made.groups[name], PRIOR[name]) for name in names for one in suffixes)
    evidence = made.evidence_of(*widths).beside(columns, made.target, apart)
    assert evidence.log(widths) == pytest.approx(made.evidence.log(widths), abs=1e-9)
    expected = made.evidence.gains(widths, names)
    for suffix in suffixes:
        found = evidence.gains(widths, [f"{name}{suffix}" for name in names])
        for name in names:
            assert found[f"{name}{suffix}"] == pytest.approx(expected[name], abs=1e-9)
    for name in names:
        both = (one.information(widths, name) for one in (evidence, made.evidence))
        for found, expected in zip(*both, strict=True):
            assert_allclose(found, expected, atol=1e-9)


def test_what_has_no_prior_is_as_good_as_free() -> None:
    """Without a prior, the coefficient is that of least squares, far below the substitute deviation."""
    random = np.random.default_rng(1)
    columns = 1e6 * random.normal(size=(ROWS, 2))
    target = columns @ np.array([2e-4, -1e-4]) + random.normal(size=ROWS)
    normal = columns.T @ columns, columns.T @ target, float(target @ target)
    evidence = Evidence.of(*normal, np.array([0.0, 1e-4]), np.zeros(2), [])
    base, _ = evidence.coefficients({})
    expected = np.linalg.lstsq(columns, target)[0]
    assert_allclose(base * np.array([1e-2, 1e2]), expected, rtol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_columns_that_are_alike_beside_little_noise_have_an_evidence(seed: int) -> None:
    """The rounding error of their products exceeds what a prior adds to them."""
    made = problem(seed)
    alike = {name: made.base[:, :1] * np.linspace(1e13, 2e13, size.size) for name, size in USUAL.items()}
    made = made._replace(base=1e13 * made.base, groups=alike, target=1e13 * made.base[:, 0])
    widths = {name: CHOICES[name][0][0] for name in USUAL}
    assert np.isfinite(made.evidence.log(widths))
    base, groups = made.evidence.coefficients(widths)
    explained = made.base @ (base * made.precision**-0.5)
    explained += sum(alike[name] @ (groups[name] * USUAL[name]) for name in widths)
    assert_allclose(explained, made.target, atol=1e-5 * np.abs(made.target).max())
