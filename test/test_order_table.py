"""Waves that no cause explains as table rows: integer orders, frames, phases that repeat."""

from dataclasses import replace

import numpy as np
import pytest

from hd_diag.diagnosis.evidence.order_table import order_table, part, refitted_rows
from hd_diag.diagnosis.evidence.unexplained import waves
from hd_diag.diagnosis.evidence.waves import Remainder

ARCSEC = np.pi / 648000.0
RATED = 60.0


def remainder(seed: int = 0, turns: float = 0.7, ratio: float = 100.0, **extra: float) -> Remainder:
    """A joint moving to and fro over part of an output turn without its rests, with white noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 60.0, 0.005)
    angle = ratio * np.pi * turns * np.sin(2.0 * np.pi * time / 12.0)
    torque = 30.0 * np.sin(2.0 * np.pi * time / 7.0)
    noise = ARCSEC * rng.standard_normal(time.size)
    run = (time // 6.0).astype(np.int64)
    block = (np.arange(time.size) * 24 // time.size).astype(np.int64)
    speed = np.gradient(angle, time)
    return Remainder(time, angle, torque, speed, noise, np.ones((time.size, 1)), run, block, ratio)


def added(rest: Remainder, wave: np.ndarray) -> Remainder:
    return replace(rest, residual=rest.residual + wave)


@pytest.mark.parametrize(
    ("order", "frame", "might_be"),
    [
        (2.0, "input", "circular_spline_pitch"),
        (16.0, "input", "encoder_interpolation"),
        (128.0, "output", "output_encoder_interpolation"),
        (202.0, "output", "flexspline_pitch"),
        (0.4567, "input", "bearing_passage"),
    ],
)
def test_an_order_is_recognised_in_its_frame(order: float, frame: str, might_be: str) -> None:
    """Over 0.7 output turns a spectrum resolves only 1.4 orders; a fit of the wave resolves more."""
    rest = remainder()
    per_input = order / (100.0 if frame == "output" else 1.0)
    made = added(rest, 3.0 * ARCSEC * np.cos(per_input * rest.input_angle - 1.0))
    (row,) = order_table(made, waves(made), RATED)
    assert (row.frame, row.repeats) == (frame, True)
    assert row.order == pytest.approx(order, abs=0.0 if order == round(order) else 2e-3)
    assert row.amplitude == pytest.approx(3.0 * ARCSEC, rel=0.05)
    assert row.phase == pytest.approx(1.0, abs=0.1)
    assert might_be in row.might_be
    rest_after = made.residual - part((row,), made.input_angle, made.torque, RATED)
    assert np.std(rest_after) == pytest.approx(np.std(rest.residual), rel=0.01)


def test_a_wave_that_grows_with_torque() -> None:
    rest = remainder()
    made = added(rest, 6.0 * ARCSEC * rest.torque / RATED * np.cos(2.0 * rest.input_angle - 2.0))
    (row,) = order_table(made, waves(made), RATED)
    assert (row.order, row.frame, row.nonlinear[1]) == (2.0, "input", 1.0)
    assert row.amplitude == pytest.approx(6.0 * ARCSEC, rel=0.1)


def test_a_phase_that_changes_from_run_to_run_does_not_repeat() -> None:
    rest = remainder()
    assert order_table(rest, waves(rest), RATED) == ()  # noise
    phase = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, 20)[rest.run]
    made = added(rest, 6.0 * ARCSEC * np.cos(1.5 * rest.input_angle - phase))
    rows = order_table(made, waves(made), RATED)
    assert all(not row.repeats for row in rows)
    assert not part(rows, made.input_angle, made.torque, RATED).any()


@pytest.mark.parametrize("repeats", [False, True])
def test_other_rows_do_not_change_whether_a_wave_repeats(repeats: bool) -> None:
    """A wave without a steady phase in its own rows has no held-out gain and must not come back."""
    rest = remainder()
    steady = added(rest, 6.0 * ARCSEC * np.cos(1.5 * rest.input_angle - 1.0))
    phase = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, 20)[rest.run]
    other = added(rest, 6.0 * ARCSEC * np.cos(1.5 * rest.input_angle - phase)) if repeats else steady
    rows = [replace(row, repeats=repeats) for row in order_table(steady, waves(steady), RATED)]
    assert [row.repeats for row in refitted_rows(other, rows, RATED)] == [repeats]


@pytest.mark.parametrize(
    ("order", "known", "function"), [(2.0, True, True), (2.0, False, False), (3.0, True, False)]
)
def test_a_line_that_is_a_function_is_not_added_again(order: float, known: bool, function: bool) -> None:
    rest = remainder()
    made = added(rest, 5.0 * ARCSEC * np.cos(order * rest.input_angle - 1.0))
    made = replace(made, lines=(order,) if known else ())
    (row,) = order_table(made, waves(made), RATED)
    assert (row.order, row.repeats, row.is_function, row.in_model) == (order, True, function, not function)
    assert part((row,), made.input_angle, made.torque, RATED).any() is np.bool_(not function)
    (again,) = refitted_rows(made, (row,), RATED)
    assert again.is_function is function
