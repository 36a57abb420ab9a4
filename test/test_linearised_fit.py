"""The bench of a fit: later stages see what earlier ones add, and memory goes through every row."""

import dataclasses

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, POINT, bench, of, swinging
from joint_records import RATIO
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.diagnosis.fit.joint_refinement import polished
from hd_diag.diagnosis.fit.linearised_fit import Workbench, settle
from hd_diag.diagnosis.fit.refit import refit, usable
from hd_diag.diagnosis.record import Record
from hd_diag.extended_model import ExtendedModel, Range, Ranges, Term

PITCH, DELAY = EFFECTS["circular_spline_pitch"], EFFECTS["stream_delay"]
RESONANCE, HYSTERESIS = EFFECTS["resonance"], EFFECTS["hysteresis"]
PITCH_AT = PITCH.from_physical(
    {"pitch_2": 1.2e-6, "pitch_direction_2": 0.4, "pitch_4": 0.0, "pitch_direction_4": 0.0}
)[0]
SPRING = (2.0, 60.0, 0.05)
ALL = Ranges(Range(-60.0, 60.0), Range(-200.0, 200.0))


def recorded(*terms: Term) -> Record:
    """A joint with effects that act on each other, as the model that runs has them."""
    record = swinging()
    base_only = ExtendedModel(Workbench(record, CONFIGURED, POINT).drive, (), 0.0, ALL)
    model = dataclasses.replace(base_only, effects=terms)
    run = (record.time, record.input_angle, None, record.torque)
    change = model.step(model.start(), *run)[0] - base_only.step(base_only.start(), *run)[0]
    return dataclasses.replace(record, output_angle=record.output_angle + change)


def left(record: Record, *chosen: tuple) -> np.ndarray:
    """Standard deviation of what the settled bench leaves [arcsec], and its parameters."""
    made = settle(Workbench(record, CONFIGURED, POINT), chosen, rounds=4)
    made, chosen = polished(made, chosen)
    return np.std(made.remainder(chosen)) * 206265.0, made


def test_a_delay_of_tooth_errors_is_one_delay() -> None:
    """Both together leave the noise; sizes come back although the stream shows the pitch late as well."""
    truth = Term(PITCH, tuple(PITCH_AT), ()), Term(DELAY, (2e-3,), ())
    rest, made = left(recorded(*truth), (PITCH, ()), (DELAY, ()))
    assert rest == pytest.approx(2.0, abs=0.1)
    beta = made.fit(((PITCH, ()), (DELAY, ())))[0]
    places = made.places(((PITCH, ()), (DELAY, ())))
    assert beta[places[1]][0] == pytest.approx(2e-3, rel=0.01)
    assert np.hypot(*beta[places[0]][:2]) == pytest.approx(1.2e-6, rel=0.05)


def test_a_spring_carries_tooth_errors_and_the_model_s_own_parameters() -> None:
    truth = Term(PITCH, tuple(PITCH_AT), ()), Term(RESONANCE, (0.0, 0.0, 1.0), SPRING)
    chosen = ((PITCH, ()), (RESONANCE, SPRING))
    rest, made = left(recorded(*truth), *chosen)
    assert rest == pytest.approx(2.0, abs=0.25)
    sized = made.fit(chosen)[0][made.places(chosen)[1]]
    assert sized[2] == pytest.approx(1.0, abs=0.05)
    # Derivatives of the model pass the spring too: against a difference of benches a step apart.
    static, step = made.moved(made.parameters).jacobian[:, 0], np.array([0.2, *np.zeros(6)])
    sized = [((RESONANCE, SPRING), np.array([0.0, 0.0, 1.0]))]
    ends = []
    for sign in (-1.0, 1.0):
        other = made.moved(made.parameters + sign * step)
        other.see(sized)
        ends.append(other.error + other.full_size(RESONANCE, SPRING, sized[0][1]))
    made.see(sized)
    expected = (ends[1] - ends[0]) / 0.4
    assert np.std(made.jacobian[:, 0] - expected) < 0.3 * np.std(static - expected)


def test_what_is_not_chosen_any_more_is_not_seen() -> None:
    made = bench(of(DELAY, delay=1e-3))
    plain, jacobian = made.columns(DELAY, ()).copy(), made.jacobian.copy()
    made.see([((PITCH, ()), PITCH_AT), ((DELAY, ()), np.array([1e-3]))])
    assert np.std(made.columns(DELAY, ()) - plain) > 1e-3 * np.std(plain)
    assert np.std(made.jacobian - jacobian) > 0.0
    made.see([])
    assert_array_equal(made.columns(DELAY, ()), plain)
    assert_array_equal(made.jacobian, jacobian)


def test_memory_goes_through_rows_that_are_not_fitted() -> None:
    record = swinging()
    rows = np.arange(record.size) * 10 // record.size % 3 != 1
    made = Workbench(record, CONFIGURED, POINT, rows=rows)
    every = Workbench(record, CONFIGURED, POINT)
    fitted = rows & usable(record)
    assert made.record.size == np.count_nonzero(fitted) < every.record.size
    inside = fitted[usable(record)]
    for effect, nonlinear in ((HYSTERESIS, (3.0, 9.0)), (RESONANCE, SPRING)):
        assert_array_equal(made.columns(effect, nonlinear), every.columns(effect, nonlinear)[inside])
    assert_allclose(made.left, every.left[inside], atol=1e-12)
    assert made.left.std() * RATIO > 0.0


def test_a_wrong_zero_of_the_torque_is_found_at_full_size() -> None:
    """Between both zeros the teeth bear on other flanks: no slope at the reported torque tells that."""
    offset = EFFECTS["torque_offset"]
    shifted = recorded(Term(offset, (2.5,), ()))
    made, chosen = settle(Workbench(shifted, CONFIGURED, POINT), ((offset, ()),)), ((offset, ()),)
    for _ in range(6):
        made.correct(chosen)
    beta = made.fit(chosen)[0]
    assert beta[made.places(chosen)[0]][0] == pytest.approx(2.5, abs=0.05)
    found = refit(shifted, CONFIGURED).parameters
    assert min(np.abs(found[:2] - POINT[:2]).max(), np.abs(found[:2] + POINT[:2]).max()) < 1.0


def test_rows_near_the_real_zero_of_the_torque_are_left_out() -> None:
    made = bench()
    clear = made.clear_of(2.5)
    assert_array_equal(clear.rows, usable(made.source, 2.5))
    assert 0 < made.record.size - clear.record.size < 0.1 * made.record.size
    assert clear.whiten is made.whiten
    assert_array_equal(clear.left, made.left[clear.rows[made.rows]])
    assert made.clear_of(0.0) is made


def test_amplitude_of_another_torque_is_that_along_the_whole_record() -> None:
    """Those rows too that no fit uses; of other effects where they are fitted."""
    offset, size = EFFECTS["torque_offset"], np.array([2.0])
    friction, both = EFFECTS["viscous_windup"], np.array([1e-7])
    rows = np.arange(swinging().size) % 7 > 2
    every = Workbench(swinging(), CONFIGURED, POINT)
    few = Workbench(swinging(), CONFIGURED, POINT, rows=rows)
    expected = float(np.std(offset.response(every.whole, size, ())))
    assert few.amplitude(offset, (), size) == pytest.approx(expected, rel=1e-12)
    assert few.amplitude(friction, (), both) == np.std(friction.response(few.signals, both, ()))
    assert few.amplitude(friction, (), both) != every.amplitude(friction, (), both)


def test_back_at_known_parameters_nothing_is_computed_again() -> None:
    made = bench()
    away = made.moved(POINT + 0.5)
    again = away.moved(made.parameters)
    assert again.whole is made.whole
    assert_array_equal(again.jacobian, made.jacobian)
    assert away.whole is not made.whole
    afresh = Workbench(made.source, CONFIGURED, POINT + 0.5, made.whiten, made.rows)
    assert_array_equal(afresh.left, away.left)
    for _ in range(4):
        away = away.moved(away.parameters + 0.1)
    assert away.moved(made.parameters).whole is not made.whole  # only the latest are kept


def test_columns_of_teeth_are_the_same_when_carried_again() -> None:
    """What is kept of them does not depend on what carries them."""
    made, other = bench(), bench()
    for damping in (0.1, 0.05):
        made.see([((RESONANCE, (2.0, 60.0, damping)), np.array([0.0, 0.0, 1.0]))])
        found = made.columns(PITCH, ())
    other.see([((RESONANCE, SPRING), np.array([0.0, 0.0, 1.0]))])
    assert_array_equal(found, other.columns(PITCH, ()))
    other.see([])
    assert np.abs(found - other.columns(PITCH, ())).max() > 0.0


def test_columns_that_hold_at_a_size_outlast_the_store(monkeypatch: pytest.MonkeyPatch) -> None:
    """However little is kept, what the model leaves and the columns beside it belong together."""
    offset, wide = ((EFFECTS["torque_offset"], ()),), []
    for room in (1 << 30, 0):
        monkeypatch.setattr("hd_diag.diagnosis.fit.linearised_fit._MOST_COLUMNS", room)
        made = Workbench(recorded(Term(EFFECTS["torque_offset"], (2.0,), ())), CONFIGURED, POINT)
        made.correct(offset)
        made.correct(offset)
        for other in ("viscous_windup", "coulomb_windup"):
            made.white(EFFECTS[other], made.grid(EFFECTS[other])[0])
        wide.append((made.design(offset).deviance(), made.fit(offset)[0][-1]))
    assert wide[0] == wide[1]
    made.correct(())
    assert np.std(made.columns(*offset[0]) - made.signals.predicted_torque_slope[:, None]) == 0.0
