"""What passes: a true cause; what does not: noise, what is too small, and what only looks lasting."""

import dataclasses

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, POINT, TRUE, bench, of, swinging
from joint_records import ARCSEC, NOISE, RATIO, prepared

from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import projection
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.search.acceptance import (
    FAMILY_ERROR,
    LEAST_SIZE,
    beside_another,
    chance,
    chance_in_misfit,
    held_out_gain,
    imitated,
    lasting,
    least_size,
    needed,
    of_shapes,
    only_corrects_shape,
    passing,
    size,
)
from hd_diag.diagnosis.search.ranking import ranked
from hd_diag.diagnosis.evidence.unmodelled_terms import UNMODELLED_TERMS
from hd_diag.drive import transmission_error
from hd_diag.effects.signals import Signals
from hd_diag.simulation import Motion, Noise, SimulatedJoint, simulate

RUBBED, DRY, RUNOUT = (EFFECTS[name] for name in ("hysteresis", "coulomb_windup", "output_runout"))
RUBBING = (RUBBED, (9.0, 1.6, 2.0, 1.5))
DRIFT, RESTS = (t for t in UNMODELLED_TERMS if t.name in ("drift", "rests"))


FRICTION = of(
    RUBBED,
    bending_amplitude=1e-4,
    slipping_amplitude=6e-5,
    bending_reach=9.0,
    sharpness=1.6,
    slipping_reach=2.0,
    spread=1.5,
)


@pytest.fixture(scope="module")
def made() -> LinearisedFit:
    return bench(FRICTION)


@pytest.fixture(scope="module")
def long() -> Record:
    """With enough means over seconds."""
    return swinging(60.0)


@pytest.fixture(scope="module")
def plain() -> LinearisedFit:
    return bench()


def test_a_cause_passes_in_a_family_that_is_not_too_large(made: LinearisedFit) -> None:
    (best,) = ranked(made, (), [RUBBED])
    assert passing(made, (), [best], 50) == best
    weak = dataclasses.replace(best, p_value=1e-4)
    assert passing(made, (), [weak], 99) is not None
    assert passing(made, (), [weak], 101) is None


def test_the_shape_of_a_torsion_that_goes_with_position_is_no_runout() -> None:
    """A spring that bends some per cent under gravity: a runout in its place would be many times that."""
    record = swinging()
    torque = 40.0 * np.cos(record.input_angle / RATIO + 0.6)
    output = record.input_angle / RATIO + transmission_error(TRUE, record.input_angle, torque)
    output += NOISE * np.random.default_rng(1).standard_normal(record.size)
    arm = dataclasses.replace(record, torque=torque, reported_torque=torque, output_angle=output)
    bent = bench(lambda signals: 3e-5 * (signals.torque / 40.0) ** 3, record=arm)
    (best,) = ranked(bent, (), [RUNOUT])
    assert best.p_value < FAMILY_ERROR / 50
    assert LEAST_SIZE < size(bent, (), RUNOUT, ()) < imitated(bent, (), RUNOUT, ())
    chosen = ((RUNOUT, ()),)
    assert only_corrects_shape(bent.corrected(chosen), chosen, 0)
    off_centre = bench(of(RUNOUT, amplitude=20.0 * ARCSEC, direction=0.3), record=arm)
    assert passing(off_centre, (), ranked(off_centre, (), [RUNOUT]), 50) is not None
    assert not only_corrects_shape(off_centre.corrected(chosen), chosen, 0)


def test_what_another_effect_undoes_is_none_of_its_own() -> None:
    """A bent coupling is an off-centre encoder's second harmonic: beside it nothing of it can be told."""
    bent, off_centre = (EFFECTS["coupling_misalignment"], (0.0,)), (EFFECTS["input_encoder_eccentricity"], ())
    fit = bench(of(bent[0], angle=0.05, direction=0.4, play=0.0, plays=0.0))
    for chosen, expected in (((bent,), False), ((bent, off_centre), True)):
        assert only_corrects_shape(fit.corrected(chosen), chosen, 0) is expected


def test_zeros_of_the_encoders_have_no_shape_to_be_wrong() -> None:
    """Each recording's zero takes most of a drift by temperature; what they leave is the drift's own."""
    record = swinging()
    heat = 25.0 + 0.2 * record.time + 0.001 * record.time**2
    warm = dataclasses.replace(record, temperature=heat, bag=(record.time // 5.0).astype(np.int64))
    drifting = bench(of(EFFECTS["thermal_drift"], drift=2e-5, lag=0.0), record=warm)
    own = drifting.columns(EFFECTS["thermal_drift"], (1.0,))[:, 0]
    assert np.std(own) > 3.0 * np.std(own - projection(drifting.data.offsets, own))
    assert passing(drifting, (), ranked(drifting, (), [EFFECTS["thermal_drift"]]), 50) is not None


def test_noise_does_not_pass(plain: LinearisedFit) -> None:
    best = ranked(plain, (), [RUBBED, DRY])
    assert min(one.p_value for one in best) > FAMILY_ERROR / 50
    assert passing(plain, (), best, 50) is None
    assert passing(plain, (), [], 50) is None


def test_what_is_surprising_and_too_small_makes_room_for_the_next(made: LinearisedFit) -> None:
    true = ranked(made, (), [RUBBED])[0]
    small = dataclasses.replace(true, effect=EFFECTS["encoder_interpolation"], nonlinear=(64.0,))
    assert size(made, (), small.effect, small.nonlinear) < LEAST_SIZE
    found = passing(made, (), [small, true], 1)
    assert found is not None
    assert found.effect is RUBBED


def test_what_may_be_chance_makes_room_for_the_next(made: LinearisedFit) -> None:
    """It may stand first by what it leaves when everything is settled beside it."""
    true = ranked(made, (), [RUBBED])[0]
    weak = dataclasses.replace(true, p_value=0.02)
    assert passing(made, (), [weak], 1) is None
    assert passing(made, (), [weak, true], 1) == true


def test_two_causes_of_which_one_does_not_foretell_blocks_alone_pass_beside_each_other(
    plain: LinearisedFit,
) -> None:
    rubs, off = EFFECTS["viscous_windup"], EFFECTS["torque_offset"]
    fit = bench(of(rubs, friction=0.36, exponent=1.0), of(off, offset=0.7))
    both = ranked(fit, (), [rubs, off])
    assert all(one.p_value < 1e-60 for one in both)
    alone = [passing(fit, (), [one], 50) for one in both]
    assert None in alone
    assert beside_another(fit, (), both, 50) == both[0]
    failing = both[alone.index(None)]
    assert beside_another(fit, (), [failing, *(one for one in both if one is not failing)], 50) == failing
    assert beside_another(plain, (), ranked(plain, (), [rubs, off]), 50) is None


def test_slow_noise_of_few_seconds_is_no_cause(made: LinearisedFit) -> None:
    """To the noise that is learned beside a once per output turn it is one, for certain."""
    chosen, record = ((RUNOUT, ()),), swinging(5.0)
    walk = np.cumsum(np.random.default_rng(0).standard_normal(record.size))
    slow = bench(lambda signals: 0.1 * ARCSEC * walk[: signals.time.size], record=record)
    assert ranked(slow, (), [RUNOUT])[0].p_value < 1e-12
    assert chance(slow, chosen, 0) > FAMILY_ERROR
    assert chance(made, (RUBBING,), 0) < 1e-50


def test_a_chance_is_larger_where_more_than_noise_may_be_left() -> None:
    """Gains of twice the noise's deviation are four times as likely: exponents of one hypothesis, of many."""
    assert chance_in_misfit(1e-8, 1, 2.0) == pytest.approx(1e-2)
    assert chance_in_misfit(1e-6, 100, 2.0) == pytest.approx(1.0)
    assert chance_in_misfit(1e-30, 100, 2.0) == pytest.approx(1e-6)
    assert chance_in_misfit(1e-6, 100, 0.9) == pytest.approx(1e-6)


def test_size_is_that_of_what_nothing_else_imitates(made: LinearisedFit) -> None:
    part, fixed = FRICTION(made.signals), made.always()
    scaled = fixed / np.linalg.norm(fixed, axis=0)
    own = part - scaled @ np.linalg.lstsq(scaled, part, rcond=None)[0]
    assert size(made, (), *RUBBING) == pytest.approx(np.sqrt(np.mean(own**2)), rel=0.03)
    assert np.std(own) < 0.9 * np.std(part)
    assert size(made, (RUBBING,), *RUBBING) < 0.01 * ARCSEC


def test_held_out_gain_is_of_the_effect_s_own_columns(made: LinearisedFit) -> None:
    chosen = ((DRY, (0.2, 0.0, 0.5, 5.0)), RUBBING)
    gain, predicted = held_out_gain(made, chosen, 1)
    without = made.design(chosen[:1]).held_out().sum() - made.design(chosen).held_out().sum()
    assert gain.sum() == pytest.approx(without, rel=1e-9)
    assert predicted.sum() == pytest.approx(gain.sum(), rel=0.1)
    assert held_out_gain(made, chosen, 0)[0].sum() < 0.01 * gain.sum()


def test_idle_effects_are_dropped_and_needed_ones_kept(made: LinearisedFit, plain: LinearisedFit) -> None:
    assert needed(made, ((DRY, (0.2, 0.0, 0.5, 5.0)), RUBBING, (EFFECTS["viscous_windup"], (1.0,)))) == (
        RUBBING,
    )
    assert needed(plain, ((DRY, (0.2, 0.0, 0.5, 5.0)), RUBBING)) == ()


def test_bend_and_elements_against_each_other_are_no_loop() -> None:
    """They make a filter of the torque, which what its smoothing left of its noise needs."""
    shape = {"bending_reach": 9.0, "sharpness": 1.6, "slipping_reach": 2.0, "spread": 1.5}
    against = bench(of(RUBBED, bending_amplitude=1e-4, slipping_amplitude=-9e-5, **shape))
    assert passing(against, (), ranked(against, (), (RUBBED,)), 1) is None
    assert needed(against, (RUBBING,)) == ()


def test_parameters_that_a_line_leads_to_their_bounds_are_not_all_that_is_left_without_a_cause() -> None:
    """A drive near the ends of what one can be, on a soft spring: without it they would settle otherwise."""
    soft, chosen = EFFECTS["resonance"], ((EFFECTS["resonance"], (1.0, 17.325, 0.05)),)
    point = np.array([0.767, 29.96, 0.0, 0.0, 29892.83, 17.378, 0.03])
    record = swinging(drive=fit_parameters.drive_of(point, CONFIGURED))
    plain = linearise(record, CONFIGURED, point)
    sizes = {"amplitude": 7.033 * ARCSEC, "phase": 5.232, "carried": 0.9}
    shape = {"order": 1.0, "natural_frequency": 17.325, "damping": 0.05}
    angle = plain.data.record.output_angle + of(soft, **sizes, **shape)(plain.signals)
    moved = dataclasses.replace(plain.data.record, output_angle=angle)
    fit = settle(linearise(moved, CONFIGURED, point).with_noise(chosen), chosen)
    gain, _ = held_out_gain(fit, chosen, 0)
    assert fit.deviance(()) - fit.deviance(chosen) > 10.0 * gain.sum()
    assert settle(fit.corrected(()), (), learn=False).deviance(()) < 0.5 * fit.deviance(())
    assert needed(fit, chosen) == chosen


def test_what_is_not_predictive_is_not_judged_by_blocks_held_out(plain: LinearisedFit) -> None:
    drifting = bench(lambda signals: 2e-5 * np.sin(0.9 * signals.time))
    assert needed(drifting, ((DRIFT, ()), (DRY, (0.2, 0.0, 0.5, 5.0)))) == ((DRIFT, ()),)
    assert needed(plain, ((DRIFT, ()), (DRY, (0.2, 0.0, 0.5, 5.0)))) == ()  # too small to be reported


@pytest.mark.parametrize(
    ("drift", "period", "expected"),
    [
        (3.0, None, True),
        (1.0, None, False),  # too small for something that nothing held out can prove
        (0.0, None, False),
        (10.0, 1.0, False),  # over in a second: no drift
    ],
)
def test_a_drift_must_last(long: Record, drift: float, period: float | None, expected: bool) -> None:

    def part(signals: Signals) -> np.ndarray:
        way = (signals.time - signals.time[0]) / (period or np.ptp(signals.time))
        return drift * ARCSEC * (np.sin(2.0 * np.pi * way) if period else way)

    made = bench(part, record=long)
    assert (passing(made, (), ranked(made, (), [DRIFT]), 100) is not None) is expected


@pytest.mark.parametrize(("size", "expected"), [(1.5, True), (0.3, False)])
def test_a_loose_hub_is_seen_in_runs_of_six_seconds(size: float, expected: bool) -> None:
    """It settles anew at each of twelve rests, by so many arcsec: two means over seconds a run prove it."""
    motion = Motion(72.0, 200.0, (6.0, 12.0), (-40.0, -14.0, 14.0))
    made = simulate(SimulatedJoint(TRUE, Noise(white=NOISE)), motion, np.random.default_rng(0))
    time = (made.stamp - made.stamp[0]) * 1e-9
    settled = size * ARCSEC * np.random.default_rng(1).standard_normal(12)[(time / 6.0).astype(int)]
    output = made.output_angle + settled
    given = {"time": time, "input": made.input_angle, "output": output, "torque": made.torque}
    fit = linearise(prepared(given), CONFIGURED, POINT).with_noise(())
    assert (passing(fit, (), ranked(fit, (), [RESTS]), 100) is not None) is expected


def test_a_second_smooth_law_has_to_be_more_than_the_first_one_s_shape(made: LinearisedFit) -> None:
    """Lines are judged by themselves."""
    (first, *_) = ranked(made, (), [EFFECTS["coulomb_windup"]])
    chosen = ((first.effect, first.nonlinear),)
    settled = made.corrected(chosen)
    whole = settled.amplitude(*chosen[0], settled.fit(chosen)[0][settled.places(chosen)[0]])
    assert of_shapes(settled, chosen, EFFECTS["hysteresis"]) == pytest.approx(0.08 * whole)
    assert of_shapes(settled, (), EFFECTS["hysteresis"]) == 0.0
    assert of_shapes(settled, chosen, EFFECTS["input_encoder_eccentricity"]) == 0.0


def test_what_stays_beside_the_first_law_s_other_shapes_is_none_of_them() -> None:
    """No loop has a wrong zero of the torque in it; a friction that goes by another power is its own law."""
    offset, viscous, dry = (EFFECTS[name] for name in ("torque_offset", "viscous_windup", "coulomb_windup"))
    looped = bench(FRICTION, lambda signals: 0.4 * signals.predicted_torque_slope)
    both = RUBBING, (offset, ())
    looped = looped.corrected(both)
    assert LEAST_SIZE < size(looped, both[:1], offset, ()) < of_shapes(looped, both[:1], offset)
    assert not only_corrects_shape(looped, both, 1)

    def greased(signals: Signals) -> np.ndarray:
        return (
            3.0
            * signals.predicted_torque_slope
            * np.sign(signals.speed)
            * np.abs(signals.speed / 50.0) ** 0.85
        )

    slow = bench(greased)
    (second, *_) = ranked(slow, ((viscous, (1.0,)),), [dry])
    both = (viscous, (1.0,)), (dry, second.nonlinear)
    slow = slow.corrected(both)
    assert size(slow, both[:1], *both[1]) > LEAST_SIZE
    assert only_corrects_shape(slow, both, 1)


def test_another_law_of_torsion_is_no_shape_of_it(made: LinearisedFit) -> None:
    """It is what hardening is."""
    hardening = EFFECTS["torsional_hardening"]
    assert imitated(made, (), hardening, (14.0, 48.0, 0.01)) == 0.0


def test_what_slow_noise_does_is_no_drift_with_temperature(long: Record) -> None:
    """Beside zeros of three recordings: a drift by temperature lasts, slow noise does not."""
    drift, time = EFFECTS["thermal_drift"], long.time
    bag = np.arange(long.size) * 3 // long.size
    zeros = np.array([0.0, 60.0, -40.0])[bag] * ARCSEC
    rest = dataclasses.replace(
        long, temperature=25.0 + time / 20.0, bag=bag, output_angle=long.output_angle + zeros
    )
    slow = np.repeat(np.random.default_rng(1).standard_normal(30), -(-long.size // 30))[: long.size]
    for part, lasts in (
        (of(drift, drift=0.6 * ARCSEC, lag=0.0), True),
        (lambda signals: ARCSEC * np.interp(signals.time, time, slow), False),
    ):
        assert lasting(bench(part, record=rest), (), drift, (0.0,)) is lasts


def counting(fit: LinearisedFit, output_step: float, input_step: float = 0.0) -> LinearisedFit:
    """The same record by encoders that count [rad], with its noise."""
    rounded = {
        name: step * np.round(getattr(fit.data.source, name) / step)
        for name, step in (("output_angle", output_step), ("input_angle", input_step))
        if step
    }
    return linearise(dataclasses.replace(fit.data.source, **rounded), CONFIGURED, POINT).with_noise(())


def test_what_counts_of_an_encoder_may_look_like_is_no_cause(plain: LinearisedFit) -> None:
    step, delay, ball = 6.0 * ARCSEC, EFFECTS["stream_delay"], EFFECTS["bearing_passage"]
    coarse, motor = counting(plain, step), counting(plain, 0.0, RATIO * step)
    half = pytest.approx(0.5 * step / np.sqrt(12.0), rel=0.01)
    for fit, effect, nonlinear, least in (
        (coarse, delay, (), half),
        (motor, delay, (), half),
        (motor, ball, (0.45, 1.0), half),
        (coarse, ball, (0.45, 1.0), LEAST_SIZE),
        (motor, ball, (0.45, 0.0), LEAST_SIZE),
        (coarse, EFFECTS["torque_offset"], (), LEAST_SIZE),
        (plain, ball, (0.45, 1.0), LEAST_SIZE),
        (plain, delay, (), LEAST_SIZE),
    ):
        assert least_size(fit, effect, nonlinear) == least


def turning(order: float, step: float) -> LinearisedFit:
    """A constant speed at which the output's counts pass as often as samples but for a wave of some order."""
    record = swinging(40.0)
    speed = 200.0 * step * RATIO / (1.0 - order * step * RATIO / (2.0 * np.pi))
    angle, torque = speed * record.time + 1e-3 * np.sin(record.time), 20.0 + 0.02 * record.torque
    output = angle / RATIO + transmission_error(TRUE, angle, torque)
    output += 0.1 * step * np.random.default_rng(2).standard_normal(record.size)
    steady = dict.fromkeys(("torque", "reported_torque"), torque) | {"speed": np.full(record.size, speed)}
    moved = dataclasses.replace(record, input_angle=angle, output_angle=output, **steady)
    return linearise(moved, CONFIGURED, POINT)


def test_a_line_that_the_counts_make_at_a_speed_that_stays_is_no_bearing() -> None:
    """A bearing's of the same size is one, though both are less than half the rounding."""
    ball, step, order = EFFECTS["bearing_passage"], 60.0 * ARCSEC, 9.7
    for fit, is_one in (
        (counting(turning(order, step), step), False),
        (counting(bench(of(ball, amplitude=8.0 * ARCSEC, phase=0.3, order=order, slips=1.0)), step), True),
    ):
        best = ranked(fit, (), [ball])[0]
        assert best.p_value < 1e-12
        chosen = ((ball, (best.nonlinear[0], 1.0)),)
        assert size(fit, (), *chosen[0]) < 0.5 * fit.data.counted
        assert needed(fit, chosen) == (chosen if is_one else ())


def test_a_wave_of_one_period_a_count_is_no_encoder_s() -> None:
    """An encoder's own of as many periods is one where no output counts so."""
    lines, order, record = EFFECTS["encoder_interpolation"], 64.0, swinging()
    torque, step = 20.0 + 0.02 * record.torque, 2.0 * np.pi / (RATIO * order)
    output = record.input_angle / RATIO + transmission_error(TRUE, record.input_angle, torque)
    output += NOISE * np.random.default_rng(3).standard_normal(record.size)
    steady = dict.fromkeys(("torque", "reported_torque"), torque)
    light = linearise(dataclasses.replace(record, output_angle=output, **steady), CONFIGURED, POINT)
    wave = 60.0 * ARCSEC * np.cos(order * record.input_angle)
    own = dataclasses.replace(light.data.source, output_angle=output + wave)
    chosen = ((lines, (order,)),)
    for fit, is_one in (
        (counting(light, step), False),
        (linearise(own, CONFIGURED, POINT).with_noise(()), True),
    ):
        assert size(fit, (), *chosen[0]) > 10.0 * LEAST_SIZE
        assert needed(fit, chosen) == (chosen if is_one else ())


def test_a_loop_has_to_be_more_than_torsion_whose_torque_is_a_little_late(made: LinearisedFit) -> None:
    """It may come to the fit all the same: another cause may then show beside it, and take its place."""
    loop, whole = EFFECTS["hysteresis"], made.whole
    late = np.interp(whole.time - 3.0 / 200.0, whole.time, whole.torque) - whole.torque
    lags = (whole.predicted_torque_slope * late)[made.data.mask & (whole.time > 0.1)]
    assert least_size(made, *RUBBING) == pytest.approx(np.std(lags), rel=0.05)
    assert least_size(made, *RUBBING) > 2.0 * LEAST_SIZE
    assert least_size(made, EFFECTS["thermal_drift"], (1.0,)) == LEAST_SIZE
    assert of_shapes(made, (), loop) == 0.0


def test_a_loop_and_teeth_have_to_be_more_than_what_noise_of_the_torque_does() -> None:
    """What bends the torsion by a smoothed torque that is still off by some 0.1 N m is neither of these."""
    record, rng = swinging(), np.random.default_rng(3)
    real = 0.1 * record.torque
    least = []
    for noise in (0.0, 1.5):
        torque = real + noise * rng.standard_normal(record.size)
        given = {"time": record.time, "input": record.input_angle, "output": record.output_angle}
        fit = linearise(prepared({**given, "torque": torque}), CONFIGURED, POINT)
        least.append(least_size(fit, *RUBBING))
    off = fit.whole.predicted_torque_slope * (fit.whole.torque - real)
    assert least[1] > max(np.std(off[fit.data.at]), 2.0 * least[0])
    assert least_size(fit, EFFECTS["circular_spline_pitch"], ()) == least[1]
    assert least_size(fit, EFFECTS["torque_offset"], ()) == LEAST_SIZE


def test_a_runout_beside_a_large_delay_is_no_mended_shape() -> None:
    """A delay has no shape of its own: a hundredth of it may be a cause."""
    late = (EFFECTS["stream_delay"], ())
    made = bench(of(late[0], delay=2e-3)).corrected((late,))
    whole = made.amplitude(*late, made.fit((late,))[0][made.places((late,))[0]])
    assert of_shapes(made, (late,), EFFECTS["output_runout"]) < 0.01 * whole
