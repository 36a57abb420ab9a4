"""Chosen causes exchanged for better ones."""

import dataclasses

import numpy as np
import pytest
from benches import EFFECTS, POINT, bench, of, swinging
from joint_records import ARCSEC, NOISE

from hd_diag.diagnosis.fit.joint_refinement import sensible, settle
from hd_diag.diagnosis.evidence.solution import causes
from hd_diag.diagnosis.search.exchange import (
    at_best_choices,
    deviance_of,
    finished_in_time,
    one_for_two,
    refined,
    swapped,
)
from hd_diag.effects.signals import Signals


def test_a_shape_of_many_coefficients_gives_way_to_the_two_causes_that_it_imitates() -> None:
    """Harmonics of a pitch error explain more than either an oval spline or a wrong zero of the torque."""
    form, zero = EFFECTS["circular_spline_form"], EFFECTS["torque_offset"]
    sizes = np.array([0.0, 0.0, 1.44e-6, 1.08e-6, 0.0, 0.0])
    chosen = ((EFFECTS["circular_spline_pitch"], ()),)
    fit = settle(bench(lambda signals: form.response(signals, sizes, (1.0,)), of(zero, offset=-1.5)), chosen)
    found, two = swapped(fit, chosen, {"circular_spline_pitch", form.name, zero.name})
    assert [effect.name for effect, _ in two] == [form.name, zero.name]
    assert deviance_of(found, two) < deviance_of(fit, chosen) - 1000.0
    assert found.fit(two)[0][found.places(two)[1]] == pytest.approx(np.array([-1.5]), abs=0.03)


def test_a_shape_of_many_coefficients_gives_way_to_one_cause_at_other_parameters() -> None:
    """Worn teeth, where a wider clearance was taken for a greater datum and the rest for a pitch error."""
    wear, pitch = EFFECTS["wear_backlash"], EFFECTS["circular_spline_pitch"]
    chosen = ((pitch, ()),)
    away = np.array([-1.0, -0.5, 0.0, 0.0, 8.0, 0.0, 0.0])
    fit = settle(bench(of(wear, clearance=4e-6)).moved(POINT + away), chosen)
    names = {pitch.name, wear.name, "circular_spline_form", "input_encoder_eccentricity"}
    found, one = swapped(fit, chosen, names)
    assert [effect.name for effect, _ in one] == [wear.name]
    assert found.fit(one)[0][found.places(one)[0]] == pytest.approx(np.array([4e-6]), rel=0.1)


@pytest.mark.parametrize("own", [True, False])
def test_one_cause_that_two_might_be_takes_their_place_if_it_explains_as_much(own: bool) -> None:
    """A pitch error of which an off-centre encoder and an oval spline explain most; and both of these."""
    pitch, read, form = (
        EFFECTS[name]
        for name in ("circular_spline_pitch", "input_encoder_eccentricity", "circular_spline_form")
    )
    sizes = np.zeros(pitch.size)
    sizes[:6] = 2e-6, 1e-6, 1.5e-6, 0.5e-6, 0.4e-6, 0.3e-6
    reads = of(read, amplitude=8.0 * ARCSEC, direction=1.0, second_amplitude=0.0, second_direction=0.0)
    oval = np.array([0.0, 0.0, 1.44e-6, 1.08e-6, 0.0, 0.0])
    parts = (
        (lambda signals: pitch.response(signals, sizes, ()),)
        if own
        else (reads, lambda signals: form.response(signals, oval, (0.0,)))
    )
    chosen = ((read, ()), (form, (0.0,)))
    fit = settle(bench(*parts), chosen, 8)
    found = causes(fit, chosen, (), np.random.default_rng(0))
    shared = [dataclasses.replace(cause, alike=(*cause.alike, pitch.name)) for cause in found]
    there, one = one_for_two(fit, chosen, shared, set())
    assert [effect.name for effect, _ in one] == ([pitch.name] if own else [read.name, form.name])
    assert there.deviance(one) < fit.deviance(chosen) + 10.0
    assert one_for_two(fit, chosen, shared[:1], set()) == (fit, chosen)
    fit.work.seconds = 1e-6
    assert one_for_two(fit, chosen, shared, set()) == (fit, chosen)
    assert fit.work.left_out == ["testing one cause in place of two"]


def test_a_flexible_shape_and_another_cause_give_way_to_one_that_is_both() -> None:
    """A damaged slot, of which harmonics of a pitch error and an oval spline each take a part."""
    damage, pitch, form = (
        EFFECTS[name] for name in ("tooth_damage", "circular_spline_pitch", "circular_spline_form")
    )
    slots = [slot for (member, slot) in damage.neighbours(bench().signals, (0.0, 2.0)) if member == 0.0]
    fit = bench(lambda signals: damage.response(signals, np.array([2e-5, 2e-5]), (0.0, slots[1])))
    chosen = ((pitch, ()), (form, (0.0,)))
    fit = settle(fit, chosen, 8)
    found = causes(fit, chosen, (), np.random.default_rng(0))
    there, one = one_for_two(fit, chosen, found, {damage.name})
    assert [effect.name for effect, _ in one] == [damage.name]
    assert there.deviance(one) < fit.deviance(chosen)
    assert one_for_two(fit, chosen, found, set()) == (fit, chosen)


def test_a_slot_beside_the_damaged_one_is_given_up_for_it() -> None:
    damage = EFFECTS["tooth_damage"]
    slots = [slot for (member, slot) in damage.neighbours(bench().signals, (0.0, 2.0)) if member == 0.0]
    hurt, beside = slots[1], slots[2]
    fit = bench(lambda signals: damage.response(signals, np.array([2e-5, 2e-5]), (0.0, hurt)))
    found, chosen = refined(fit, ((damage, (0.0, beside)),))
    assert chosen[0][1] == pytest.approx((0.0, hurt))
    assert np.std(found.remainder(chosen)) < 1.05 * NOISE


@pytest.mark.parametrize("start", [(3.36, 2.0, 5.04, 3.0), (8.4, 2.0, 5.04, 3.0)])
def test_a_shape_that_fits_better_where_it_is_no_longer_itself_is_not_taken(
    start: tuple[float, ...],
) -> None:
    """A loop of which bend and elements oppose each other: nearer to it lies what no hysteresis is."""
    loop, opposed = EFFECTS["hysteresis"], ARCSEC * np.array([12.5, -8.75])
    fit = bench(lambda signals: loop.response(signals, opposed, (6.6, 2.2, 17.0, 1.26)))
    assert sensible(settle(fit, ((loop, start),)), ((loop, start),)) == [True]
    assert sensible(*refined(fit, ((loop, start),))) == [True]


def test_a_cause_is_not_given_up_before_it_is_settled() -> None:
    """Beside parameters that are on their way still, harmonics of a pitch error explain more for now."""
    rubbing = EFFECTS["viscous_windup"]
    chosen = ((rubbing, (1.0,)),)
    away = POINT - np.array([5.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    fit = bench(of(rubbing, friction=0.5, exponent=1.0)).moved(away).corrected(chosen)
    found, same = swapped(fit, chosen, {rubbing.name, "circular_spline_pitch"})
    assert same == chosen
    assert np.abs(found.parameters - POINT).max() < 1.0


def test_a_coupling_whose_play_would_be_negative_has_none() -> None:
    """Friction that helps the motion along is no play, and no reason to give the coupling up."""
    bent = EFFECTS["coupling_misalignment"]
    own = of(bent, angle=0.05, direction=0.4, play=0.0, plays=0.0)
    for way, plays in ((-1e-6, 0.0), (1e-6, 1.0)):
        fit = bench(own, lambda signals, way=way: -way * np.tanh(signals.speed / 0.1))
        assert at_best_choices(fit, ((bent, (1.0 - plays,)),)) == ((bent, (plays,)),)


def test_a_cause_is_dropped_that_the_parameters_replace_once_they_have_moved() -> None:
    pitch, runout = (EFFECTS[name] for name in ("circular_spline_pitch", "output_runout"))
    fit = bench(of(runout, amplitude=8.0 * ARCSEC, direction=0.3))
    away = fit.parameters + np.array([3.0, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    chosen = ((runout, ()), (pitch, ()))
    there = fit.with_noise(chosen).moved(away).corrected(chosen)
    fit, left = finished_in_time(there, chosen)
    assert [effect.name for effect, _ in left] == ["output_runout"]
    assert np.abs(fit.parameters - POINT)[:2] == pytest.approx(0.0, abs=0.5)


def test_a_lag_that_nothing_tells_is_not_left_at_its_limit() -> None:
    """In twenty seconds of warming all long lags look alike; what would come next does not."""
    drift, record = EFFECTS["thermal_drift"], swinging()
    warming = dataclasses.replace(record, temperature=25.0 + 5.0 * (1.0 - np.exp(-record.time / 10.0)))
    fit = bench(of(drift, drift=200.0 * ARCSEC, lag=3000.0), record=warming)
    chosen = ((drift, (3600.0,)),)
    longest = settle(fit, chosen)
    found, ((_, (lag,)),) = finished_in_time(longest, chosen)
    assert 40.0 < lag < 1000.0
    assert deviance_of(found, ((drift, (lag,)),)) < deviance_of(longest, chosen) + 4.0


def test_a_wave_that_wanders_gives_way_to_two_lines_that_beat() -> None:
    """Their sum swells and fades as a cage's wave might; two lines of whole numbers need less."""
    ball = EFFECTS["bearing_passage"]

    def beats(signals: Signals) -> np.ndarray:
        return 3.0 * ARCSEC * sum(np.cos(order * signals.output_angle - 1.0) for order in (47.0, 49.0))

    chosen = ((ball, (0.48, 1.0)),)
    fit = settle(bench(beats), chosen)
    found, lines = swapped(fit, chosen, {ball.name})
    assert sorted(nonlinear for _, nonlinear in lines) == [(47.0,), (49.0,)]
    assert deviance_of(found, lines) < deviance_of(fit, chosen) + 10.0


def test_the_way_of_a_friction_is_tried_at_several_lengths() -> None:
    """Its bend shows where the joint turns round alone; a fit that begins with a sudden one stays there."""
    friction = EFFECTS["coulomb_windup"]
    fit = bench(of(friction, friction=2.0, way=0.15, creep_speed=0.0, stribeck=0.0, stribeck_speed=10.0))
    sudden = ((friction, (1e-3, 0.0, 0.0, 10.0)),)
    settled = settle(fit, sudden)
    ((_, (way, *_)),) = at_best_choices(settled, sudden)
    assert way == 0.15
