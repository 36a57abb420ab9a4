"""The linearised fit: later stages see what earlier ones add, and memory passes through every row."""

import dataclasses

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, POINT, bench, chosen_set, of, swinging
from joint_records import ARCSEC, RATIO
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.diagnosis.evidence.unmodelled_terms import UNMODELLED_TERMS
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.joint_refinement import polished, settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit, linearise
from hd_diag.diagnosis.fit.present_effects import plain as goes_along
from hd_diag.diagnosis.fit.refit import refit, usable
from hd_diag.diagnosis.record import Record
from hd_diag.drive import transmission_error
from hd_diag.extended_model import ExtendedModel, Range, Ranges, Term

PITCH, DELAY = EFFECTS["circular_spline_pitch"], EFFECTS["stream_delay"]
RESONANCE, HYSTERESIS = EFFECTS["resonance"], EFFECTS["hysteresis"]
(CREEP,) = (term for term in UNMODELLED_TERMS if term.name == "creep")
PITCHES = {quantity.name: 0.0 for quantity in PITCH.quantities}
PITCH_AT = PITCH.from_physical(PITCHES | {"pitch_2": 1.2e-6, "pitch_direction_2": 0.4})[0]
SPRING = (2.0, 60.0, 0.05)
CARRYING = (((RESONANCE, SPRING), np.array([0.0, 0.0, 1.0])),)
ALL = Ranges(Range(-60.0, 60.0), Range(-200.0, 200.0))


def recorded(*terms: Term) -> Record:
    """A joint with interacting effects, as the running model has them."""
    record = swinging()
    base_only = ExtendedModel(linearise(record, CONFIGURED, POINT).drive, (), 0.0, ALL)
    model = dataclasses.replace(base_only, effects=terms)
    run = (record.time, record.input_angle, None, record.torque)
    change = model.step(model.start(), *run)[0] - base_only.step(base_only.start(), *run)[0]
    return dataclasses.replace(record, output_angle=record.output_angle + change)


def left(record: Record, *chosen: tuple) -> tuple[float, LinearisedFit, list[np.ndarray]]:
    made = settle(linearise(record, CONFIGURED, POINT), chosen, rounds=4)
    made, chosen = polished(made, chosen)
    return float(np.std(made.remainder(chosen))) / ARCSEC, made, sizes(made, chosen)


def sizes(made: LinearisedFit, chosen: Chosen) -> list[np.ndarray]:
    return [made.fit(chosen)[0][place] for place in made.places(chosen)]


def test_a_delay_of_tooth_errors_is_one_delay() -> None:
    truth = Term(PITCH, tuple(PITCH_AT), ()), Term(DELAY, (2e-3,), ())
    rest, _, (pitch, delay) = left(recorded(*truth), (PITCH, ()), (DELAY, ()))
    assert rest == pytest.approx(2.0, abs=0.1)
    assert delay[0] == pytest.approx(2e-3, rel=0.01)
    assert np.hypot(*pitch[2:4]) == pytest.approx(1.2e-6, rel=0.05)


def test_a_spring_carries_tooth_errors_and_the_model_s_own_parameters() -> None:
    truth = Term(PITCH, tuple(PITCH_AT), ()), Term(RESONANCE, (0.0, 0.0, 1.0), SPRING)
    rest, made, (_, spring) = left(recorded(*truth), (PITCH, ()), (RESONANCE, SPRING))
    assert rest == pytest.approx(2.0, abs=0.25)
    assert spring[2] == pytest.approx(1.0, abs=0.05)
    # Derivatives of the model pass the spring too; checked against a difference of two fits.
    static, step = made.moved(made.parameters).jacobian[:, 0], np.array([0.2, *np.zeros(6)])
    ends = []
    for sign in (-1.0, 1.0):
        other = made.moved(made.parameters + sign * step).beside(CARRYING)
        ends.append(other.signals.predicted + other.effects.full_size(RESONANCE, SPRING, CARRYING[0][1]))
    expected = (ends[1] - ends[0]) / 0.4
    assert np.std(made.beside(CARRYING).jacobian[:, 0] - expected) < 0.3 * np.std(static - expected)


@pytest.fixture(scope="module")
def plain() -> LinearisedFit:
    return bench()


def test_effects_beside_a_fit_are_seen_and_the_fit_itself_never_changes() -> None:
    made = bench(of(DELAY, delay=1e-3))
    kept = [one.copy() for one in (made.columns(DELAY, ()), made.jacobian, made.residual)]
    both = made.beside((((PITCH, ()), PITCH_AT), ((DELAY, ()), np.array([1e-3]))))
    assert np.std(both.columns(DELAY, ()) - kept[0]) > 1e-3 * np.std(kept[0])
    assert np.std(both.jacobian - kept[1]) > 0.0
    assert np.std(both.residual - kept[2]) > 0.0
    for one in (made, both.beside(())):
        for now, before in zip((one.columns(DELAY, ()), one.jacobian, one.residual), kept, strict=True):
            assert_array_equal(now, before)
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.parameters = POINT  # type: ignore[misc]


def test_memory_goes_through_rows_that_are_not_fitted() -> None:
    record = swinging()
    rows = np.arange(record.size) * 10 // record.size % 3 != 1
    made, every = (linearise(record, CONFIGURED, POINT, rows=some) for some in (rows, None))
    fitted = rows & usable(record)
    assert made.data.record.size == np.count_nonzero(fitted) < every.data.record.size
    inside = fitted[usable(record)]
    for effect, nonlinear in ((HYSTERESIS, (9.0, 1.6, 2.0, 1.5)), (RESONANCE, SPRING)):
        assert_array_equal(made.columns(effect, nonlinear), every.columns(effect, nonlinear)[inside])
    assert_allclose(made.columns(CREEP, ()), every.columns(CREEP, ())[inside], rtol=1e-9)
    assert_allclose(made.residual, every.residual[inside], atol=1e-12)
    assert made.residual.std() * RATIO > 0.0


def test_a_wrong_zero_of_the_torque_is_found_at_full_size() -> None:
    offset = EFFECTS["torque_offset"]
    shifted = recorded(Term(offset, (2.5,), ()))
    made, chosen = settle(linearise(shifted, CONFIGURED, POINT), ((offset, ()),)), ((offset, ()),)
    for _ in range(6):
        made = made.corrected(chosen)
    assert sizes(made, chosen)[0][0] == pytest.approx(2.5, abs=0.05)
    found = refit(shifted, CONFIGURED, np.random.default_rng(0)).parameters
    assert min(np.abs(found[:2] - POINT[:2]).max(), np.abs(found[:2] + POINT[:2]).max()) < 1.0


def pushed() -> LinearisedFit:
    """A spring of negative compliance would cancel torsion; candidates and held-out blocks exclude it."""
    record = swinging()
    softer = dataclasses.replace(record, output_angle=record.output_angle + 1.5 * ARCSEC * record.torque)
    return settle(linearise(softer, CONFIGURED, POINT), ())


def test_what_no_drive_can_have_explains_nothing() -> None:
    made = pushed()
    beta, _, _ = made.fit(())
    left, built = made.whiten(made.remainder(()), made.data.run), made.design(())
    held, _ = made.on_bounds(())
    assert 6 in held
    assert made.parameters[6] + beta[6] == pytest.approx(0.0, abs=1e-9)
    center, width = fit_parameters.prior(CONFIGURED)
    free = np.setdiff1d(np.arange(7), held)
    away = np.sum(((made.parameters + beta[:7] - center) / width)[free] ** 2)
    expected = float(left @ left) + away
    assert built.deviance() == pytest.approx(expected, rel=1e-6)
    assert built.held_out().sum() == pytest.approx(expected, rel=0.05)
    unbounded = np.linalg.lstsq(made.always_white, made.residual_white, rcond=None)[1][0]
    assert expected > 1.2 * unbounded


def test_evidence_is_of_drives_that_can_be() -> None:
    """The gain of an impossible spring counts for no set; otherwise a true cause would gain nothing."""
    made = pushed()
    held = made.on_bounds(())[0]
    bound = dataclasses.replace(made.moved(made.parameters + made.fit(())[0][:7]), held=tuple(held))
    free, fixed = (chosen_set(one).valued().value for one in (made, bound))
    assert free == pytest.approx(fixed, abs=5.0)


def test_rows_near_the_real_zero_of_the_torque_are_left_out(plain: LinearisedFit) -> None:
    made, clear = plain, plain.clear_of(np.full(plain.data.source.size, 2.5))
    assert_array_equal(clear.data.mask, usable(made.data.source, 2.5))
    assert 0 < made.data.record.size - clear.data.record.size < 0.1 * made.data.record.size
    assert clear.whiten is made.whiten
    assert_array_equal(clear.residual, made.residual[clear.data.mask[made.data.mask]])
    assert made.clear_of(np.zeros(made.data.source.size)) is made


def test_rows_are_certain_only_where_the_torque_is_whichever_law_a_friction_has(plain: LinearisedFit) -> None:
    offset, friction = (EFFECTS["torque_offset"], ()), (EFFECTS["viscous_windup"], (1.0,))
    sized = ((offset, np.array([3.0])), (friction, np.array([2.0])))
    ways = plain.effects.possible_torques(sized)
    alone = [plain.effects.torque((one,)) for one in sized]
    assert_allclose(ways, np.column_stack((sum(alone), *alone[::-1])), atol=1e-12)
    assert_allclose(plain.effects.possible_torques(()), np.zeros((plain.data.source.size, 1)))


def test_part_of_another_torque_is_that_along_the_whole_record() -> None:
    offset, size = EFFECTS["torque_offset"], np.array([2.0])
    drift, both = EFFECTS["output_runout"], np.array([1e-5, 0.0])
    rows = np.arange(swinging().size) % 7 > 2
    few, every = (linearise(swinging(), CONFIGURED, POINT, rows=some) for some in (rows, None))
    expected = float(np.std(offset.response(every.whole, size, ())))
    # `part` uses nodes along the record, `response` a map: they differ by 6e-4.
    assert np.std(few.part(offset, (), size)) == pytest.approx(expected, rel=1e-3)
    assert_array_equal(few.part(drift, (), both), drift.response(few.signals, both, ()))
    assert few.part(drift, (), both).size < every.part(drift, (), both).size


def test_torques_of_several_causes_are_found_together() -> None:
    """The torques interact through the mesh; fitted alone, each would leave part of the other."""
    causes = Term(EFFECTS["torque_offset"], (2.5,), ()), Term(EFFECTS["viscous_windup"], (3.0,), (0.8,))
    both = recorded(*causes)
    chosen: Chosen = tuple((term.effect, term.nonlinear) for term in causes)
    made = settle(linearise(both, CONFIGURED, POINT), chosen)
    for _ in range(4):
        made = made.corrected(chosen)
    beta = made.fit(chosen)[0]
    sizes = [float(beta[place][0]) for place in made.places(chosen)]
    assert sizes == pytest.approx([2.5, 3.0], abs=0.05)
    together, plain = made.effects.together(made.present), linearise(both, CONFIGURED, POINT)
    apart = sum(plain.effects.full_size(*item, one) for item, one in made.present)
    assert np.std(together - apart) > 1e-3 * np.std(together)
    under = transmission_error(made.drive, both.input_angle, both.torque + made.effects.torque(made.present))
    expected = (under - transmission_error(made.drive, both.input_angle, both.torque))[made.data.mask]
    assert np.std(together - expected) < 0.05 * ARCSEC


def test_what_is_behind_the_torque_sees_what_the_mesh_bears() -> None:
    """Elements slip by the torque in the mesh, friction included, not by the sensor's torque."""
    record = swinging()
    borne = record.torque + 8.0 * np.gradient(record.input_angle, record.time) / RATIO
    slips, state = [], 0.0
    for change in np.diff(borne, prepend=borne[0]).tolist():
        state = min(max(state + change / 4.0, -1.0), 1.0)
        slips.append(20.0 * ARCSEC * state)
    drive = linearise(record, CONFIGURED, POINT).drive
    unloaded = transmission_error(drive, record.input_angle, record.torque)
    error = transmission_error(drive, record.input_angle, borne) - unloaded
    both = dataclasses.replace(record, output_angle=record.output_angle + error + slips)
    friction, elements = (EFFECTS["viscous_windup"], (1.0,)), (HYSTERESIS, (9.0, 1.6, 4.0, 1.0))
    rest, made, (viscous, _) = left(both, friction, elements)
    assert rest == pytest.approx(2.0, abs=0.05)
    assert viscous[0] == pytest.approx(8.0, rel=0.01)
    beta = made.fit((friction, elements))[0][-3:]
    terms = Term(friction[0], (8.0,), (1.0,)), Term(HYSTERESIS, tuple(beta[1:]), elements[1])
    live = ExtendedModel(drive, terms, 0.0, ALL)
    found = live.step(live.start(), record.time, record.input_angle, record.speed, record.torque)[0]
    expected = error + np.array(slips)
    assert np.std(found - unloaded - expected) < 0.05 * np.std(expected)


def test_columns_of_teeth_are_the_same_when_carried_again() -> None:
    made, other = bench(), bench()
    for damping in (0.1, 0.05):
        carried = made.beside((((RESONANCE, (2.0, 60.0, damping)), np.array([0.0, 0.0, 1.0])),))
        found = carried.columns(PITCH, ())
    assert_array_equal(found, other.beside(CARRYING).columns(PITCH, ()))
    assert np.abs(found - other.columns(PITCH, ())).max() > 0.0


def test_columns_that_the_motion_makes_are_those_at_other_parameters(plain: LinearisedFit) -> None:
    elsewhere = plain.moved(plain.parameters + np.array([3.0, -2.0, 1.0, 1.0, 2.0, 0.5, 0.3]))
    shown = [effect for effect in EFFECTS.values() if goes_along(effect) and plain.data.testable(effect)[0]]
    assert len(shown) == 8
    for effect in shown:
        nonlinear = plain.data.grid(effect)[0]
        known = plain.columns(effect, nonlinear)
        assert elsewhere.columns(effect, nonlinear) is known, effect.name
        assert_array_equal(elsewhere.effects.new_columns(effect, nonlinear), known, effect.name)


def test_a_delay_carries_all_of_a_wave_as_it_runs_what_it_wanders_by_included() -> None:
    ball, order = EFFECTS["bearing_passage"], (9.7, 1.0)
    fit = bench()
    size = fit.columns(ball, order).shape[1]
    coefficients = ARCSEC * np.random.default_rng(0).standard_normal(size)
    for place in (0, size - 1):
        more = coefficients + ARCSEC * (np.arange(size) == place)
        late = (DELAY, ()), np.array([2.5e-3])
        one, other = (fit.beside((late, ((ball, order), own))) for own in (coefficients, more))
        changed = other.effects.together(other.present) - one.effects.together(one.present)
        within = fit.data.record.time > 0.05  # after the delay
        column = ARCSEC * one.columns(ball, order)[:, place]
        assert_allclose(changed[within], column[within], atol=1e-6 * np.abs(column).max())


def test_a_column_of_hardly_any_row_does_not_grow_without_end() -> None:
    """A knee beyond every torque of the record is a spike at the highest one, as small as rounding."""
    hardening = EFFECTS["torsional_hardening"]
    fit = bench()
    most = float(np.max(np.abs(fit.signals.torque)))
    for beyond in (0.01, 0.02, 0.04):
        chosen = ((hardening, (5.0, most + beyond, 1e-3)),)
        (found,) = sizes(fit, chosen)
        assert np.max(np.abs(found)) < 1e3 * hardening.usual[0]
        assert 0.0 < fit.deviance(chosen) <= fit.deviance(()) + 1.0


def test_a_ripple_that_the_smoothing_left_is_not_smoothed() -> None:
    """Only where smoothing removed the ripple like noise does the fit smooth its own ripple."""
    ripple, fit = EFFECTS["torque_sensor_ripple"], bench()
    record = dataclasses.replace(fit.data.source, torque_window=np.full(fit.data.source.size, 0.3))
    both = (dataclasses.replace(record, torque_with_waves=waves) for waves in (True, False))
    kept, cut = (linearise(one, CONFIGURED, POINT).data.model for one in both)
    of_kept, of_cut = (model.torque(ripple, (0.0, 0.0)) for model in (kept, cut))
    assert_allclose(of_kept, ripple.torque(kept.motion, (0.0, 0.0)))
    assert np.std(of_cut[:, 2]) < 0.9 * np.std(of_kept[:, 2])


def test_widened_slopes_are_those_over_what_is_left_open() -> None:
    start = POINT + np.eye(7)[fit_parameters.CUP]
    fit = linearise(swinging(), CONFIGURED, start).with_noise(())
    wide = fit.widened(())

    def error(parameters: np.ndarray) -> np.ndarray:
        return fit.moved(parameters).whole.predicted[fit.data.at]

    bent = []
    for step in wide.reach.T:
        change = error(fit.parameters + step) - error(fit.parameters - step)
        assert_allclose(2.0 * wide.jacobian @ step, change, rtol=0, atol=1e-3 * np.abs(change).max())
        bent.append(np.abs(2.0 * fit.jacobian @ step - change).max() / np.abs(change).max())
    assert max(bent) > 0.02
    deviation, local = (np.sqrt(np.diag(one.fit(())[1])[:7]) for one in (wide, fit))
    assert np.all(deviation > 0.95 * local)


def test_widened_slopes_end_at_a_bound() -> None:
    start, cup = fit_parameters.vector(CONFIGURED, CONFIGURED), fit_parameters.CUP
    start[cup] = fit_parameters.bounds(CONFIGURED)[0][cup]
    fit = linearise(swinging(), CONFIGURED, start)
    none = np.zeros(fit.data.source.size)
    found = fit.data.model.secants(start, none, np.diag(np.full(7, 0.1)))
    assert_allclose(found[:, cup], fit.data.model.derivatives(start, none)[:, cup], rtol=1e-6)
