"""Measured noise: right for any colour, tails, encoder counts and misfit."""

import dataclasses

import numpy as np
import pytest
from benches import CONFIGURED, POINT, swinging
from challenge import noise
from joint_records import ARCSEC, RATIO
from numpy.testing import assert_array_equal
from scipy.linalg import toeplitz

from hd_diag.diagnosis import measured_noise as module
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.diagnosis.measured_noise import MeasuredNoise, Revisits, measured_covariance, measured_noise
from hd_diag.diagnosis.noise import ORDER, whitening_of


@pytest.fixture(scope="module")
def plain() -> LinearisedFit:
    return linearise(swinging(60.0), CONFIGURED, POINT)


def misfit(fit: LinearisedFit) -> np.ndarray:
    """Misfit of twice the noise [rad]: load-dependent friction and a ripple on one flank."""
    s = fit.signals
    friction = np.tanh(s.speed / 3.0) * (4.0 + 0.1 * np.abs(s.torque))
    return ARCSEC * (friction + 5.0 * np.cos(2.0 * s.wave_generator_angle) * (s.torque > 0.0))


@pytest.mark.parametrize("family", noise.FAMILIES)
@pytest.mark.parametrize("wrong", [0.0, 1.0, 3.0])
def test_noise_of_any_colour_beside_any_misfit(plain: LinearisedFit, family: str, wrong: float) -> None:
    own = noise.FAMILIES[family](np.random.default_rng(3), plain.residual.size)
    found = plain.data.noise_of(own + wrong * misfit(plain))
    assert found.repeated
    assert found.rms == pytest.approx(float(own.std()), rel=0.1)
    assert found.low <= found.rms <= found.high < 1.4 * found.low  # ±6 % in addition to its scatter


@pytest.mark.parametrize(("output_bits", "input_bits"), [(19, 17), (17, 12), (15, 14), (12, 19)])
def test_counts_of_encoders(plain: LinearisedFit, output_bits: int, input_bits: int) -> None:
    steps = 2.0 * np.pi / 2.0**output_bits, 2.0 * np.pi / 2.0**input_bits
    record = plain.data.record
    angles = zip(("output_angle", "input_angle"), steps, strict=True)
    rounded = {name: step * np.rint(getattr(record, name) / step) for name, step in angles}
    counted = dataclasses.replace(record, **rounded)
    assert module.count_steps(counted, RATIO) == pytest.approx(
        (steps[1] / RATIO, steps[0]), rel=0.05, abs=5e-7
    )
    assert module.count_steps(record, RATIO) == (0.0, 0.0)
    rounding = np.hypot(steps[0], steps[1] / RATIO) / np.sqrt(12.0)
    assert linearise(counted, CONFIGURED, POINT).data.counted == pytest.approx(float(rounding), rel=0.05)


@pytest.mark.parametrize("family", noise.FAMILIES)
def test_a_motion_that_never_comes_back_tells_bounds(family: str) -> None:
    """The lower bound is white noise; the upper one excludes slow misfit as large as the noise."""
    time = np.arange(0.0, 60.0, 2e-3)
    own = noise.FAMILIES[family](np.random.default_rng(0), time.size)
    slow = float(own.std()) * np.sqrt(2.0) * np.cos(0.1 * np.pi * time)
    found: MeasuredNoise = measured_noise(own + slow, time, np.zeros(time.size, np.int64), module.NEVER, 0.0)
    assert not found.repeated
    assert found.low < found.rms == pytest.approx(noise.WHITE, rel=0.2)
    assert found.high == pytest.approx(float(own.std()), rel=0.25)


def test_what_an_unmeasured_torque_does_is_no_noise() -> None:
    record = dataclasses.replace(swinging(60.0), has_torque=False)
    fit = linearise(record, CONFIGURED, POINT)
    own = noise.autoregressive(np.random.default_rng(3), fit.residual.size)
    found = fit.data.noise_of(own + 1e-5 * fit.signals.torque)
    assert not found.repeated
    assert found.rms == pytest.approx(noise.WHITE, rel=0.1)


def test_misfit_that_changes_at_once_leaves_covariances_that_noise_can_have() -> None:
    """Misfit of three times the noise, different in every pass and short-lived: the noise stays white."""
    rng, count = np.random.default_rng(4), 40_000
    quick = np.convolve(rng.standard_normal(count + 4), np.full(5, 5.0**-0.5), "valid")
    residual = ARCSEC * (2.0 * rng.standard_normal(count) + 6.0 * quick)
    first = rng.integers(0, count // 2, 8000)
    passed = Revisits(first, first + count // 2 - 100, np.zeros((first.size, 1)))
    noise = MeasuredNoise(2.0 * ARCSEC, 1.9 * ARCSEC, 2.1 * ARCSEC, True)
    found = measured_covariance(residual, np.zeros(count, dtype=np.int64), passed, noise) / noise.rms**2
    assert found[0] == pytest.approx(1.0)
    assert np.abs(found[1:]).max() < 0.3
    assert np.linalg.eigvalsh(toeplitz(found))[0] > 0.2


@pytest.mark.parametrize(("off", "vague"), [(0.0, False), (20.0, True)])
def test_where_passes_disagree_the_noise_is_vague(off: float, vague: bool) -> None:
    """One second is off, by misfit or slow noise: the noise lies between neighbours' scatter and that."""
    rng, size = np.random.default_rng(0), 4000
    time, residual = np.arange(size) / 200.0, rng.standard_normal(size)
    residual[:200] += off
    first, second = rng.integers(0, size, (2, 3000))
    passed = Revisits(first, second, rng.random((3000, 3)))
    noise = measured_noise(residual, time, np.zeros(size, np.int64), passed, 0.0)
    assert noise.vague is vague
    assert 0.8 < noise.low < (2.5 if vague else 1.0)
    assert (noise.high > 4.0) is vague


def test_passes_too_short_for_a_colour_say_white() -> None:
    run = np.arange(600, dtype=np.int64) // 15
    passed = Revisits(np.arange(0, 500), np.arange(90, 590), np.zeros((500, 1)))
    found = measured_covariance(np.sin(np.arange(600.0)), run, passed, MeasuredNoise(2.0, 1.9, 2.1, True))
    assert_array_equal(found, [4.0, *[0.0] * ORDER])


def test_what_all_rows_show_of_the_noise_is_known_on_some(plain: LinearisedFit) -> None:
    """A tenth of the rows hardly repeats a state: alone these rows take the misfit for noise."""
    own = ARCSEC * np.random.default_rng(4).standard_normal(plain.residual.size)
    measured = own + misfit(plain)
    known = plain.data.passes(measured)
    assert known.rms == pytest.approx(ARCSEC, rel=0.1)
    few = plain.data.at[: plain.data.at.size // 10]
    some = np.isin(np.arange(plain.data.mask.size), few)
    part = measured[: few.size]
    assert plain.data.on(some).passes(part) is None
    told = dataclasses.replace(plain.data, known=known).on(some)
    assert told.passes(part) is known
    assert told.whitening_of(part, np.empty((part.size, 0))).scale == whitening_of(known.covariance).scale
    # A better fit updates the noise; a worse fit leaves it unchanged.
    assert dataclasses.replace(plain.data, known=known).passes(own + 3.0 * misfit(plain)) is known
    better = dataclasses.replace(plain.data, known=known._replace(rms=2.0 * known.rms)).passes(measured)
    assert better.rms == known.rms
