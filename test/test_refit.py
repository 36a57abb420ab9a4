"""The refit of the model's own parameters, on records of the independent generator."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from challenge import families, motion
from challenge.records import Recording, simulate
from challenge.truth import Base, drawn
from joint_records import columns, joint, prepared

from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit import refit as module
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import linearise
from hd_diag.diagnosis.fit.refit import FEW_STARTS, STARTS, distinct, nuisance, refit, usable
from hd_diag.diagnosis.record import Record, prepare
from hd_diag.diagnosis.search.causes import Search, parameters_of

CONFIGURED = joint().drive
RNG = np.random.default_rng(0)
MIRROR = fit_parameters.MIRRORED


def generated(seed: int) -> tuple[Record, Base]:
    """Two minutes at 100 Hz of a drive with wrong parameters, and the truth."""
    rng = families.generator("wrong_parameters", seed)
    made = simulate(drawn(rng), (), motion.standard(rng), rng, Recording(rate=100.0))
    bag = np.zeros(made.time.size, dtype=np.int64)
    columns = (made.time, made.input_angle, made.output_angle, made.torque, made.temperature)
    return prepare(*columns, bag, 100.0), made.base


def true_vector(truth: Base) -> np.ndarray:
    eccentricity, runout = truth.e * np.exp(1j * truth.psi), truth.runout * np.exp(1j * truth.runout_psi)
    numbers = [eccentricity.real, eccentricity.imag, runout.real, runout.imag, truth.datum]
    compliance = truth.compliance / CONFIGURED.mesh.tooth_compliance
    return np.array([*numbers, compliance, truth.cup]) / [scale.si for scale in fit_parameters.SCALES]


def away(point: np.ndarray, truth: Base) -> np.ndarray:
    """Difference from the truth, lobes swapped or not."""
    expected = true_vector(truth)
    return min((point - expected, point - MIRROR * expected), key=lambda x: float(np.hypot(*x[:2])))


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_parameters_are_recovered(seed: int) -> None:
    """The right minimum at once; within four standard deviations when the noise is known."""
    record, truth = generated(seed)
    found = refit(record, CONFIGURED, RNG)
    assert found.trustworthy
    assert np.all(np.abs(away(found.parameters, truth)) < [1.0, 1.0, 2.0, 1.0, 3.0, 2.0, 0.5])
    point, covariance = parameters_of(Search(settle(linearise(record, CONFIGURED, found.parameters), ()), ()))
    off = away(point, truth)
    assert np.all(np.abs(off) < 4.0 * np.sqrt(np.diag(covariance)))
    assert off @ np.linalg.solve(covariance, off) < 31.0  # chi-square, 7 degrees of freedom, 6e-5


def test_a_true_gap_is_left_out() -> None:
    record, _ = generated(3)
    kept = usable(record)
    assert 0.8 < kept.mean() < 1.0
    assert np.abs(record.torque[~kept]).max() < 1.0
    assert usable(dataclasses.replace(record, has_torque=False)).all()


def test_the_gap_of_the_real_torque_is_left_out_as_well() -> None:
    record, _ = generated(3)
    kept, shifted = usable(record), usable(record, 4.0)
    assert np.all(kept[shifted])
    left_out = record.torque[kept & ~shifted]
    assert left_out.size > 50
    assert np.all(np.abs(left_out + 4.0) < 1.0)


def test_terms_that_a_record_does_not_excite_are_left_out() -> None:
    record, _ = generated(3)
    assert nuisance(record, 100.0).shape[1] == 6
    one_speed = dataclasses.replace(record, speed=np.full(record.size, 30.0), temperature=None)
    small = dataclasses.replace(one_speed, input_angle=0.01 * record.input_angle)
    assert nuisance(one_speed, 100.0).shape[1] == 3
    assert nuisance(small, 100.0).shape[1] == 1


# Several minima ---

POINT = fit_parameters.vector(CONFIGURED, CONFIGURED) + np.array([8.0, -5.0, 2.0, 1.0, 6.0, 0.7, 2.0])
FAR = POINT + np.array([0.0, 12.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_mirrored_drives_are_the_same() -> None:
    assert len(distinct([POINT, POINT * MIRROR, POINT])) == 1
    found = distinct([FAR * MIRROR, POINT, FAR, POINT * MIRROR])
    assert [point.tolist() for point in found] == [(FAR * MIRROR).tolist(), POINT.tolist()]
    assert distinct([]) == []


@pytest.mark.parametrize("index", range(fit_parameters.COUNT))
def test_drives_that_are_near_are_the_same(index: int) -> None:
    """Nearer than a refinement of all rows moves them."""
    step = np.zeros(fit_parameters.COUNT)
    step[index] = module._NEAR[index]
    assert len(distinct([POINT, POINT + 0.9 * step, (POINT - 0.9 * step) * MIRROR])) == 1
    assert len(distinct([POINT, POINT + 1.1 * step])) == 2


@pytest.fixture(scope="module")
def short() -> Record:
    return prepared(columns(seconds=8.0))


Fit = Callable[[np.ndarray], tuple[np.ndarray, float]]


def stubbed(monkeypatch: pytest.MonkeyPatch, fit: Fit) -> list[tuple[int, int, np.ndarray]]:
    """Let a fit from a start end as told; the calls: samples, steps, start."""
    calls: list[tuple[int, int, np.ndarray]] = []

    def levenberg(problem: module._Problem, point: np.ndarray, steps: int) -> tuple[np.ndarray, float]:
        calls.append((problem.measured.size, steps, point))
        return fit(point)

    monkeypatch.setattr(module, "_levenberg", levenberg)
    return calls


def test_rounds_go_on_with_the_best_that_differ(short: Record, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits that go nowhere: the starts nearest to a point survive, none of them twice or mirrored."""
    near = POINT * MIRROR

    def distance(point: np.ndarray) -> tuple[np.ndarray, float]:
        return point, 1e3 + float(np.hypot(*(point - near)[:2]))

    calls = stubbed(monkeypatch, distance)
    found = refit(short, CONFIGURED, RNG, start=near)
    sizes = [size for size, _, _ in calls]
    assert sizes == sorted(sizes)
    assert [sizes.count(size) for size in sorted(set(sizes))] == [len(STARTS) + 2, 5, 2]
    for size in set(sizes) - {min(sizes)}:
        starts = [point for rows, _, point in calls if rows == size]
        assert len(distinct(starts)) == len(starts)
        assert starts[0] is near
        assert [distance(p)[1] for p in starts] == sorted(distance(p)[1] for p in starts)
    np.testing.assert_allclose(found.parameters, near, rtol=1e-12)


def test_starts_far_worse_than_the_best_are_not_followed(
    short: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = stubbed(monkeypatch, lambda point: (point, 1e3 if point is POINT else 2.1e3))
    refit(short, CONFIGURED, RNG, start=POINT)
    sizes = [size for size, _, _ in calls]
    assert [sizes.count(size) for size in sorted(set(sizes))] == [len(STARTS) + 2, 1, 1]


@pytest.mark.parametrize(
    ("other", "worse", "trustworthy"),
    [
        (FAR, 5.0, False),
        (FAR, 11.9, False),
        (FAR, 12.1, True),
        (POINT * MIRROR, 0.0, True),
        (POINT + 0.01, 0.0, True),
    ],
)
def test_trust_is_lost_to_another_minimum_as_good(
    other: np.ndarray, worse: float, trustworthy: bool, short: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Starts to one side end in one minimum, all others in another."""

    def fit(point: np.ndarray) -> tuple[np.ndarray, float]:
        return (other, 1000.0 + worse) if point[1] > 1.0 else (POINT, 1000.0)

    stubbed(monkeypatch, fit)
    found = refit(short, CONFIGURED, RNG)
    assert found.trustworthy is trustworthy
    assert len(distinct([POINT, found.parameters])) == 1


def test_starts_of_either_lobe_end_in_the_same_drive() -> None:
    """A start of our own, and the same drive said the other way round."""
    record = prepared(columns(seconds=8.0))
    true = fit_parameters.vector(
        joint(eccentricity__magnitude=12e-6, eccentricity__direction=0.6).drive, CONFIGURED
    )
    found = [refit(record, CONFIGURED, RNG, start=p, starts=FEW_STARTS[:1]) for p in (true, true * MIRROR)]
    assert len(distinct([one.parameters for one in found] + [true])) == 1
    assert [one.trustworthy for one in found] == [True, True]
