"""Search for causes by evidence: causes named on small records, and signals that are no cause."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, POINT, TRUE, Part, bench, chosen_set, of, solved, swinging
from joint_records import ARCSEC, NOISE, RATIO, joint, prepared

from hd_diag.diagnosis import diagnosis
from hd_diag.diagnosis.calibration import MISFIT, USUAL_SLOW
from hd_diag.diagnosis.diagnosis import _NO_CAUSES, _described
from hd_diag.diagnosis.evidence import search as module
from hd_diag.diagnosis.evidence.naming import own_part, standings
from hd_diag.diagnosis.evidence.search import Found, begun, candidates, restarted, search
from hd_diag.diagnosis.evidence.sets import Remainders, Set
from hd_diag.diagnosis.evidence.solution import Solution, motor_deviations, parameters_of, solution
from hd_diag.diagnosis.evidence.unexplained import with_table
from hd_diag.diagnosis.evidence.unmodelled_terms import UNMODELLED_TERMS
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.fit_parameters import COMPLIANCE, CUP, DATUM
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.diagnosis.fit.refit import AMBIGUOUS, Refit, refit
from hd_diag.diagnosis.gain import Rms, held_out, measured_gain
from hd_diag.diagnosis.record import Record
from hd_diag.drive import transmission_error
from hd_diag.effects.effect import Stage
from hd_diag.effects.quantity import turning
from hd_diag.effects.remainders import SPEED, TORQUE
from hd_diag.effects.signals import Signals

ECCENTRIC = {"amplitude": 500.0 * ARCSEC, "direction": 1.0, "second_amplitude": 0.0, "second_direction": 0.0}
CENTRED = fit_parameters.vector(CONFIGURED, CONFIGURED)
(CREEP,) = (term for term in UNMODELLED_TERMS if term.name == "creep")


class Search(NamedTuple):
    """Solution of a search, and the named causes, each with its class of alternatives."""

    whole: Solution
    named: dict[str, tuple[str, ...]]


def searched(*starts: LinearisedFit) -> Search:
    """Search from these starts; the first start covers all rows."""
    found = search([*starts], starts[0], np.random.default_rng(0))
    standing = standings(found)
    whole = with_table(solution(found.best, standing, np.random.default_rng(0)))
    sure = {cause.effect.name: cause.alike for cause in whole.causes if not cause.standing.doubt}
    return Search(whole, {name: alike for name, alike in sure.items() if not {*alike} & {*_NO_CAUSES}})


def wave(order: float, size: float = 3.0) -> Part:
    return lambda signals: size * ARCSEC * np.cos(order * signals.output_angle - 1.0)


def told(record: Record, torque: np.ndarray, **changes: Any) -> Record:
    """The record with another reported torque."""
    return dataclasses.replace(record, torque=torque, reported_torque=torque, **changes)


def moved(record: Record, torque: np.ndarray, reported: np.ndarray | None = None, seed: int = 1) -> Record:
    output = record.input_angle / RATIO + transmission_error(TRUE, record.input_angle, torque)
    output += NOISE * np.random.default_rng(seed).standard_normal(record.size)
    return told(record, torque if reported is None else reported, output_angle=output)


def part(name: str, **values: float) -> Part:
    return of(EFFECTS[name], **values)


FRICTION = {"friction": 2.0, "way": 0.2, "creep_speed": 0.5, "stribeck": 0.5, "stribeck_speed": 8.0}


def shaped(name: str, sizes: list[float], nonlinear: tuple[float, ...] = ()) -> Part:
    effect = EFFECTS[name]
    return lambda signals: effect.response(signals, np.pad(sizes, (0, effect.size - len(sizes))), nonlinear)


OVAL = shaped("circular_spline_form", [0.0, 0.0, 1.44e-6, 1.08e-6], (1.0,))
PITCH = shaped("circular_spline_pitch", [2e-6, 1e-6, 1.5e-6, 0.5e-6, 0.4e-6, 0.3e-6])
HURT = (0.0, 60 * CONFIGURED.mesh.geometry.slot_pitch, 0.0)
AGAINST = {"bending_reach": 9.0, "sharpness": 1.6, "slipping_reach": 2.0, "spread": 1.5}
FILTER = part("hysteresis", bending_amplitude=1e-4, slipping_amplitude=-9e-5, **AGAINST)
DRIFT = part("thermal_drift", drift=2.0 * ARCSEC, lag=1.0)
RUNOUT = part("output_runout", amplitude=20.0 * ARCSEC, direction=0.3)


def creeping(signals: Signals) -> np.ndarray:
    return 10.0 * ARCSEC * CREEP.columns(signals, ())[:, 1]


def warming() -> Record:
    record = swinging()
    return dataclasses.replace(record, temperature=np.linspace(25.0, 34.0, record.size))


def walking(signals: Signals) -> np.ndarray:
    steps = np.random.default_rng(0).standard_normal(2 * signals.size)
    return 0.1 * ARCSEC * np.cumsum(steps)[: signals.size]


def counting(output_step: float, input_step: float = 0.0) -> LinearisedFit:
    record = swinging()
    rounded = {
        name: step * np.round(getattr(record, name) / step)
        for name, step in (("output_angle", output_step), ("input_angle", input_step))
        if step
    }
    return linearise(dataclasses.replace(record, **rounded), CONFIGURED, POINT).with_noise(())


def arm(*parts: Part) -> LinearisedFit:
    """Fit of a joint that carries a weight: its torque follows the output's position."""
    record = swinging()
    return bench(*parts, record=moved(record, 40.0 * np.cos(record.input_angle / RATIO + 0.6)))


def late() -> LinearisedFit:
    record = swinging()
    return bench(record=told(record, np.interp(record.time - 0.015, record.time, record.torque)))


def of_one_direction() -> LinearisedFit:
    record = swinging()
    angle = 60.0 * record.time + 5.0 * np.sin(record.time)
    torque = 20.0 * np.sin(record.time)
    output = angle / RATIO + transmission_error(TRUE, angle, torque + 3.0)
    output += NOISE * np.random.default_rng(0).standard_normal(record.size)
    return bench(record=prepared({"time": record.time, "input": angle, "output": output, "torque": torque}))


CAUSES = {
    "friction": (lambda: bench(part("coulomb_windup", **FRICTION)), {"coulomb_windup"}),
    "viscous": (lambda: bench(part("viscous_windup", friction=1.5, exponent=1.0)), {"viscous_windup"}),
    "a ball": (lambda: bench(wave(45.5)), {"bearing_passage"}),
    "pitch": (lambda: bench(PITCH), {"circular_spline_pitch"}),
    "a slot": (lambda: bench(shaped("tooth_damage", [2e-5, 2e-5], HURT)), {"tooth_damage"}),
    "oval and zero": (
        lambda: bench(OVAL, part("torque_offset", offset=-1.5)), {"circular_spline_form", "torque_offset"}
    ),
    "warm": (lambda: bench(DRIFT, record=warming()), {"thermal_drift"}),
    "off centre": (lambda: arm(RUNOUT), {"output_runout"}),
    "another ratio": (lambda: bench(lambda signals: 3e-5 * signals.output_angle), {"ratio_error"}),
    "one direction": (of_one_direction, {"torque_offset", "coulomb_windup"}),
}  # fmt: skip
NONE = {
    "lines": lambda: bench(wave(45.0), wave(87.0)),
    "beside the gear's": lambda: bench(wave(99.0), wave(45.0)),
    "beat": lambda: bench(wave(47.0), wave(49.0)),
    "counts of the output": lambda: counting(6.0 * ARCSEC),
    "counts of the input": lambda: counting(0.0, RATIO * 6.0 * ARCSEC),
    "an arm that bends": lambda: arm(lambda signals: 3e-5 * (signals.torque / 40.0) ** 3),
    "slow noise": lambda: bench(walking, record=swinging(5.0)),
    "a filter": lambda: bench(FILTER),
    "late torque": late,
    "creep": lambda: bench(creeping, record=warming()),
    "wear": lambda: bench(part("wear_backlash", clearance=8e-6)),
    "hardening": lambda: bench(shaped("torsional_hardening", [-6e-6, 8e-6], (11.0, 30.0, 0.1))),
}


# Slow cases.
SLOW = {"pitch", "a slot", "oval and zero", "friction", "viscous", "off centre", "one direction"}
SLOW |= {"beside the gear's", "wear", "beat", "counts of the input"}


KNOWN = {"beat": "two lines that beat over a quarter of a turn are told as one of a bearing"}


def cases(names: dict[str, object]) -> list[object]:
    known = {name: [pytest.mark.xfail(reason=why)] for name, why in KNOWN.items()}
    slow = {name: [pytest.mark.slow] for name in SLOW}
    return [pytest.param(name, marks=[*known.get(name, ()), *slow.get(name, ())]) for name in names]


@pytest.mark.parametrize("name", cases(CAUSES))
def test_a_cause_is_named_and_no_other(name: str) -> None:
    """The named class contains the cause; it has alternatives if the record cannot distinguish them."""
    made, causes = CAUSES[name]
    found = searched(made())
    classes = [{*alike} for alike in found.named.values()]
    assert len(classes) == (1 if name in ("one direction", "off centre") else len(causes))
    assert set.union(*classes) >= causes
    assert all(alike & causes for alike in classes)


@pytest.mark.parametrize("name", cases(NONE))
def test_what_is_no_cause_is_not_named(name: str) -> None:
    assert searched(NONE[name]()).named == {}


def test_lines_of_the_output_are_described() -> None:
    """Their orders belong to no bearing of the wave generator."""
    table = searched(bench(wave(62.0), wave(87.0))).whole.table
    assert sorted((row.order, row.frame) for row in table) == [(62.0, "output"), (87.0, "output")]
    assert [row.amplitude / ARCSEC for row in table] == pytest.approx([3.0, 3.0], rel=0.1)


def test_a_term_whose_columns_go_with_the_rows_moves_to_others() -> None:
    """A creep has a constant for each stretch, and rows of another record may have more stretches."""
    record = swinging()

    def cut(parts: int) -> LinearisedFit:
        stretch = np.arange(record.size) * parts // record.size
        return linearise(dataclasses.replace(record, stretch=stretch), CONFIGURED, POINT).with_noise(())

    some, other = cut(2), cut(5)
    without = begun(some)
    with_creep = without.beside((CREEP, ()), {**without.widths, "creep": 1.0}).settled()
    moved = with_creep.moved_to(other).settled()
    assert moved.names == {"creep"}
    assert np.isfinite(moved.value)


def test_the_cause_is_first_and_what_is_chosen_is_no_candidate() -> None:
    loop = shaped("hysteresis", [1e-4, 6e-5], (9.0, 1.6, 2.0, 1.5))
    at = begun(bench(loop))
    first, *others = candidates(at)
    gains = [one.gain for one in others]
    assert first.name == "hysteresis"
    assert gains == sorted(gains, reverse=True)
    assert first.gain > gains[0]
    beside = candidates(at.beside(first.item, first.widths).settled())
    assert "hysteresis" not in {one.name for one in beside}
    assert max(one.gain for one in beside) < 0.1 * first.gain


def test_nonlinear_values_are_fitted_before_blocks_are_asked() -> None:
    """At the nearest grid frequency a real resonance does not yet predict the held-out blocks."""
    at = begun(bench(shaped("resonance", [3.0 * ARCSEC, 0.0, 1.0], (2.0, 55.0, 0.02))))
    first, *_ = candidates(at)
    assert first.name == "resonance"
    assert not at.beside(first.item, first.widths).foretells("resonance")
    found = module.with_next(at)
    assert found.names == {"resonance"}
    assert found.foretells("resonance")


def instead_of(monkeypatch: pytest.MonkeyPatch, seeming: Set) -> None:
    """Offer no other candidate; a set without a cause becomes the given set."""
    monkeypatch.setattr(module, "candidates", lambda one: [])
    monkeypatch.setattr(Set, "without", lambda now, name: seeming)
    monkeypatch.setattr(Set, "settled", lambda now, rounds=0: now)


def test_of_two_sets_neither_gives_way_to_the_other_and_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each set may seem better by its own noise model, so a better set must be better by both."""
    at = begun(bench(OVAL))
    found, _ = module._better(at, {})
    assert found.names == {"circular_spline_form"}
    seeming = dataclasses.replace(at, value=found.value + 1e6)
    own = module._gain(seeming, found)
    assert module._gain(found, at) > 0.0 > own
    instead_of(monkeypatch, seeming)
    other, instead = module._exchanged(dataclasses.replace(found, before=None), {})
    assert other is None
    assert instead == {"circular_spline_form": {"": pytest.approx(own)}}


def test_a_cause_counts_by_the_best_of_its_forms() -> None:
    """The odds of another form of the same cause do not reduce its probability."""
    found, _ = module._better(begun(bench(OVAL)), {})
    odds = {"": -50.0, "circular_spline_form": -33.0, "circular_spline_pitch": -12.0}
    (standing,) = standings(Found(found, instead={"circular_spline_form": odds})).values()
    assert standing.alike == ("circular_spline_form",)
    assert standing.probability > 0.99


def test_without_its_last_cause_a_set_is_worth_what_it_was_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other parameters may have moved to make room, and steps may not lead back from there."""
    at = begun(bench(OVAL))
    found = module.with_next(at)
    assert found.before.names == at.names
    instead_of(monkeypatch, dataclasses.replace(at, value=found.value - 1e6))
    for before, odds in ((found.before, at.on(found).value - found.value), (None, -1e6)):
        _, instead = module._exchanged(dataclasses.replace(found, before=before), {})
        assert instead == {"circular_spline_form": {"": pytest.approx(odds, abs=1e-6)}}


def test_a_candidate_that_lacks_little_is_settled_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parameter steps can gain more than their slopes predict, for example with a wrong torque zero."""
    at = begun(bench(OVAL))
    for lacks, tried in ((1.0, True), (3.0, False)):
        lacking = [candidates(at)[0]._replace(gain=-lacks)]
        monkeypatch.setattr(module, "candidates", lambda one, lacking=lacking: lacking)
        assert (module.with_next(at) is not None) is tried


def test_what_a_candidate_brings_is_the_evidence_of_the_set_with_it() -> None:
    at = begun(bench(wave(45.5)))
    best = candidates(at)[0]
    evidence = at.evidence([("?", best.item)])
    wider = {"?" if name == best.name else name: width for name, width in best.widths.items()}
    gain = evidence.log(wider) - evidence.log(at.widths)
    presence = at.beside(best.item, best.widths).presence - at.presence
    assert best.gain == pytest.approx(gain + presence, abs=1e-6)


def test_without_a_measured_torque_only_what_the_motion_proves_takes_part() -> None:
    record = dataclasses.replace(swinging(), has_torque=False)
    blind = linearise(record, CONFIGURED, POINT).with_noise(())
    found = {one.name for one in candidates(chosen_set(blind).valued())} & EFFECTS.keys()
    proved = {effect.name for effect in blind.data.searched if blind.data.testable(effect)[0]}
    assert found == {one for one in proved - {"torsional_hardening"} if EFFECTS[one].stage != Stage.TORQUE}
    assert "input_encoder_eccentricity" in found
    assert not {"coulomb_windup", "thermal_drift"} & found


def test_parameters_are_searched_for_again_under_the_torque_that_friction_leaves() -> None:
    """6 N m shift the torque at which the flanks change; columns at wrong parameters miss this."""
    record, dry = swinging(), EFFECTS["coulomb_windup"]
    rubbing = moved(record, record.torque + 6.0 * np.tanh(record.speed / 2.0), record.torque)
    fit = linearise(rubbing, CONFIGURED, fit_parameters.vector(CONFIGURED, CONFIGURED)).with_noise(())
    found = restarted(chosen_set(fit, (dry, (0.003, 1.0, 0.5, 3.0))).valued(), np.random.default_rng(0))
    assert found[DATUM] == pytest.approx(POINT[DATUM], abs=2.0)
    assert found[:2] == pytest.approx(POINT[:2], abs=0.3)


@pytest.mark.parametrize(("zero", "led"), [(-2.6, True), (-2e-3, False)])
def test_a_zero_that_puts_torques_on_the_other_flank_is_tried_at_its_size(zero: float, led: bool) -> None:
    """A joint with almost no load, whose sensor has an offset larger than the load."""
    record = swinging()
    real = 0.4 * np.sin(2.0 * np.pi * record.time / 5.3) - 0.3
    at = begun(linearise(moved(record, real, real - zero, 0), CONFIGURED, POINT).with_noise(()))
    found = module._with_torque_zero(at.at(POINT), zero)
    assert (found is not None) is led
    if found is not None:
        assert found.names == {"torque_offset"}
        assert found.value > at.on(found).value + 10.0
        assert np.abs(found.fit.parameters - POINT)[:4].max() < 1.0


@pytest.mark.slow
def test_parameters_that_imitate_a_delay_are_left_for_those_as_configured() -> None:
    away = np.array([-8.0, 9.0, 4.0, 0.0, 9.0, 2.0, 3.0])
    late = bench(of(EFFECTS["stream_delay"], delay=5e-3))
    found = searched(late.moved(POINT + away), late.moved(fit_parameters.vector(CONFIGURED, CONFIGURED)))
    assert found.named == {"stream_delay": ("stream_delay",)}
    assert np.abs(found.whole.fit.parameters - POINT)[:4].max() < 1.0


@pytest.mark.slow  # a whole diagnosis
def test_parameters_are_ambiguous_only_if_they_are_beside_all_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Several sets may fit equally well without the causes; only minima with the causes decide."""

    def doubtful(*given: Any, **named: Any) -> Refit:
        return dataclasses.replace(refit(*given, **named), doubt=AMBIGUOUS)

    monkeypatch.setattr(diagnosis, "refit", doubtful)
    found = diagnosis.diagnose(swinging(8.0), CONFIGURED, np.random.default_rng(0))
    assert found.refitted.trustworthy


@pytest.mark.slow
def test_what_a_motor_needs_itself_is_no_cause() -> None:
    """Current as torque: gain within its prior, friction and inertia relative to it; no cause is named.

    The load-dependent friction is in proportion to the link's torque, which is less than the current's.
    """
    record = swinging()
    speed = np.gradient(record.input_angle, record.time)
    rate = np.gradient(speed, record.time)
    friction = (3.0 + 0.1 * np.abs(record.torque)) * np.tanh(speed / 2.0)
    needed = record.torque + friction + 2.0 * rate / 100.0
    found = searched(bench(record=told(record, needed, by_current=True)))
    fit, chosen = found.whole.fit, found.whole.chosen
    assert found.named == {}
    ((item, sized),) = (one for one in fit.sized(chosen, fit.fit(chosen)[0]) if one[0][0].given)
    assert item[0].name == "motor_current"
    values = {name: value for name, (value, _) in item[0].to_physical(sized, item[1]).items()}
    gain = 1.0 + values["relative_error"]  # a stiffer gear with a larger constant fits almost as well
    assert abs(gain - 1.0) < 2.0 * 0.2
    found = [values[name] / gain for name in ("friction", "loaded_friction", "inertia")]
    assert np.all(np.abs(np.subtract(found, [3.0, 0.1, 2.0])) < [0.15, 0.01, 0.2])
    assert np.std(fit.remainder(chosen)) < 1.05 * NOISE


def test_stiffness_and_a_current_s_constant_are_open_by_one_factor() -> None:
    """Twice the torque on half the compliance gives the same error: every ± includes the prior's width."""
    made = bench(record=dataclasses.replace(swinging(), by_current=True))
    found = solved(settle(made, made.data.given))
    parameters, covariance = parameters_of(found)
    configured = fit_parameters.vector(CONFIGURED, CONFIGURED)
    assert parameters[COMPLIANCE] == pytest.approx(configured[COMPLIANCE], rel=1e-9)
    width = 0.15 * parameters[COMPLIANCE]
    assert covariance[COMPLIANCE, COMPLIANCE] == pytest.approx(width**2, rel=1e-3)
    assert covariance[CUP, COMPLIANCE] == pytest.approx(0.15 * parameters[CUP] * width, rel=1e-3)
    fit = found.fit
    deviations, (_, sized) = motor_deviations(found), fit.sized(found.chosen, fit.fit(found.chosen)[0])[0]
    assert deviations["relative_error"] > 0.15 * (1.0 + sized[0]) > 0.1


def test_friction_under_load_by_a_current_has_these_derivatives() -> None:
    """Compare `changes` with finite differences, also where the torque behind the motor changes sign."""
    effect, rng = EFFECTS["motor_current"], np.random.default_rng(0)
    columns, size = rng.normal(0.0, 5.0, (500, 5)), np.array([0.2, 0.8, 0.05, 0.5, 0.1])
    steps = 1e-7 * np.eye(5)
    ends = ((effect.more(columns, size + step), effect.more(columns, size - step)) for step in steps)
    slopes = [(above - below) / 2e-7 for above, below in ends]
    assert effect.changes(columns, size) == pytest.approx(np.stack(slopes, axis=1), abs=1e-5)


def slipping(signals: Signals) -> np.ndarray:
    """Wave (n,) of amplitude one of a ball whose phase wanders."""
    angle = signals.wave_generator_angle
    way = np.cumsum(np.abs(np.diff(angle, prepend=angle[0])))
    return np.cos(10.25 * angle + 2.5 * np.sin(4.0 * way / way[-1]))


def test_a_ball_whose_phase_wanders_is_no_misfit_though_nothing_foretells_it() -> None:
    """A running model has only the mean phase; the wandering is as unknown as the next encoder zero."""
    ball, record = EFFECTS["bearing_passage"], swinging(40.0)
    test, which = held_out(record)
    added = 5.0 * ARCSEC * slipping(linearise(record, CONFIGURED, POINT).whole)
    record = dataclasses.replace(record, output_angle=record.output_angle + added)
    fit = settle(linearise(record, CONFIGURED, POINT, rows=~test), ((ball, (10.25, 1.0)),))
    found, plain = solved(fit, (ball, (10.25, 1.0))), settle(fit, ())
    every = linearise(record, CONFIGURED, fit.parameters).beside(fit.present)
    rms, _ = measured_gain(record, test, which, plain, found, every, np.random.default_rng(0))
    assert rms.extended > MISFIT * rms.noise
    assert rms.misfit.value == pytest.approx(1.0, abs=0.1)
    (said,) = _described(record, [], rms, True)
    assert "wanders" in said.description


def test_what_is_left_only_as_the_model_runs_is_said() -> None:
    rms = Rms(*(ARCSEC * value for value in (9.0, 5.0, 1.5, 1.5, 1.0, 1.5, 1.0, 0.9, 1.1)))
    assert not rms.misfit.suspected
    (said,) = _described(swinging(), [], rms, False)
    assert "only as the model runs" in said.description
    assert said.amplitude == pytest.approx(np.sqrt(2.0 * (1.5**2 - 1.0)) * ARCSEC)
    assert _described(swinging(), [], dataclasses.replace(rms, extended=1.2 * ARCSEC), False) == ()


def test_a_loop_is_slow_and_an_encoder_is_not() -> None:
    loop, encoder = EFFECTS["hysteresis"], EFFECTS["input_encoder_eccentricity"]
    size = {"bending_amplitude": 5e-5, "slipping_amplitude": 5e-5, **AGAINST}
    fit = bench(of(loop, **size), of(encoder, **ECCENTRIC))
    chosen = ((loop, loop.from_physical(size)[1]), (encoder, ()))
    (*_, slow), (*_, within) = (own_part(fit, chosen, tuple({*chosen} - {one}), one) for one in chosen)
    assert slow > 0.8
    assert within < 0.02


@pytest.mark.parametrize(
    ("place", "sizes", "sensible"),
    [((0.35, 0.06), (-20, 1), True), ((0.0, 1.0), (-30, 20), False), ((0.0, 1.0), (30, 20), True)],
)
def test_two_causes_undo_each_other_if_of_a_size(place: tuple, sizes: tuple, sensible: bool) -> None:
    (bumpy,) = (term for term in UNMODELLED_TERMS if term.name == "place")
    items = ((EFFECTS["output_runout"], ()), (bumpy, place))

    def both(signals: Signals) -> np.ndarray:
        bump = bumpy.columns(signals, place)[:, 0]
        return np.asarray(ARCSEC * (sizes[0] * np.cos(signals.output_angle) + sizes[1] * bump))

    assert chosen_set(bench(both), *items).sensible is sensible


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_cause_that_another_torsion_undoes_is_none(sign: float) -> None:
    """Under a weight the torque follows the output's position, as an encoder's eccentricity does."""
    record, stiff = swinging(), POINT.copy()
    stiff[COMPLIANCE] *= 0.5
    torque = 35.0 + 30.0 * np.cos(record.input_angle / RATIO + 0.6) + 0.5 * np.sin(4.0 * record.time)
    both = (fit_parameters.drive_of(point, CONFIGURED) for point in (POINT, stiff))
    true, stiffer = (transmission_error(drive, record.input_angle, torque) for drive in both)
    waves = np.hstack([turning(order * record.input_angle / RATIO) for order in (1, 2)])
    read = sign * waves @ np.linalg.lstsq(waves, true - stiffer, rcond=None)[0]
    noise = NOISE * np.random.default_rng(1).standard_normal(record.size)
    output = record.input_angle / RATIO + stiffer + read + noise
    fit = linearise(told(record, torque, output_angle=output), CONFIGURED, stiff).with_noise(())
    item, usual = (EFFECTS["output_encoder_eccentricity"], ()), Remainders(((TORQUE, (2e-6, 0.0, 70.0)),))
    there = Set(fit, usual, (item,), widths={TORQUE.name: 1.0, item[0].name: 10.0})
    assert there.sensible is (sign < 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_that_is_usual_undoes_no_friction(sign: float) -> None:
    """Two frictions must add up; if one opposes the other, the cause only imitates another law."""
    friction = EFFECTS["viscous_windup"]
    values = {"friction": 6.0, "exponent": 0.5}
    item = (friction, friction.from_physical(values)[1])

    def both(signals: Signals) -> np.ndarray:
        part = of(friction, **values)(signals)
        laws = SPEED.columns(signals, (1.0, -100.0, 100.0))
        return np.asarray(part + 0.9 * sign * laws @ np.linalg.lstsq(laws, part, rcond=None)[0])

    usual = Remainders(((SPEED, (USUAL_SLOW, -100.0, 100.0)),))
    widths = {"function_of_speed": 100.0, friction.name: 10.0}
    there = Set(bench(both, record=swinging(60.0)), usual, (item,), widths=widths)
    assert there.sensible is (sign > 0.0)


def test_a_displacement_that_some_rows_do_not_show_is_found_on_all() -> None:
    """A search begins without displacement, which costs nothing on these rows; all rows correct it."""
    small = fit_parameters.vector(joint(eccentricity__magnitude=6e-6).drive, CONFIGURED)
    record = swinging(30.0, drive=fit_parameters.drive_of(small, CONFIGURED))
    every = linearise(record, CONFIGURED, small).with_noise(())
    few = linearise(record.select(np.arange(record.size) < record.size // 10), CONFIGURED, small)
    held = dataclasses.replace(few.moved(CENTRED), held=(0, 1, 2, 3))
    found = search([few.with_noise(()), held.with_noise(())], every, np.random.default_rng(0)).best
    assert not found.names
    assert found.fit.parameters[:2] == pytest.approx(small[:2], abs=0.5)
    none = linearise(swinging(30.0, drive=CONFIGURED), CONFIGURED, CENTRED).with_noise(())
    apart = dataclasses.replace(none, held=(0, 1, 2, 3))
    found = search([none.moved(small), apart], none, np.random.default_rng(0)).best
    assert found.fit.held == (0, 1, 2, 3)
    assert found.fit.parameters[:4] == pytest.approx(0.0, abs=1e-9)


def test_what_has_no_known_cause_is_looked_for_again_on_all_rows() -> None:
    """There a cause may explain it better, which the term's presence would hide."""
    line, ball = (UNMODELLED_TERMS[3], (42.0,)), (EFFECTS["bearing_passage"], (0.45, 0.0))
    at = chosen_set(bench(wave(42.3)), line, ball).valued()
    assert at.names == {"output_line_1", "bearing_passage"}
    assert module._of_causes(at).names == {"bearing_passage"}


@pytest.mark.parametrize("exponential", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_usual_wave_that_falls_and_turns_is_no_cause(exponential: bool) -> None:
    """Other flanks carry torque of the other sign, and the wave's phase changes with them."""

    def usual(signals: Signals) -> np.ndarray:
        load = signals.torque / CONFIGURED.rated_torque
        phase, rest = 2.0 * signals.input_angle + 0.3 * np.tanh(load), np.abs(load) / 0.6
        size = np.exp(-rest / 1.5) if exponential else 1.0 / (1.0 + rest)
        return np.asarray(5.0 * ARCSEC * size * np.cos(phase - 1.0))

    assert searched(bench(usual, record=swinging(60.0))).named == {}


@pytest.mark.parametrize(("member", "number", "further"), [(0, 6, 0.5), (0, 6, 1.0), (1, 2, 0.0)])
def test_a_wave_of_teeth_that_falls_with_the_load_is_no_other_cause(
    member: int, number: int, further: float
) -> None:
    """Damage, a ripple of the torque sensor or of the encoder explains it better than a constant wave."""

    def falling(signals: Signals) -> np.ndarray:
        load = np.abs(signals.torque / CONFIGURED.rated_torque)
        size = 9.0 * np.exp(-1.5 * load) if member else 1.5 / (1.0 + load)
        angle = (signals.input_angle, signals.flexspline_angle)[member] - 0.2
        waves = np.cos(number * angle) + further * np.cos((number + 2) * angle)
        return np.asarray(ARCSEC * size * waves)

    assert searched(bench(falling, record=swinging(60.0))).named.keys() <= {"flexspline_pitch"}


def test_a_cause_does_not_take_the_gears_own_wave_for_its_further_order() -> None:
    """The usual wave (two per turn, falling with load) exceeds the eccentric encoder's own once per turn."""
    encoder = EFFECTS["input_encoder_eccentricity"]

    def usual(signals: Signals) -> np.ndarray:
        load = np.abs(signals.torque / CONFIGURED.rated_torque)
        return np.asarray(7.0 * ARCSEC / (1.0 + load) * np.cos(2.0 * signals.input_angle - 1.0))

    found = searched(bench(of(encoder, **ECCENTRIC), usual, record=swinging(60.0)))
    assert found.named.keys() == {encoder.name}
    (cause,) = (one for one in found.whole.causes if one.effect.name == encoder.name)
    assert cause.amplitude == pytest.approx(ECCENTRIC["amplitude"] / RATIO / np.sqrt(2.0), rel=0.1)


def test_a_minimum_is_chosen_by_what_all_rows_will_tell() -> None:
    """On an eighth of the rows zero displacement has more evidence; all rows justify its four parameters."""
    given = {"eccentricity__magnitude": 1.5e-6, "eccentricity__direction": 0.6, "runout__magnitude": 6e-6}
    true = joint(**given).drive
    record, point = swinging(120.0, drive=true), fit_parameters.vector(true, CONFIGURED)
    every = linearise(record, CONFIGURED, point).with_noise(())
    few = linearise(record.select(np.arange(record.size) < record.size // 8), CONFIGURED, CENTRED)
    centred = begun(few.with_noise(()))
    assert centred.value > centred.at(point).settled(8).value
    best = search([few, few.moved(point)], every, np.random.default_rng(0)).best
    assert not best.names
    deviation = np.sqrt(np.diag(best.fit.fit(best.chosen)[1]))[:4]
    assert np.all(np.abs(best.fit.parameters[:4] - point[:4]) < 2.5 * deviation)
    assert np.all(deviation < 0.8)
