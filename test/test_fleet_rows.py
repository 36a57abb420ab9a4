"""A row of the fleet's table: deviations of the amplitudes, for causes of every kind."""

import numpy as np
import pytest
from benches import EFFECTS, bench, of
from test_verdict import SKIP, diagnosis

from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.search.causes import causes
from hd_diag.fleet.rows import amplitude_std, judged

ENCODER, HYSTERESIS, BEARING = (
    EFFECTS[name] for name in ("input_encoder_eccentricity", "hysteresis", "bearing_passage")
)


def test_a_finding_about_the_signals_is_no_cause() -> None:
    """Causes, amplitudes and their deviations are as many."""
    found = diagnosis(findings=(Finding("clock_set_back", "the clock was set back", 1.0, "-", False), SKIP))
    row = judged(found, "joint_1")
    assert row["causes"] == ["tooth_skip"]
    assert len(row["cause_amplitudes_rad"]) == len(row["cause_amplitude_stds_rad"]) == 1
    assert len(row["findings"]) == 2


def test_the_deviation_of_an_amplitude_is_that_of_drawn_coefficients() -> None:
    """Of a cause without nonlinear values, of one with them, and of one with columns that wander."""
    made = bench(of(ENCODER, amplitude=1e-3, direction=0.5, second_amplitude=0.0, second_direction=0.0))
    chosen = tuple((effect, tuple(made.data.grid(effect)[-1])) for effect in (ENCODER, HYSTERESIS, BEARING))
    rng = np.random.default_rng(0)
    found = causes(made, chosen, {}, (), rng)
    assert {cause.covariance.shape[0] > cause.coefficients.size for cause in found} == {False, True}
    for cause in found:
        own = slice(cause.coefficients.size)
        columns = made.columns(cause.effect, cause.nonlinear)[:, own]
        big = 1e3 * cause.coefficients  # far from zero, where the first order holds
        drawn = rng.multivariate_normal(big, cause.covariance[own, own], 1000)
        expected = np.std(np.std(columns @ drawn.T, axis=0))
        assert amplitude_std(made, cause) == pytest.approx(expected, rel=0.15), cause.effect.name
