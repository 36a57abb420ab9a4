"""The kind of answer of a diagnosis, and whether the joint is normal."""

import dataclasses
import re
from typing import Any

import numpy as np
import pytest
import test_verdict as samples
from test_verdict import cause, diagnosis, found, function, refitted, rms_of

from hd_diag.diagnosis.action import advice
from hd_diag.diagnosis.diagnosis import Allowed, Diagnosis, imitated, parameter_sizes
from hd_diag.diagnosis.evidence.solution import Cause
from hd_diag.diagnosis.evidence.unexplained import Unexplained
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.refit import AMBIGUOUS
from hd_diag.diagnosis.judgement import Answer, Limited
from hd_diag.diagnosis.statements import sentence
from hd_diag.diagnosis.verdict import as_json
from hd_diag.effects.remainders import ORDERS, TORQUE

pytestmark = pytest.mark.usefixtures("accuracy_once")

ARCSEC = np.pi / 648000.0
MISFIT = rms_of(20.0, 19.5, 19.0, 19.0, 19.0, 19.0, 1.0, 0.9, 1.1)
NEAR = rms_of(20.0, 19.5, 1.25, 1.25, 1.25, 1.25, 1.0, 0.89, 1.07)
LATE = dataclasses.replace(MISFIT, offline=1.01 * ARCSEC)
SLOW = dataclasses.replace(MISFIT, slow=25.0, gear=1.2)
UNREPEATED = dataclasses.replace(MISFIT, noise_high=18.0 * ARCSEC, repeated=False)
SKIPPED = {"findings": (samples.SKIP,)}
UNIT = {"findings": (dataclasses.replace(samples.SKIP, name="unit"),)}
WRONG = {"findings": (samples.WRONG_RATIO,), **samples.ENDED}
AS_CONFIGURED = refitted(eccentricity=0.1 + 0.0j)


@pytest.mark.parametrize(
    ("made", "judged"),
    [
        ({}, "parameters"),
        ({"refitted": AS_CONFIGURED}, "as_configured"),
        ({"unexplained": (samples.LINE,)}, "described"),
        (SKIPPED, "causes"),
        ({"rms": MISFIT}, "misfit"),
        ({"rms": dataclasses.replace(SLOW, gear=1.4)}, "misfit"),
        ({"rms": SLOW}, "parameters"),  # the gear is judged despite a slow unknown part
        ({"rms": SLOW, "unexplained": (samples.LINE,)}, "described"),
        ({"found": found(functions=(function(TORQUE),))}, "described"),
        ({"found": found(cause("hysteresis", none=-3.0))}, "described"),
        ({"found": found(cause("hysteresis"), functions=(function(TORQUE),))}, "causes"),
        ({"rms": LATE}, "parameters"),  # signals are late in the running model
        ({"rms": UNREPEATED}, "parameters"),  # the whole residual may be noise
        ({"rms": dataclasses.replace(UNREPEATED, noise_high=14.0 * ARCSEC)}, "misfit"),
        (WRONG, "not_judged"),
    ],
)
def test_the_kind_of_answer(made: dict[str, Any], judged: str) -> None:
    told = as_json(diagnosis(**made), "joint_1")
    assert told["judgement"] == judged
    assert (told["normal"] is None) == (judged == "not_judged")


def test_a_cause_beside_a_misfit_is_a_misfit_and_said_first() -> None:
    made = diagnosis(cause("hysteresis"), rms=MISFIT)
    assert Answer(made).judgement == "misfit"
    assert sentence(Answer(made)).startswith("the model does not describe this record: 19.0 times the noise")
    assert "possible, but not named: hysteresis" in sentence(Answer(made))
    assert "no other cause is needed" not in sentence(Answer(diagnosis(rms=MISFIT)))


@pytest.mark.parametrize(
    ("alike", "changes", "told"),
    [
        (("coulomb_windup", "torque_offset", "viscous_windup", "stream_delay"), {}, True),
        (("coulomb_windup", "torque_offset", "viscous_windup", "stream_delay", "resonance"), {}, False),
        ((), {"refitted": refitted(AMBIGUOUS)}, True),
        ((), {"refitted": dataclasses.replace(refitted(), parameters=samples.AT_BOUND)}, False),
        ((), {"rms": MISFIT}, False),
    ],
    ids=["a small class", "a class nobody can use", "ambiguous parameters", "a bound", "more than noise"],
)
def test_what_the_record_cannot_tell_is_a_hint(alike: tuple, changes: dict[str, Any], told: bool) -> None:
    made = diagnosis(cause("hysteresis", alike=alike), **changes)
    content = as_json(made, "joint_1")
    assert [one["name"] for one in content["causes"]] == ["hysteresis"] * told
    assert [one["name"] for one in content["hints"]] == ["hysteresis"] * (not told)
    assert (content["judgement"] == "causes") is told
    assert ("possible, but not named: hysteresis" in content["verdict"]) is not told


@pytest.mark.parametrize(
    ("alike", "named"),
    [
        (("hysteresis",), 0),
        (("resonance",), 0),
        (("torque_sensor_ripple",), 0),
        (("output_runout", "coulomb_windup"), 0),
        (("output_runout", "output_encoder_eccentricity"), 0),  # gravity makes such a wave of a wrong torque
        (("input_encoder_eccentricity", "output_encoder_interpolation"), 1),
    ],
)
def test_by_a_motor_s_current_nothing_is_named_that_may_be_torque(alike: tuple[str, ...], named: int) -> None:
    one = cause(alike[0], alike=alike[1:])
    made = diagnosis(one, record=samples.BY_CURRENT)
    assert (len(made.causes), len(made.hints)) == (named, 1 - named)
    assert len(diagnosis(one).causes) == 1


def test_where_no_motion_repeats_noise_may_be_all_that_is_left_and_nothing_is_named() -> None:
    made = diagnosis(cause("hysteresis"), rms=UNREPEATED)
    assert made.causes == ()
    assert sentence(Answer(made)).startswith(
        "whether the model describes this record cannot be determined: 1.1 to 19.0 times the noise is left, "
        "and too little of the motion repeats to tell; "
    )


@pytest.mark.parametrize(
    ("none", "own", "rms", "named"),
    [
        (-20.0, 4.0, NEAR, True),  # 99.9997 % at less than twice the noise
        (-8.0, 4.0, NEAR, True),
        (-6.0, 4.0, NEAR, False),  # 99.75 % become 97.9 %
        (-6.0, 4.0, None, True),
        (-20.0, 0.525, NEAR, False),  # at deviation 0.01, it may be below the least size
        (-20.0, 0.525, None, True),
        (-1200.0, 4.0, UNREPEATED, False),  # 96.5 % at 19 times the noise
        (-1700.0, 4.0, UNREPEATED, True),
        (-1200.0, 4.0, SLOW, False),
        (-1700.0, 4.0, SLOW, True),
        (-1700.0, 4.0, MISFIT, False),  # other errors at the gear's lines may hide it
    ],
)
def test_evidence_counts_less_beside_more_than_noise(none: float, own: float, rms: Any, named: bool) -> None:
    """Log odds are divided by the square of residual over noise; a cause may then become a hint."""
    made = diagnosis(cause("hysteresis", none=none, own=own * ARCSEC), **({"rms": rms} if rms else {}))
    assert (len(made.causes), len(made.hints)) == (named, 1 - named)


def test_a_hint_is_likelier_than_not() -> None:
    for none, hints in ((-0.1, 1), (0.1, 0)):
        made = diagnosis(cause("hysteresis", none=none))
        assert (made.causes, len(made.hints)) == ((), hints)


@pytest.mark.parametrize(("gear", "share"), [(1.1, 0.0), (2.0, 0.1), (2.0, 0.5)])
def test_what_is_left_at_the_lines_may_be_in_a_displacement(gear: float, share: float) -> None:
    """The deviation grows by the displacement times residual over effect; for a runout alone by nothing."""
    made = diagnosis()
    nominal, given = fit_parameters.vector(made.configured, made.configured), (made.record, made.configured)
    parameters, runout = nominal + 8.0 * np.eye(7)[0], nominal + 1e-9 * np.eye(7)[2]
    size = parameter_sizes(*given, parameters)["eccentricity"]
    rms = dataclasses.replace(NEAR, noise=share * size / np.sqrt(2.0**2 - 1.15**2), gear=gear)
    found = imitated(rms, *given, parameters)
    assert size > 0.0
    assert found[:2] == pytest.approx(8.0 * share, rel=1e-9)
    assert not found[4:].any()
    assert not imitated(dataclasses.replace(NEAR, gear=gear), *given, runout).any()


def test_a_cause_that_foretells_no_more_than_the_configured_drive_is_a_hint() -> None:
    """The parameters may have followed noise: only against these does the cause seem to help."""
    made = diagnosis(cause("hysteresis"))
    assert (made.rms.refit, len(made.causes)) == (pytest.approx(5.0 * ARCSEC), 1)
    worse = dataclasses.replace(made.rms, nominal=3.2 * ARCSEC)
    assert diagnosis(cause("hysteresis"), rms=worse).causes == ()


def test_what_explains_most_is_said_first() -> None:
    (first, *_) = changed = Answer(diagnosis()).changes
    assert [change.explains for change in changed] == sorted((c.explains for c in changed), reverse=True)
    assert first.name == "eccentricity"


def loop(size: float) -> Cause:
    """A hysteresis of two elements [arcsec]."""
    made = cause("hysteresis")
    elements = np.full(made.coefficients.size, size / made.coefficients.size)
    exact = np.zeros_like(made.covariance)
    return dataclasses.replace(made, coefficients=ARCSEC * elements, covariance=exact)


SURE = r"\(more than 99\.9 % sure\)"
HINT = found(cause("output_runout", none=-3.0))
ALIKE = found(cause("output_runout", alike=("output_encoder_eccentricity",)))
UNUSUAL = found(functions=(function(TORQUE, 12.0 * ARCSEC),))
ECCENTRIC = "the eccentricity"


def creeping(arcsec: float) -> dict[str, Any]:
    """An unexplained part of an amplitude that is no line."""
    return {"unexplained": (Unexplained(0.0, "input", ARCSEC * arcsec, "", "", "creeps"),)}


def allowed(size: float) -> dict[str, Any]:
    """A limit from the tolerance [µm], for an eccentricity of 18.2 ± 0.3 µm."""
    return {"allowed": Allowed(1e-6 * size, "overlap")}


@pytest.mark.parametrize(
    ("made", "action", "light", "said"),
    [
        ({}, "nothing", "green", f"Nothing to do: the transmission error is within its limit {SURE}."),
        ({"refitted": AS_CONFIGURED}, "nothing", "green", "Nothing to do: .*"),
        ({"found": found(functions=(function(TORQUE, 10.0 * ARCSEC),))}, "nothing", "green", "Nothing .*"),
        # A line is part of the error that the catalogue allows.
        ({"found": found(functions=(function(ORDERS[1], 12.0 * ARCSEC),))}, "nothing", "green", "Nothing .*"),
        (SKIPPED, "inspect", "red", "Inspect: a step of 6480 arcsec .*: 1 tooth skipped."),
        (UNIT, "watch", "amber", "Watch: a step of .*"),
        ({"rms": MISFIT}, "watch", "not_judged", "Cannot be judged: the model does not describe this .*"),
        ({"found": HINT}, "watch", "amber", r"Watch: output runout, not proven \(95 % likely\)."),
        ({"found": UNUSUAL}, "watch", "amber", "Watch: the torsion's shape .* is larger than usual."),
        (creeping(12.0), "watch", "amber", r"Watch: a part that creeps \(12.00 arcsec\)."),
        (creeping(10.0), "nothing", "green", "Nothing .*"),
        (
            allowed(17.9),
            "watch",
            "amber",
            rf"Watch: {ECCENTRIC} may be beyond its limit: 18.2 ± 0.3 µm, allowed 17.9 µm \(84 % likely\).",
        ),
        # A certain excess is reported alone.
        (
            allowed(10) | {"found": HINT},
            "inspect",
            "red",
            f"Inspect: {ECCENTRIC} is beyond its limit: 18.2 ± 0.3 µm, allowed 10.0 µm {SURE}.",
        ),
        (
            allowed(20),
            "nothing",
            "green",
            f"Nothing to do: the transmission error and {ECCENTRIC} are within their limits .*",
        ),
        ({"found": ALIKE}, "inspect", "red", f"Inspect: output runout or output encoder .* {SURE}."),
        (WRONG, "inspect", "not_judged", "Cannot be judged: the output follows at 101."),
    ],
)
def test_what_to_do(made: dict[str, Any], action: str, light: str, said: str) -> None:
    found = advice(Answer(diagnosis(**made)))
    assert found[:2] == (action, light)
    assert re.fullmatch(said, found.text), found.text
    told = as_json(diagnosis(**made), "joint_1")
    assert (told["action"], told["advice"]) == (action, found.text)


@pytest.mark.parametrize("size", [29.0, 31.0])
def test_a_loop_that_catalogues_allow_is_named_and_asks_for_nothing(size: float) -> None:
    told, usual = as_json(diagnosis(loop(size)), "joint_1"), size < 30.0
    assert told["causes"][0]["usual"] is usual
    assert told["action"] == ("nothing" if usual else "inspect")
    assert told["advice"].endswith("Usual for a new gear: hysteresis.") is usual
    assert ("arcsec rms, usual for a gear" in told["verdict"]) is usual


def first(name: str, size: float) -> Cause:
    """A cause with only its first quantity, without deviation."""
    made = cause(name)
    count = made.coefficients.size + len(made.nonlinear)
    sizes = size * np.eye(1, made.coefficients.size)[0]
    return dataclasses.replace(made, coefficients=sizes, covariance=np.zeros((count, count)))


def spread(deviation: float) -> Cause:
    """A loop of 33 arcsec with a deviation [arcsec]."""
    made = loop(33.0)
    variance = (ARCSEC * deviation) ** 2 / made.coefficients.size
    return dataclasses.replace(made, covariance=variance * np.eye(len(made.covariance)))


def like_friction(share: float) -> Cause:
    made, other = cause("stream_delay", alike=("viscous_windup",)), cause("viscous_windup").effect
    return dataclasses.replace(made, others=((other, np.array([share * float(other.usual[0])])),))


FRICTION = float(cause("coulomb_windup").effect.usual[0])
UNCERTAIN = cause("torque_offset")


@pytest.mark.parametrize(
    ("made", "usual"),
    [
        (first("coulomb_windup", 0.9 * FRICTION), True),
        (first("coulomb_windup", 1.2 * FRICTION), False),
        (like_friction(0.9), True),
        (like_friction(1.2), False),
        # A cause without a usual size is never usual, however uncertain.
        (first("stream_delay", 0.9 * ARCSEC), False),
        (dataclasses.replace(UNCERTAIN, covariance=np.diag((9.0 * UNCERTAIN.coefficients) ** 2)), False),
        # A loop counts only as far as the record runs through it.
        (dataclasses.replace(loop(40.0), reach=24.0 * ARCSEC), True),
        (dataclasses.replace(loop(40.0), reach=36.0 * ARCSEC), False),
        (spread(0.1), False),
        (spread(8.0), True),  # its deviation allows a usual size
        # Waves of an encoder disc that is mounted with care.
        *((first("output_runout", size * ARCSEC), size < 10.0) for size in (9.0, 11.0)),
        *((first("output_encoder_eccentricity", size * ARCSEC), size < 10.0) for size in (9.0, 11.0)),
        *((first("input_encoder_eccentricity", size * ARCSEC), size < 600.0) for size in (540.0, 660.0)),
        # Any wave of an encoder, including its lines.
        *((first("output_encoder_interpolation", size * ARCSEC), size < 10.0) for size in (9.0, 11.0)),
        *((first("encoder_interpolation", size * ARCSEC), size < 600.0) for size in (540.0, 660.0)),
        (first("coupling_misalignment", 9.0 * ARCSEC), False),  # a named coupling has play
    ],
)
def test_what_a_new_joint_has_is_usual(made: Cause, usual: bool) -> None:
    """In a joint beyond its accuracy, where no wave is usual for being a part of it."""
    beyond = waved(60.0 * ARCSEC, np.random.default_rng(0)).record
    found = dataclasses.replace(diagnosis(made), record=beyond)
    assert as_json(found, "joint_1")["causes"][0]["usual"] is usual


@pytest.mark.parametrize(
    ("name", "of_gear"),
    [
        ("circular_spline_pitch", True),
        ("flexspline_pitch", True),
        ("circular_spline_form", True),
        ("input_encoder_eccentricity", True),  # once per input turn, as a gear's own wave
        ("tooth_damage", False),
        ("output_runout", False),
        ("bearing_passage", False),
    ],
)
@pytest.mark.parametrize("amplitude", [20.0, 60.0])
def test_a_wave_of_the_gear_is_usual_in_a_joint_within_its_accuracy(
    name: str, of_gear: bool, amplitude: float
) -> None:
    """The catalogue's accuracy includes such waves: 40 arcsec peak to peak of 90 allowed, and 120."""
    record = waved(amplitude * ARCSEC, np.random.default_rng(0)).record
    found = dataclasses.replace(diagnosis(first(name, 1.0)), record=record)
    told = as_json(found, "joint_1")
    assert told["causes"][0]["usual"] is (of_gear and amplitude < 45.0)
    assert (told["action"] == "nothing") is told["causes"][0]["usual"]


def waved(amplitude: Any, rng: np.random.Generator, more: Any = 0.0) -> Diagnosis:
    """A diagnosis whose record has a wave of order 2, noise, and an addition `more` [rad]."""
    made = diagnosis()
    record = made.record
    wave = amplitude * np.cos(2.0 * record.input_angle)
    output = record.input_angle / 100.0 + more + wave + 3.2 * ARCSEC * rng.standard_normal(record.size)
    return dataclasses.replace(made, record=dataclasses.replace(record, output_angle=output))


@pytest.mark.parametrize("amplitude", [20.0, 60.0])
def test_the_error_is_compared_with_the_catalogue(amplitude: float) -> None:
    """A wave of 40 or 120 arcsec peak to peak against 90; a much larger torsion does not count."""
    record = diagnosis().record
    torsion = -300.0 * ARCSEC * record.torque / 30.0
    found = Answer(waved(amplitude * ARCSEC, np.random.default_rng(0), torsion)).normal
    assert found.value / ARCSEC == pytest.approx(2.0 * amplitude, rel=0.1)
    assert found.within is (amplitude < 45.0)


def test_how_well_the_error_is_known_is_how_much_it_scatters_between_records() -> None:
    """The amplitude varies between stretches: the deviation equals the scatter of many such records."""
    rng, size = np.random.default_rng(1), diagnosis().record.size
    stretch = np.arange(size) * 12 // size
    amplitudes = (ARCSEC * (30.0 + 10.0 * rng.standard_normal(12))[stretch] for _ in range(100))
    found = [Answer(waved(amplitude, rng)).normal for amplitude in amplitudes]
    scatter = np.std([one.value for one in found if one])
    assert np.median([one.std for one in found if one]) == pytest.approx(scatter, rel=0.25)


@pytest.mark.parametrize(
    ("value", "std", "place"),
    [
        (8.0, 1.0, "within"),
        (8.1, 1.0, "near"),
        (11.9, 1.0, "near"),
        (12.0, 1.0, "beyond"),
        (8.0, np.nan, "open"),
        (12.0, np.nan, "near"),
        (np.nan, 1.0, "open"),
    ],
)
def test_a_value_beside_its_limit(value: float, std: float, place: str) -> None:
    """Near means that the 95 % interval holds the limit of 10."""
    assert [Limited("", value, std, limit, "m").place for limit in (10.0, np.nan)] == [place, "open"]


def test_the_eccentricity_of_a_misfit_has_no_known_deviation() -> None:
    made = dataclasses.replace(diagnosis(), allowed=Allowed(1e-5, "overlap"))
    told = as_json(made, "joint_1")["tolerance"]
    assert told["std"] == made.parameters["eccentricity.magnitude"]["std"] > 0.0
    assert as_json(dataclasses.replace(made, rms=MISFIT), "joint_1")["tolerance"]["std"] is None


@pytest.mark.parametrize(("size", "said"), [(0.1, True), (3.0, False)])
def test_torsion_by_a_torque_that_nobody_measured_is_not_held_against_it(size: float, said: bool) -> None:
    made = diagnosis(rms=MISFIT)
    blind = dataclasses.replace(made.record, has_torque=False, torque=np.zeros(made.record.size))
    slow = 100.0 * ARCSEC * size * np.sin(np.arange(blind.size) / 10.0)
    blind = dataclasses.replace(blind, output_angle=blind.input_angle / 100.0 + slow)
    found = dataclasses.replace(made, record=blind)
    assert (Answer(found).normal is not None) == said
    assert "whose torque is not measured" in sentence(Answer(found))
