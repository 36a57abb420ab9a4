"""Parts of the search: when slow motion is looked at first, and a whole search on a known cause."""

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, POINT, TRUE, Part, bench, of, swinging
from challenge import families
from joint_records import ARCSEC, RATIO, generated, prepared
from joint_records import NOISE as NOISE_OF_RECORD
from numpy.testing import assert_allclose

from hd_diag.diagnosis import diagnosis, predictive
from hd_diag.diagnosis.diagnosis import _described
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.fit_parameters import COMPLIANCE, CUP, DATUM
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit, linearise
from hd_diag.diagnosis.fit.refit import Refit, refit
from hd_diag.diagnosis.gain import MISFIT, Rms, held_out
from hd_diag.diagnosis.predictive import Tried, most_predictive
from hd_diag.diagnosis.record import prepare
from hd_diag.diagnosis.search import causes as search_causes
from hd_diag.diagnosis.search.acceptance import passing
from hd_diag.diagnosis.evidence.solution import Search, causes, doubted, left_out, motor_deviations, parameters_of
from hd_diag.diagnosis.evidence.kept_parameters import GROUPS, Kept, kept_parameters
from hd_diag.diagnosis.search.minima import globally_refitted, speed_dependent
from hd_diag.diagnosis.search.ranking import candidates, family_size, ranked
from hd_diag.diagnosis.evidence.search import (
    _next,
    _plainly_better,
    _ranked_when_settled,
    _when_settled,
    _with_torque_zero,
    search,
)
from hd_diag.diagnosis.evidence.unexplained import with_table
from hd_diag.diagnosis.evidence.unmodelled_terms import UNMODELLED_TERMS, UnmodelledTerm
from hd_diag.diagnosis.work import Work
from hd_diag.drive import transmission_error
from hd_diag.effects.signals import Signals

NOISE = np.random.default_rng(0).normal(0.0, ARCSEC, 6000)
(CREEP,) = (term for term in UNMODELLED_TERMS if term.name == "creep")


def left(speed: np.ndarray, rest: np.ndarray) -> LinearisedFit:
    """A bench as far as `speed_dependent` looks at it."""
    made = SimpleNamespace(signals=SimpleNamespace(speed=speed), remainder=lambda chosen: rest)
    return cast(LinearisedFit, made)


SPEED = np.array([8.0, 8.0, -60.0, 60.0])[np.arange(6000) // 250 % 4]  # half slow, half fast [rad/s]


@pytest.mark.parametrize(("growth", "expected"), [(0.0, False), (0.2, False), (0.5, True), (-0.4, True)])
def test_what_grows_or_falls_with_speed_asks_for_a_slow_start(growth: float, expected: bool) -> None:
    rest = NOISE * (1.0 + growth * (np.abs(SPEED) > 30.0))
    assert speed_dependent(left(SPEED, rest)) is expected
    assert speed_dependent(left(-SPEED, -rest)) is expected


def test_speeds_that_are_alike_have_no_slow_part() -> None:
    rest = NOISE * (1.0 + (np.abs(SPEED) > 30.0))
    assert not speed_dependent(left(np.sign(SPEED) * (25.0 + 0.25 * np.abs(SPEED)), rest))


def test_parameters_are_searched_for_again_under_the_torque_that_friction_leaves() -> None:
    """6 N m move the torque at which the flanks change, which no columns at wrong parameters know."""
    record, dry = swinging(), EFFECTS["coulomb_windup"]
    torque = record.torque + 6.0 * np.tanh(record.speed / 2.0)
    output = record.input_angle / RATIO + transmission_error(TRUE, record.input_angle, torque)
    output += NOISE_OF_RECORD * np.random.default_rng(1).standard_normal(record.size)
    rubbing = dataclasses.replace(record, output_angle=output)
    fit = linearise(rubbing, CONFIGURED, fit_parameters.vector(CONFIGURED, CONFIGURED)).with_noise(())
    chosen = ((dry, (0.003, 1.0, 0.5, 3.0)),)
    found = globally_refitted(fit, chosen, np.random.default_rng(0))
    assert found.parameters[DATUM] == pytest.approx(POINT[DATUM], abs=2.0)
    assert found.parameters[:2] == pytest.approx(POINT[:2], abs=0.3)


def test_a_delay_is_seen_and_noise_is_not() -> None:
    assert not speed_dependent(bench())
    assert speed_dependent(bench(of(EFFECTS["stream_delay"], delay=2e-3)))


def test_parameters_that_imitate_a_cause_are_left_for_those_fitted_beside_it() -> None:
    """Fitted without a large delay they are far off; beside each candidate they are searched for again."""
    rng, away = np.random.default_rng(0), np.array([-8.0, 9.0, 4.0, 0.0, 9.0, 2.0, 3.0])
    misled = bench(of(EFFECTS["stream_delay"], delay=5e-3)).moved(POINT + away)
    fit, best = _ranked_when_settled(misled, (), candidates(misled, ()), rng, POINT)
    assert np.abs(fit.parameters - POINT).max() < 1.0
    assert best[0].effect.name == "stream_delay"
    plain = settle(bench(of(EFFECTS["output_runout"], amplitude=20.0 * ARCSEC, direction=0.3)), ())
    assert _ranked_when_settled(plain, (), candidates(plain, ()), rng, plain.parameters)[0] is plain


def test_a_cause_larger_than_the_least_torque_is_settled_where_the_flank_is_certain() -> None:
    """Strain gauges feel a quarter of a newton metre twice a turn, under torques from 0.16 N m on."""
    made = families.made("robot_single", 1_000_000_627)
    columns = (made.time, made.input_angle, made.output_angle, made.torque, made.temperature, made.part)
    record = prepare(*(column[made.time < 60.0] for column in columns), RATIO)
    point = fit_parameters.vector(CONFIGURED, CONFIGURED) + np.array([22.6, 8.0, 2.9, 1.0, 12.0, -0.5, 0.4])
    fit = settle(linearise(record, CONFIGURED, point), ())
    (ripple,) = ranked(fit, (), [EFFECTS["torque_sensor_ripple"]])
    assert _when_settled(fit, (), ripple, fit)[0] > 0.4 * ripple.surprise > 300.0


@pytest.mark.parametrize(("real", "reported"), [(-1.0, 1.0), (8.0, 3.0)])
def test_under_a_torque_that_never_changes_its_zero_may_be_what_looks_like_a_pitch(
    real: float, reported: float
) -> None:
    record, pitch = swinging(), EFFECTS["circular_spline_pitch"]
    torque = np.full(record.size, real)
    output = record.input_angle / RATIO + transmission_error(TRUE, record.input_angle, torque)
    output += NOISE_OF_RECORD * np.random.default_rng(1).standard_normal(record.size)
    read = reported + 1e-3 * np.random.default_rng(2).standard_normal(record.size)
    still = dataclasses.replace(record, torque=read, reported_torque=read, output_angle=output)
    fit = settle(linearise(still, CONFIGURED, POINT), ((pitch, ()),), rounds=8)
    (found,) = causes(fit, ((pitch, ()),), ("torque_offset",), np.random.default_rng(0))
    assert "torque_offset" in found.alike


def wave(order: float) -> Part:
    """Of some orders per output turn, a quarter of which is driven."""
    return lambda signals: 3.0 * ARCSEC * np.cos(order * signals.output_angle - 1.0)


@pytest.mark.parametrize(("order", "named"), [(45.0, "output_line_1"), (45.5, "bearing_passage")])
def test_a_cage_is_named_only_where_its_order_is_no_whole_one_of_the_output(order: float, named: str) -> None:
    """The spectrum resolves four orders here, the wave's phase over the record a tenth of one."""
    fit = bench(wave(order))
    best = candidates(fit, ())
    assert best[0].effect.name == "bearing_passage"
    found = _next(fit, (), family_size(fit), best, ())
    assert found is not None
    assert (found.effect.name, found.nonlinear[0]) == (
        named,
        pytest.approx(order if order == 45 else 0.455, abs=1e-3),
    )


def test_a_line_beside_the_gear_s_own_order_is_no_ripple_of_a_torque() -> None:
    """Over a quarter of a turn, 99 a turn of the output are nearly once a turn of the input by position."""
    found = search(bench(wave(99.0), wave(45.0)), np.random.default_rng(0))
    assert found.causes == ()
    assert {item[1] for item in found.unmodelled} >= {(45.0,)}


def test_a_cause_is_settled_before_a_term_is_put_in_its_place() -> None:
    """Beside no eccentricity a runout follows the torque's wrong zero far away, and hides most of it."""
    record, offset = swinging(40.0, drive=CONFIGURED), 1.3
    reported = record.torque + offset
    shifted = dataclasses.replace(record, torque=reported, reported_torque=reported)
    away = np.array([-0.04, 0.19, -20.0, -1.2, -1.1, -0.1, 0.1])
    there = fit_parameters.vector(CONFIGURED, CONFIGURED) + away
    fit = linearise(shifted, CONFIGURED, there).with_noise(())
    best, terms = candidates(fit, ()), ranked(fit, (), UNMODELLED_TERMS)
    assert (best[0].effect.name, terms[0].effect.name) == ("torque_offset", "even_torque")
    assert terms[0].surprise > 1.3 * best[0].surprise
    found = _next(fit, (), family_size(fit), best, ())
    assert found is not None
    assert found.effect.name == "torque_offset"


def test_what_explains_most_at_once_is_tried_though_others_come_first_when_settled() -> None:
    """Beside parameters that are far off anything settled explains more than a cause does by itself."""
    rubs = EFFECTS["viscous_windup"]
    fit = bench(of(rubs, friction=1.5, exponent=1.0))
    best = candidates(fit, ())
    true = best[0]
    assert true.effect.name == rubs.name
    settled = [
        dataclasses.replace(one, surprise=2.0 * true.surprise)
        for one in best
        if passing(fit, (), [one], family_size(fit)) is None
    ]
    found = _next(fit, (), family_size(fit), [*settled[:3], *best[1:3], true], set())
    assert found is true


@pytest.mark.parametrize(("settles", "expected"), [(10.0, False), (0.2, True)])
def test_a_term_takes_a_cause_s_place_only_if_it_is_plainly_better(settles: float, expected: bool) -> None:
    """What grows with the way also drifts with a temperature that rises for long, all but a few per cent."""
    drift, creep = (EFFECTS["thermal_drift"], (1.0,)), (CREEP, ())
    record = swinging()
    warming = dataclasses.replace(record, temperature=25.0 - 12.0 * np.exp(-record.time / settles))
    fit = bench(lambda signals: 20.0 * ARCSEC * creep[0].columns(signals, ())[:, 0], record=warming)
    before = settle(fit, (drift,))
    assert _plainly_better((before, (drift,)), settle(before, (drift, creep)), (creep,)) is expected


def test_lines_of_the_output_are_described() -> None:
    """Fitted with all else, they stay in the remainder, and its table has them."""
    found = with_table(search(bench(wave(45.0), wave(87.0)), np.random.default_rng(0)))
    assert found.causes == ()
    assert sorted((row.order, row.frame) for row in found.table) == [(45.0, "output"), (87.0, "output")]
    assert [row.amplitude / ARCSEC for row in found.table] == pytest.approx([3.0, 3.0], rel=0.1)


def test_search_returns_the_cause_and_no_other() -> None:
    said: list[str] = []
    values = {
        "friction": 2.0,
        "way": 0.2,
        "creep_speed": 0.5,
        "stribeck": 0.5,
        "stribeck_speed": 8.0,
    }
    fit = bench(of(EFFECTS["coulomb_windup"], **values))
    fit.work.progress = lambda share, text: said.append(text)
    found = search(fit, np.random.default_rng(0))
    (cause,) = found.causes
    assert said == ["looking for cause 1", "looking for cause 2", "refining what was found"]
    assert fit.work.left_out == []
    assert (cause.alike, found.unmodelled) == (("coulomb_windup",), ())
    assert found.chosen == ((cause.effect, cause.nonlinear),)
    assert np.array([*cause.coefficients, *cause.nonlinear]) == pytest.approx([*values.values()], rel=0.3)
    assert 0.5 < cause.gain_low < cause.gain < min(cause.gain_high, 1.0)
    assert cause.p_value < 1e-12


@pytest.mark.slow  # a whole diagnosis
def test_parameters_are_ambiguous_only_if_they_are_beside_all_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the causes several sets may fit alike: a refit beside them decides."""

    def doubtful(*given: Any, **named: Any) -> Refit:
        return dataclasses.replace(refit(*given, **named), trustworthy=False)

    monkeypatch.setattr(diagnosis, "refit", doubtful)
    found = diagnosis.diagnose(swinging(8.0), CONFIGURED, np.random.default_rng(0))
    assert found.refitted is not None
    assert found.refitted.trustworthy


def test_what_a_motor_needs_itself_is_no_cause() -> None:
    """Current for torque: gain within its prior, friction and inertia relative to it; none is named.

    The friction under load is that of the link's torque, which the current is more than.
    """
    record = swinging()
    speed = np.gradient(record.input_angle, record.time)
    sign = np.tanh(speed / 2.0)
    rate = np.gradient(speed, record.time)
    needed = record.torque + (3.0 + 0.1 * np.abs(record.torque)) * sign + 2.0 * rate / 100.0
    by_current = dataclasses.replace(record, torque=needed, reported_torque=needed, by_current=True)
    found = search(bench(record=by_current), np.random.default_rng(0))
    assert found.causes == ()
    ((item, sized),) = found.fit.sized(found.chosen, found.fit.fit(found.chosen)[0])
    values = {name: value for name, (value, _) in item[0].to_physical(sized, item[1]).items()}
    assert item[0].name == "motor_current"
    gain = 1.0 + values["relative_error"]  # a stiffer gear with a larger constant is nearly as good
    assert abs(gain - 1.0) < 2.0 * 0.2
    assert values["friction"] / gain == pytest.approx(3.0, abs=0.15)
    assert values["loaded_friction"] / gain == pytest.approx(0.1, abs=0.01)
    assert values["inertia"] / gain == pytest.approx(2.0, abs=0.2)
    assert np.std(found.fit.remainder(found.chosen)) < 1.05 * NOISE_OF_RECORD


def test_friction_of_one_direction_is_a_wrong_zero_of_the_torque() -> None:
    """What begins as two shapes of their grids is one at its best: the class holds both."""
    record = swinging()
    angle = 60.0 * record.time + 5.0 * np.sin(record.time)
    torque = 20.0 * np.sin(record.time)
    output = angle / RATIO + transmission_error(TRUE, angle, torque + 3.0)
    output += NOISE_OF_RECORD * np.random.default_rng(0).standard_normal(record.size)
    forward = prepared({"time": record.time, "input": angle, "output": output, "torque": torque})
    found = search(bench(record=forward), np.random.default_rng(0))
    (cause,) = found.causes
    assert {"torque_offset", "coulomb_windup"} <= set(cause.alike)


def test_stiffness_and_a_current_s_constant_are_open_by_one_factor() -> None:
    """Twice the torque on half the compliance is the same error: every ± holds what the prior leaves."""
    record = dataclasses.replace(swinging(), by_current=True)
    fit = settle(bench(record=record), bench(record=record).data.given)
    found = Search(fit, (), fit.data.given)
    parameters, covariance = parameters_of(found)
    configured = fit_parameters.vector(fit.data.configured, fit.data.configured)
    assert parameters[COMPLIANCE] == pytest.approx(configured[COMPLIANCE], rel=1e-9)
    width = 0.15 * parameters[COMPLIANCE]
    assert covariance[COMPLIANCE, COMPLIANCE] == pytest.approx(width**2, rel=1e-3)
    assert covariance[CUP, COMPLIANCE] == pytest.approx(0.15 * parameters[CUP] * width, rel=1e-3)
    deviations, (_, sized) = motor_deviations(found), fit.sized(found.chosen, fit.fit(found.chosen)[0])[0]
    assert deviations["relative_error"] > 0.15 * (1.0 + sized[0]) > 0.1
    kept = kept_parameters(fit, found.chosen)[1]
    assert kept.bounds["tooth_compliance"] == pytest.approx(1.96 * width, rel=1e-2)


def test_friction_under_load_by_a_current_has_these_derivatives() -> None:
    """`changes` against differences, where the torque behind the motor turns round too."""
    effect, rng = EFFECTS["motor_current"], np.random.default_rng(0)
    columns, size = rng.normal(0.0, 5.0, (500, 5)), np.array([0.2, 0.8, 0.05, 0.5, 0.1])
    steps = 1e-7 * np.eye(5)
    slopes = [
        (effect.more(columns, size + step) - effect.more(columns, size - step)) / 2e-7 for step in steps
    ]
    assert effect.changes(columns, size) == pytest.approx(np.stack(slopes, axis=1), abs=1e-5)


@pytest.mark.parametrize(("zero", "led"), [(-2.6, True), (-0.02, False)])
def test_a_zero_that_puts_torques_on_the_other_flank_is_tried_at_its_size(zero: float, led: bool) -> None:
    """A joint that bears next to nothing, whose sensor is off by more than it bears."""
    record = swinging()
    real = 0.4 * np.sin(2.0 * np.pi * record.time / 5.3) - 0.3
    output = record.input_angle / RATIO + transmission_error(TRUE, record.input_angle, real)
    output += NOISE_OF_RECORD * np.random.default_rng(0).standard_normal(record.size)
    shown = real - zero
    light = dataclasses.replace(record, torque=shown, reported_torque=shown, output_angle=output)
    fit = settle(linearise(light, CONFIGURED, POINT), ())
    begun = Refit(TRUE, POINT, np.eye(7), True, torque_zero=zero)
    found = _with_torque_zero(fit, begun)
    assert (found is not None) is led
    if found is not None:
        assert found[1][0].effect.name == "torque_offset"
        assert found[1][0].p_value < 1e-6
        assert np.abs(found[0].parameters - POINT).max() < 1.0


def test_a_zero_is_tried_where_the_torque_is_clear_of_zero_with_it() -> None:
    """A fifth of the torques is on the other flank, and rows about the real zero tell less than nothing."""
    record = generated(families.made("robot_pair", 1_000_000_833))
    test, _ = held_out(record)
    begun = refit(record.select(~test), CONFIGURED, np.random.default_rng(0))
    fit = settle(linearise(record, CONFIGURED, begun.parameters, rows=~test), ())
    found = _with_torque_zero(fit, begun)
    assert found is not None
    assert found[1][0].effect.name == "torque_offset"
    (zero,) = found[0].fit(((found[1][0].effect, ()),))[0][-1:]
    assert zero == pytest.approx(0.82, abs=0.2)


def test_what_is_tried_in_a_cause_s_place_starts_where_the_cause_does() -> None:
    """Where the fit has not settled, its deviance says nothing: anything settled would beat the cause."""
    rubbing = EFFECTS["viscous_windup"]
    chosen = ((rubbing, (1.0,)),)
    fit = settle(bench(of(rubbing, friction=1.5, exponent=1.0)), chosen)
    (size,) = fit.fit(chosen)[0][fit.places(chosen)[0]]
    away = fit.beside(((chosen[0], np.array([3.0 * size])),))
    named = Search(away, causes(fit, chosen, (), np.random.default_rng(0)))
    assert away.design(chosen).deviance() > fit.design(chosen).deviance() + 100.0
    assert [cause.doubtful for cause in doubted(named).causes] == [False]


@pytest.mark.parametrize("friction", [0.0, 1.5])
def test_a_cause_that_is_needed_only_beside_a_doubtful_one_is_doubtful(
    monkeypatch: pytest.MonkeyPatch, friction: float
) -> None:
    """What an encoder reads, taken for a shape, and friction that is there or not."""
    rubbing, read = EFFECTS["viscous_windup"], EFFECTS["output_encoder_eccentricity"]
    record = swinging()
    monkeypatch.setattr(search_causes, "only_corrects_shape", lambda fit, chosen, index: index == 0)
    reads = of(read, amplitude=6.0 * ARCSEC, direction=1.0, second_amplitude=0.0, second_direction=0.0)
    parts = (reads, of(rubbing, friction=friction, exponent=1.0))
    chosen = ((read, ()), (rubbing, (1.0,)))
    fit = settle(bench(*parts, record=record), chosen)
    shared = causes(fit, chosen, (), np.random.default_rng(0))
    named = Search(fit, tuple(sorted(shared, key=lambda cause: cause.effect.name)))
    doubted_ones = {cause.effect.name for cause in doubted(named).causes if cause.doubtful}
    assert doubted_ones == {"output_encoder_eccentricity", *(("viscous_windup",) if not friction else ())}
    fit.work.seconds = 1e-6  # no time to tell
    assert [cause.doubtful for cause in doubted(named).causes] == [True, False]
    assert fit.work.left_out == ["testing whether causes hold without hints"]


def test_a_cause_that_no_step_leads_back_to_is_compared_with_what_is_settled_in_its_place() -> None:
    """A wrong zero that puts torques on the other flank: its columns beside none of it lead elsewhere."""
    record = swinging()
    real = 0.4 * np.sin(2.0 * np.pi * record.time / 5.3) - 0.3
    output = record.input_angle / RATIO + transmission_error(TRUE, record.input_angle, real)
    output += NOISE_OF_RECORD * np.random.default_rng(0).standard_normal(record.size)
    light = dataclasses.replace(record, torque=real + 1.2, reported_torque=real + 1.2, output_angle=output)
    chosen, zero = ((EFFECTS["torque_offset"], ()),), np.array([-1.2])
    there = linearise(light, CONFIGURED, POINT).clear_of(np.full(record.size, -1.2))
    fit = settle(there.beside(((chosen[0], zero),)).with_noise(chosen), chosen)
    assert fit.beside(()).corrected(chosen).deviance(chosen) > fit.deviance(chosen) + 100.0
    assert left_out(fit, chosen, 0)[1].deviance(chosen) < fit.deviance(chosen) + 10.0
    rivals = {"wear_backlash", "circular_spline_pitch", "circular_spline_form", "coupling_misalignment"}
    (cause,) = causes(fit, chosen, rivals, np.random.default_rng(0))
    assert cause.alike == ("torque_offset",)


def test_gain_and_zero_of_a_torque_that_never_changes_are_one_class() -> None:
    """By either the mesh bears less than 2 N m, though steps lead from one to the other nowhere near."""
    chosen: Chosen = ((EFFECTS["torque_gain"], ()),)
    varying = bench(of(chosen[0][0], relative_error=0.3)).data.source
    for record, expected in ((generated(families.made("unloaded", 1_000_000_733)), True), (varying, False)):
        begun = refit(record, CONFIGURED, np.random.default_rng(0))
        fit = settle(linearise(record, CONFIGURED, begun.parameters), chosen, 8)
        (cause,) = causes(fit, chosen, {"torque_offset"}, np.random.default_rng(0))
        assert ("torque_offset" in cause.alike) is expected


def test_a_torque_that_the_motion_cannot_prove_is_a_rival_whoever_else_is() -> None:
    """Without load a wrong zero and errors of the slots can do the same; the zero is what is in the data."""
    record = generated(families.made("unloaded", 1_000_000_859))
    begun = refit(record, CONFIGURED, np.random.default_rng(0))
    form = EFFECTS["circular_spline_form"]
    chosen: Chosen = ((form, form.grid[0]),)
    fit = settle(linearise(record, CONFIGURED, begun.parameters), chosen, 8)
    (cause,) = causes(fit, chosen, (), np.random.default_rng(0))
    assert {"torque_offset", "torque_gain"} <= {*cause.alike}


def test_parameters_that_held_out_rows_speak_against_are_not_kept() -> None:
    """What little the fitted rows say of a cup, under little torque, others under more torque bear out."""
    record = swinging(60.0)
    test, which = held_out(record)
    load = np.where(test, 20.0, 0.7) * np.sin(2.0 * np.pi * record.time / 1.7)
    soft = dataclasses.replace(TRUE, cup_compliance=TRUE.cup_compliance + 0.3 * ARCSEC)
    error = transmission_error(soft, record.input_angle, load)
    noise = NOISE_OF_RECORD * np.random.default_rng(0).standard_normal(record.size)
    output = record.input_angle / RATIO + error + noise
    record = dataclasses.replace(record, torque=load, reported_torque=load, output_angle=output)
    fit = settle(linearise(record, CONFIGURED, POINT, rows=~test), ())
    assert "cup_compliance" in kept_parameters(fit, ())[1].bounds
    best = most_predictive(record, test, which, fit, Search(fit, ()), np.random.default_rng(0))
    assert best.kept.bounds.keys() == {"runout"}  # it has none
    assert not best.rms.misfit.suspected


def foretold(work: Work, *terms: tuple[UnmodelledTerm, tuple[float, ...]]) -> Tried:
    """What becomes of a drift that the temperature makes where it hardly changes, and nowhere else."""
    drift, rubs, record = EFFECTS["thermal_drift"], EFFECTS["viscous_windup"], swinging(40.0)
    test, which = held_out(record)
    warmth = np.where(test, 8.0, 0.5) * np.sin(record.time / 1.3)
    added = of(rubs, friction=1.5, exponent=1.0)(linearise(record, CONFIGURED, POINT).whole)
    added += np.where(test, 0.0, 0.6 * NOISE_OF_RECORD / 0.5) * warmth
    angle = record.output_angle + added
    record = dataclasses.replace(record, temperature=25.0 + warmth, output_angle=angle)
    chosen = ((rubs, (1.0,)), (drift, (0.0,)), *terms)
    plain = linearise(record, CONFIGURED, POINT, rows=~test, work=work)
    fit = settle(plain, chosen)
    found = Search(fit, causes(fit, chosen, (), np.random.default_rng(0)), terms)
    return most_predictive(record, test, which, settle(plain, ()), found, np.random.default_rng(0))


def test_a_cause_without_which_held_out_rows_are_foretold_better_goes() -> None:
    best = foretold(Work())
    assert [cause.effect.name for cause in best.found.causes] == ["viscous_windup"]
    assert not best.rms.misfit.suspected
    assert best.kept.bounds["cup_compliance"] > 1e-3


def test_where_there_is_no_time_to_try_without_a_cause_that_is_told() -> None:
    """All causes go then, which foretell less together than none does."""
    work = Work(1e-6)
    assert foretold(work).found.chosen == ()
    assert "testing whether fewer causes predict better" in work.left_out


def test_what_no_cause_explains_stays_where_the_causes_go() -> None:
    """It is no part of the model that foretells, and the record holds it all the same."""
    best = foretold(Work(1e-6), (CREEP, ()))
    assert best.found.causes == ()
    assert best.found.chosen == ((CREEP, ()),)


def test_what_creeps_does_so_between_fitted_rows_as_well() -> None:
    record = swinging(40.0)
    rows = np.abs(record.torque) > 5.0
    whole, part = (linearise(record, CONFIGURED, POINT, rows=own) for own in (None, rows))
    at = np.isin(whole.data.at, part.data.at)
    assert 0 < at.sum() < at.size
    assert_allclose(part.columns(CREEP, ()), whole.columns(CREEP, ())[at], rtol=1e-9)


def slipping(signals: Signals) -> np.ndarray:
    """A ball's wave whose phase wanders, of amplitude one (n,)."""
    angle = signals.wave_generator_angle
    way = np.cumsum(np.abs(np.diff(angle, prepend=angle[0])))
    return np.cos(10.25 * angle + 2.5 * np.sin(4.0 * way / way[-1]))


def test_a_rival_that_explains_something_else_is_none() -> None:
    """A ball's wave, which is there as well, explains as much beside a wrong zero as in its place."""
    zero, chosen = EFFECTS["torque_offset"], ((EFFECTS["torque_offset"], ()),)

    fit = settle(bench(of(zero, offset=0.6), lambda signals: 2.0 * ARCSEC * slipping(signals)), chosen)
    (cause,) = causes(fit, chosen, ("bearing_passage",), np.random.default_rng(0))
    assert cause.alike == ("torque_offset",)


def test_parameters_that_predict_no_better_stay_as_configured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of noise, which held-out blocks of the fit itself have passed."""
    monkeypatch.setattr(predictive, "kept_parameters", lambda fit, chosen: (fit, Kept({})))
    groups = GROUPS.keys() - {"tilt"}  # the drive has one section
    for drive, held in ((CONFIGURED, groups), (TRUE, set[str]())):
        record = swinging(drive=drive)
        test, which = held_out(record)
        start = fit_parameters.vector(drive, CONFIGURED)
        fit = settle(linearise(record, CONFIGURED, start, rows=~test), ())
        best = most_predictive(record, test, which, fit, Search(fit, ()), np.random.default_rng(0))
        assert best.kept.bounds.keys() == held
        assert abs(best.gain.fraction) < 1e-4 or not held


def test_a_ball_whose_phase_wanders_is_no_misfit_though_nothing_foretells_it() -> None:
    """A model that runs knows the mean of its phase, as it knows no encoder's zero of the next record."""
    ball, record = EFFECTS["bearing_passage"], swinging(40.0)
    test, which = held_out(record)

    added = 5.0 * ARCSEC * slipping(linearise(record, CONFIGURED, POINT).whole)
    record = dataclasses.replace(record, output_angle=record.output_angle + added)
    chosen = ((ball, (10.25, 1.0)),)
    fit = settle(linearise(record, CONFIGURED, POINT, rows=~test), chosen)
    found = Search(fit, causes(fit, chosen, (), np.random.default_rng(0)))
    best = most_predictive(record, test, which, settle(fit, ()), found, np.random.default_rng(0))
    assert [cause.effect.name for cause in best.found.causes] == ["bearing_passage"]
    assert best.rms.extended > MISFIT * best.rms.noise
    assert best.rms.misfit.value == pytest.approx(1.0, abs=0.1)
    (said,) = _described(record, [], best.rms)
    assert "wanders" in said.description


def test_what_is_left_only_as_the_model_runs_is_said() -> None:
    rms = Rms(*(ARCSEC * value for value in (9.0, 5.0, 1.5, 1.5, 1.0, 1.5, 1.0, 0.9, 1.1)))
    assert not rms.misfit.suspected
    (said,) = _described(swinging(), [], rms)
    assert "only as the model runs" in said.description
    assert said.amplitude == pytest.approx(np.sqrt(2.0 * (1.5**2 - 1.0)) * ARCSEC)
    assert _described(swinging(), [], dataclasses.replace(rms, extended=1.2 * ARCSEC)) == ()


def test_a_cause_that_a_shape_of_no_cause_beats_is_doubtful() -> None:
    """A belt creeps with torque times way; the temperature, which rises meanwhile, is the nearest cause."""
    slow = EFFECTS["thermal_drift"]

    def creeping(signals: Signals) -> np.ndarray:
        return 10.0 * ARCSEC * CREEP.columns(signals, ())[:, 1]

    record = dataclasses.replace(swinging(), temperature=np.linspace(25.0, 34.0, swinging().size))
    chosen = ((slow, (1.0,)),)
    for part, doubtful in ((creeping, True), (of(slow, drift=2.0 * ARCSEC, lag=1.0), False)):
        fit = settle(bench(part, record=record), chosen)
        named = Search(fit, causes(fit, chosen, (), np.random.default_rng(0)))
        assert [cause.doubtful for cause in doubted(named).causes] == [doubtful]


def test_what_parameters_imitate_nearly_whole_is_tried_settled_beside_a_small_cause() -> None:
    """Worn teeth are a datum farther out but for little; a pitch error takes more of that little at first."""
    plain = settle(bench(of(EFFECTS["wear_backlash"], clearance=8e-6), record=swinging(40.0)), (), rounds=8)
    best = candidates(plain, ())
    fit, led = _ranked_when_settled(plain, (), best, np.random.default_rng(0), plain.parameters)
    assert max(best, key=lambda one: one.gain).effect.name == "circular_spline_pitch"
    assert led[0].effect.name == "wear_backlash"
    assert abs(plain.parameters[DATUM] - POINT[DATUM]) > 20.0
    assert abs(fit.parameters[DATUM] - POINT[DATUM]) < 4.0
