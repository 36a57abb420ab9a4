"""A diagnosis in words and in JSON: the contract's keys, finite numbers only, one sentence."""

import dataclasses
import json
import math
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from joint_records import ARCSEC, columns, joint, prepared
from report_samples import letters

from hd_diag.diagnosis.detectability import NOT_PROVED, Detectability
from hd_diag.diagnosis.diagnosis import Allowed, Diagnosis
from hd_diag.diagnosis.evidence.naming import Standing
from hd_diag.diagnosis.evidence.order_table import OrderRow
from hd_diag.diagnosis.evidence.solution import Cause, Function
from hd_diag.diagnosis.evidence.unexplained import Unexplained
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.refit import AMBIGUOUS, Refit
from hd_diag.diagnosis.gain import Gain, Rms
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.statements import sentence, sentences
from hd_diag.diagnosis.verdict import as_json, summary
from hd_diag.effects import CATALOGUE
from hd_diag.effects.remainders import EVEN, ORDERS, PLACE, SPEED, TIME, TORQUE, Remainder
from hd_diag.extended_model import ExtendedModel, Term

pytestmark = pytest.mark.usefixtures("accuracy_once")

CONFIGURED = joint().drive
EFFECTS = {effect.name: effect for effect in CATALOGUE}

# Keys that other people's scripts read; after a semicolon, further keys.
KEYS = {
    "": "schema joint record nominal refit causes unexplained extended noise_floor gain testability model "
    "remainders misfit action verdict judgement described normal; findings hints evidence tolerance "
    "encoder_zeros motor_current left_out advice",
    "record": "samples duration input_turns runs; has_torque outliers dropped refused unpaired stamps_zero "
    "second_publisher clock_set_back last_refusal problems",
    "nominal": "rms",
    "refit": "rms parameters trustworthy",
    "causes": "name class parameters amplitude gain probability usual p_value explanation inspect",
    "unexplained": "order frame amplitude torque_law direction_law",
    "extended": "rms; rms_named rms_offline rms_live rms_wandering",
    "noise_floor": "rms low high",
    "gain": "rms_nominal rms_refit rms_extended fraction_explained low high held_out",
    "testability": "name testable least_size reason",
    "remainders": "of rms largest at; larger_than_usual in_model",
    "misfit": "slow gear",
}


def cause(name: str, size: float = 4.0, alike: tuple = (), none: float = -20.0, own: Any = None) -> Cause:
    """A cause whose amplitude is its own, with slightly less probable alternatives; ``none``: log odds."""
    effect, amplitude = EFFECTS[name], size * ARCSEC
    values = {q.name: max(q.low, min(q.high, 1.0)) for q in effect.quantities}
    coefficients, nonlinear = effect.from_physical(values)
    covariance = np.diag((0.01 * coefficients) ** 2)
    odds = {one: -0.1 * place for place, one in enumerate((name, *alike))} | {"": none}
    standing = Standing(odds, frozenset(EFFECTS), amplitude if own is None else own, 0.01 * ARCSEC)
    return Cause(effect, nonlinear, coefficients, covariance, amplitude, standing, 0.4, 0.3, 0.5)


def function(effect: Remainder, largest: float = 9.0 * ARCSEC, larger: bool = True) -> Function:
    """A function whose greatest value lies at 20 of its units."""
    coefficients = np.zeros(effect.size)
    return Function(effect, (1e-6, 0.0, 1.0), coefficients, largest / 3.0, largest, 20.0, larger, True)


def refitted(doubt: str = "", eccentricity: complex = 18.2 * np.exp(1.29j)) -> Refit:
    point = fit_parameters.vector(CONFIGURED, CONFIGURED)
    point[0], point[1] = eccentricity.real, eccentricity.imag
    covariance = np.diag([0.3, 0.3, 0.2, 0.2, 1.0, 0.1, 0.2]) ** 2
    return Refit(fit_parameters.drive_of(point, CONFIGURED), point, covariance, doubt)


AT_BOUND = fit_parameters.admissible(np.array([1e3, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]), CONFIGURED)
LINE = Unexplained(3.37, "input", 2.0 * ARCSEC, "independent of torque", "the same in both directions")
ROW = OrderRow(3.372, "input", (3.372, 0.0), np.array([2.0 * ARCSEC, 0.0]), np.eye(2) * 1e-14, True, ())
TESTS = (
    Detectability("resonance", False, math.nan, "one speed only"),
    Detectability("hysteresis", True, 0.3 * ARCSEC, "tested"),
    Detectability("thermal_drift", False, math.nan, "no heat"),
    Detectability("stream_delay", False, math.nan, "one speed only"),
)
RECORD = prepared(columns(seconds=4.0))
BY_CURRENT = dataclasses.replace(RECORD, by_current=True)


def rms_of(*sizes: float, **more: float) -> Rms:
    """Rms from sizes in the order of its fields [arcsec]."""
    return Rms(*(ARCSEC * size for size in sizes), **more)


USUAL = rms_of(20.0, 5.0, 3.3, 3.3, 3.2, 3.4, 3.2, 3.1, 3.3)
WORSE = rms_of(20.0, 5.0, 5.2, 5.2, 5.2, 5.3, 4.2, 4.1, 4.3)


def found(*causes: Cause, table: tuple[OrderRow, ...] = (), functions: tuple[Function, ...] = ()) -> Any:
    return SimpleNamespace(causes=causes, table=table, functions=functions)


def diagnosis(*causes: Cause, **changes: Any) -> Diagnosis:
    made: dict[str, Any] = {
        "record": RECORD,
        "configured": CONFIGURED,
        "findings": (),
        "refitted": refitted(),
        "found": found(*causes),
        "rms": USUAL,
        "gain": Gain(0.97, 0.96, 0.98, "3 of 12 runs"),
        "testable": TESTS,
    }
    return Diagnosis(**(made | changes))


ABOVE = "under positive torque"
SIDED, TIME_LINE = dataclasses.replace(LINE, where=ABOVE), dataclasses.replace(LINE, frame="time", order=7.3)
WRONG_RATIO = Finding("ratio_error", "the output follows at 101", 101.0, "-", True)
SWAPPED = Finding("ratio_error", "the output does not follow", math.nan, "-", True)
SKIP = Finding("tooth_skip", "a step of 6480 arcsec at 3.000 s: 1 tooth skipped", 0.0314, "rad", False)
ENDED = {"refitted": None, "found": None, "rms": None, "gain": None, "testable": ()}
DIAGNOSES = {
    "nothing": diagnosis(),
    "every effect": diagnosis(*(cause(name) for name in EFFECTS), unexplained=(SIDED,)),
    "wrong ratio": diagnosis(findings=(WRONG_RATIO,), **ENDED),
    "swapped": diagnosis(findings=(SWAPPED,), **ENDED),
    "tooth skipped": diagnosis(cause("hysteresis"), findings=(SKIP,)),
    "ambiguous": diagnosis(refitted=refitted(AMBIGUOUS)),
    "functions": diagnosis(found=found(functions=[*map(function, (TORQUE, SPEED, PLACE, TIME, *ORDERS))])),
}


def keys(part: str) -> set[str]:
    return set(KEYS[part].replace(";", "").split())


@pytest.mark.parametrize("made", DIAGNOSES.values(), ids=DIAGNOSES)
def test_json_is_the_contract_s_and_lines_are_without_nan(made: Diagnosis) -> None:
    told = as_json(made, "joint_1", "model.json")
    assert set(told) == keys("")
    for part in ("record", "nominal", "refit", "extended", "noise_floor", "gain", "misfit"):
        assert set(told[part]) == keys(part), part
    for part in ("causes", "unexplained", "testability", "remainders"):
        assert all(set(item) == keys(part) for item in told[part]), part
    for item in told["causes"]:
        assert set(item["gain"]) == {"value", "low", "high"}
        assert all(set(p) == {"value", "std", "unit"} for p in item["parameters"].values())
    for value in told["refit"]["parameters"].values():
        assert set(value) == {"value", "std", "unit", "configured"}
    assert (told["schema"], told["joint"], told["model"]) == ("hd_diag/diagnosis/1", "joint_1", "model.json")
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    lines = summary(made)
    assert sentence(Answer(made)) == told["verdict"]
    said = sentences(Answer(made))
    assert lines[: len(said) + 1] == [told["advice"], *said]
    assert letters(told["verdict"]).endswith(letters("".join(said)))
    assert said or any(finding["fatal"] for finding in told["findings"])
    assert told["verdict"].endswith(".")
    assert all("\n" not in line and "nan" not in line.split() for line in lines)


def test_what_is_not_known_is_null() -> None:
    told = as_json(DIAGNOSES["swapped"], "joint_1")
    assert told["refit"] == {"rms": None, "parameters": {}, "trustworthy": False}
    unknown = told["nominal"]["rms"], told["gain"]["fraction_explained"], told["model"]
    assert (*unknown, told["causes"][0]["parameters"]["size"]["value"]) == (None,) * 4
    assert as_json(DIAGNOSES["nothing"], "j")["testability"][0]["least_size"] is None


def test_numbers_are_si_and_those_of_the_diagnosis() -> None:
    made = dataclasses.replace(DIAGNOSES["every effect"], rms=dataclasses.replace(USUAL, slow=4.0, gear=1.1))
    told = as_json(made, "joint_1")
    assert told["misfit"] == {"slow": 4.0, "gear": 1.1}
    counts = {"samples": 800, "runs": 1, "has_torque": True, "last_refusal": "", "problems": []}
    none = ("outliers", "dropped", "refused", "unpaired", "clock_set_back", "stamps_zero")
    motion = {"duration": pytest.approx(3.995), "input_turns": pytest.approx(made.record.extent.input_turns)}
    assert told["record"] == counts | motion | dict.fromkeys(none, 0) | {"second_publisher": []}
    assert told["nominal"]["rms"] == told["gain"]["rms_nominal"] == pytest.approx(20.0 * ARCSEC)
    assert told["refit"]["rms"] == told["gain"]["rms_refit"] == pytest.approx(5.0 * ARCSEC)
    assert told["extended"]["rms"] == told["gain"]["rms_extended"] == pytest.approx(3.3 * ARCSEC)
    assert told["refit"]["parameters"]["eccentricity.magnitude"]["value"] == pytest.approx(18.2e-6)
    (line,) = told["unexplained"]
    assert (line["order"], line["direction_law"]) == (3.37, f"strongest {ABOVE}; the same in both directions")


def test_findings_are_causes_first_of_all_and_every_effect_says_what_to_inspect() -> None:
    told = as_json(DIAGNOSES["tooth skipped"], "joint_1")
    assert [c["name"] for c in told["causes"]] == ["tooth_skip", "hysteresis"]
    for item in as_json(DIAGNOSES["every effect"], "joint_1")["causes"]:
        assert item["explanation"] == EFFECTS[item["name"]].cause
        assert len(item["inspect"]) > 20
        assert item["class"] == [item["name"]]


# Sentences ---

ALIKE = cause("output_runout", 2.5, ("output_encoder_eccentricity",))


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (
            diagnosis(),
            "; the eccentricity is 18.2 ± 0.3 µm at 73.9 ± 0.9° (mod 180°) from the long axis, not 0.0 µm; "
            "no other cause is needed.",
        ),
        (
            diagnosis(refitted=refitted(eccentricity=0.4 + 0.0j)),
            "; the eccentricity is as configured (0.0 µm), as far as this record tells: no more than "
            "1.0 µm off; no other cause is needed.",
        ),
        (
            diagnosis(cause("hysteresis"), ALIKE),
            "; beside that: hysteresis, 4.00 arcsec rms; output runout or output encoder eccentricity "
            "(this record cannot tell which), 2.50 arcsec rms.",
        ),
        (
            diagnosis(unexplained=(LINE, TIME_LINE)),
            "; none of the known causes explains the rest; "
            "unexplained: 3.37 per input turn, 2.00 arcsec, 7.30 Hz, 2.00 arcsec.",
        ),
        (
            diagnosis(unexplained=(SIDED,)),
            "unexplained: 3.37 per input turn under positive torque, 2.00 arcsec.",
        ),
        (  # lines in the table of orders are not repeated
            diagnosis(found=found(table=(ROW,)), unexplained=(LINE, TIME_LINE)),
            "unexplained: 7.30 Hz, 2.00 arcsec; described, not explained: "
            "3.372 per input turn (2.00 arcsec).",
        ),
        (DIAGNOSES["wrong ratio"], "First of all: the output follows at 101."),
        (
            diagnosis(findings=(dataclasses.replace(SWAPPED, text="are they swapped?"),), **ENDED),
            "First of all: are they swapped?",
        ),
        (
            DIAGNOSES["ambiguous"],
            "; the model's parameters are not judged: several sets fit about as well; no other cause is "
            "needed.",
        ),
    ],
)
def test_the_sentence(made: Diagnosis, said: str) -> None:
    """``said`` ends the sentence, or is all of it if nothing comes before."""
    assert sentence(Answer(made)).endswith(said)
    assert said.startswith((";", "unexplained")) or sentence(Answer(made)) == said


@pytest.mark.parametrize(
    ("most", "place", "said"),
    [
        (20e-6, "within", "its eccentricity is within the tolerance's limit (18.2 of 20.0 µm"),
        (10e-6, "beyond", "its eccentricity is beyond the tolerance's limit (18.2 of 10.0 µm"),
        (
            17.9e-6,
            "near",
            "whether its eccentricity is within the tolerance's limit "
            "cannot be judged (18.2 ± 0.3 of 17.9 µm",
        ),
    ],
)
def test_severity_comes_first(most: float, place: str, said: str) -> None:
    """First the catalogue's accuracy, then the allowed eccentricity; both before any finding."""
    made = diagnosis(cause("hysteresis"), allowed=Allowed(most, "peak_tooth_load"))
    first, _, _ = sentence(Answer(made)).partition(";")
    assert re.fullmatch(
        r"the joint is within its accuracy "
        r"\(\d+ of 90 arcsec peak to peak over 0\.\d\d of an output turn\) and .*",
        first,
    )
    assert first.endswith(f"{said}, by peak tooth load)")
    expected = {"eccentricity": pytest.approx(18.2e-6), "std": pytest.approx(3e-7), "allowed": most}
    expected |= {"within": {"within": True, "beyond": False, "near": None}[place], "place": place}
    assert as_json(made, "joint_1")["tolerance"] == expected | {"criterion": "peak_tooth_load"}
    ambiguous = dataclasses.replace(made, refitted=refitted(AMBIGUOUS))
    assert "tolerance's limit" not in sentence(Answer(ambiguous))


def test_what_a_motor_s_current_costs_is_said() -> None:
    """Constant and friction are reported; a compliance is not, because only the product shows."""
    effect = EFFECTS["motor_current"]
    values = {q.name: 1.0 for q in effect.quantities} | {"relative_error": -0.12, "friction": 4.8}
    coefficients, nonlinear = effect.from_physical(values)
    model = ExtendedModel(CONFIGURED, (Term(effect, tuple(coefficients), nonlinear),), 0.0, None)
    point = fit_parameters.vector(CONFIGURED, CONFIGURED) * np.array([1, 1, 1, 1, 1, 2.0, 1])
    stiff = dataclasses.replace(refitted(eccentricity=0j), parameters=point)
    given = {"refitted": stiff, "model": model, "motor_std": {"relative_error": 0.13, "friction": 0.7}}
    of_torque, of_current = (diagnosis(record=record, **given) for record in (RECORD, BY_CURRENT))
    assert "tooth compliance +100" in sentence(Answer(of_torque))
    told = sentence(Answer(of_current))
    assert "compliance" not in told
    assert (
        "the torque is a motor's current: its constant (−12 ± 13 %), friction (4.8 ± 0.7 N m) and inertia"
        in told
    )
    motor = as_json(of_current, "joint_1")["motor_current"]
    assert motor["friction"] == {"value": pytest.approx(4.8), "std": 0.7, "unit": "N m"}


def test_a_bound_is_not_told_of_a_model_that_does_not_describe_the_record() -> None:
    kept = {"refitted": refitted(eccentricity=0j), "kept": {"eccentricity": 3e-6}}
    misfit = rms_of(*[20.0] * 6, 3.2, 3.1, 3.3)
    assert "this record tells: no more than 3.0 µm off" in sentence(Answer(diagnosis(**kept)))
    told = sentence(Answer(diagnosis(**kept, rms=misfit)))
    assert "as configured (0.0 µm), and how far off it may be cannot be determined;" in told
    assert "no more than" not in told


def test_scatter_of_the_encoders_zeros_is_told() -> None:
    """Several recordings have a scatter; a single one has none to report."""
    zeros = tuple(ARCSEC * np.array([10.0, 20.0, 60.0]))
    made = diagnosis(encoder_zeros=zeros)
    scatter = pytest.approx(np.std(zeros, ddof=1))
    assert as_json(made, "joint_1")["encoder_zeros"] == {"values": [*zeros], "scatter": scatter}
    assert summary(made)[5].startswith("encoders' zero: one for each of 3 recordings; they scatter by 26.46")
    assert as_json(diagnosis(encoder_zeros=zeros[:1]), "joint_1")["encoder_zeros"] is None


def test_causes_that_predict_nothing_are_doubted() -> None:
    text = sentence(Answer(diagnosis(cause("hysteresis"), rms=WORSE)))
    assert re.search(r"predicted no better .*\(5.20 against 5.00 arcsec\)", text)
    for made in (diagnosis(rms=WORSE), diagnosis(cause("hysteresis"))):
        assert "predicted" not in sentence(Answer(made))


def test_a_cause_that_another_explains_better_is_a_hint() -> None:
    """If the other cause is almost certain, its class omits the fitted cause."""
    one = cause("coupling_misalignment")
    odds = {"coulomb_windup": 0.0, "coupling_misalignment": -8.0, "": -20.0}
    made = diagnosis(dataclasses.replace(one, standing=dataclasses.replace(one.standing, values=odds)))
    assert made.causes == ()
    (hint,) = made.hints
    assert made.doubt(hint) == "coulomb windup explains it better"


def test_what_is_left_in_one_band_says_nothing_of_the_other() -> None:
    """A slow misfit weakens slow causes; without bands it weakens all; noise alone weakens none."""
    rms = rms_of(20.0, *[9.0] * 5, 3.0, 2.9, 3.1, beyond=4.0, gear=1.0)
    assert (rms.overstated(0.0), rms.overstated(1.0)) == (1.0, 4.0)
    assert rms.overstated(0.5) == pytest.approx(math.sqrt(0.5 * (16.0 + 1.0)))
    assert dataclasses.replace(rms, beyond=0.5).overstated(1.0) == 1.0
    assert dataclasses.replace(rms, beyond=math.nan, gear=math.nan).overstated(0.3) == pytest.approx(3.0)
    assert dataclasses.replace(rms, offline=3.0 * ARCSEC).overstated(1.0) == 1.0


def test_causes_that_undo_each_other_as_the_model_runs_are_doubted() -> None:
    """Then the drive with its parameters alone is the running model, although the fit leaves only noise."""
    ran = rms_of(20.0, 14.0, 219.7, 219.7, 4.3, 219.0, 4.2, 4.1, 4.3)
    alone = dataclasses.replace(ran, named=14.1 * ARCSEC, extended=14.1 * ARCSEC, live=14.2 * ARCSEC)
    assert ran.offline == 4.3 * ARCSEC
    rms = ran.running(alone)
    assert rms.extended == alone.extended
    assert rms.offline == ran.offline
    text = sentence(Answer(diagnosis(cause("hysteresis"), rms=rms)))
    assert "(219.70 against 14.00 arcsec)" in text


def test_the_lines_name_gain_and_what_was_not_testable() -> None:
    made = diagnosis(cause("hysteresis", 40.0))
    held_out, where, *rest = summary(made)[1 + len(sentences(Answer(made))) :]
    assert held_out == (
        "held-out residual (3 of 12 runs): nominal 20.00, refit 5.00, extended 3.30, noise 3.20 arcsec rms; "
        "explained 97.0 % (96.0 to 98.0 %)"
    )
    assert where.startswith("direction: counter-clockwise from where the wave generator's long axis stands")
    assert rest == [
        f"inspect: {EFFECTS['hysteresis'].inspect}",
        "not testable here: resonance, stream delay: one speed only",  # one line for one reason
        "not testable here: thermal drift: no heat",
    ]


NEVER = {"torsional_hardening", "torque_gain", "wear_backlash"}


def test_what_is_not_named_is_not_absent() -> None:
    """Undecided are hints, causes that no such record shows, and those that a misfit or doubts may hide."""
    assert diagnosis().undecided.keys() == NEVER
    named = diagnosis(cause("output_runout", alike=("output_encoder_eccentricity",))).undecided
    assert named.keys() == NEVER | {"output_encoder_eccentricity"}
    assert named["output_encoder_eccentricity"] == "this record cannot tell it from output runout"
    doubtful = diagnosis(cause("hysteresis", alike=("coulomb_windup",), none=-3.0)).undecided
    assert doubtful.keys() == NEVER | {"hysteresis", "coulomb_windup"}
    assert doubtful["hysteresis"] == doubtful["coulomb_windup"] == NOT_PROVED
    worse = rms_of(40.0, 25.0, *[20.0] * 4, 3.2, 3.1, 3.3)
    at_bound = dataclasses.replace(refitted(), parameters=AT_BOUND)
    for made in (diagnosis(rms=worse), diagnosis(refitted=at_bound)):
        assert made.undecided.keys() == EFFECTS.keys()
        assert len(set(made.undecided.values())) == 1


@pytest.mark.parametrize("name", sorted(NEVER))
def test_what_parameters_and_remainders_describe_is_no_cause(name: str) -> None:
    made = diagnosis(cause(name))
    assert (made.causes, [one.effect.name for one in made.hints]) == ((), [name])
    assert made.doubt(made.hints[0]) == made.undecided[name]


def test_by_a_motor_s_current_what_the_motor_imitates_is_not_absent() -> None:
    undecided = diagnosis(record=BY_CURRENT).undecided
    assert {"coulomb_windup", "torsional_hardening", "torque_sensor_ripple"} <= undecided.keys()
    assert {"output_runout", "output_encoder_eccentricity"} <= undecided.keys()  # gravity makes such a wave
    assert not {"output_encoder_interpolation", "input_encoder_eccentricity"} & undecided.keys()
    assert diagnosis().undecided.keys() == NEVER


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        (TORQUE, "the torsion's shape (9.00 arcsec at 20 N m)"),
        (SPEED, "a part that follows the speed (9.00 arcsec at 20 rad/s)"),
        (PLACE, "a part that follows the output's place (9.00 arcsec at 1.15e+03 °)"),
        (TIME, "a slow drift (9.00 arcsec at 20 s)"),
        (EVEN, "a wave of 2 per input turn (3.00 arcsec rms)"),
        (ORDERS[2], "a wave of 2 per input turn that changes with the torque (3.00 arcsec rms)"),
    ],
)
def test_what_is_larger_than_usual_is_said(effect: Remainder, said: str) -> None:
    sizes = function(effect), function(effect, larger=False), function(effect, 0.7 * ARCSEC)
    larger, usual, tiny = (diagnosis(found=found(functions=(one,))) for one in sizes)
    assert sentence(Answer(larger)).endswith(f"; larger than usual, by no known cause: {said}.")
    assert Answer(larger).judgement == "described"
    for made in (usual, tiny):
        assert "larger than usual" not in sentence(Answer(made))
        assert Answer(made).judgement == "parameters"


@pytest.mark.parametrize(
    ("effect", "record", "advised"),
    [(SPEED, RECORD, True), (SPEED, BY_CURRENT, False), (TIME, RECORD, False)],
)
def test_a_part_that_follows_the_speed_may_be_a_motor_s_friction(
    effect: Remainder, record: Record, advised: bool
) -> None:
    told = sentence(Answer(diagnosis(found=found(functions=(function(effect),)), record=record)))
    assert ("if the torque was computed from its current, give the signal the unit A" in told) is advised


def test_remainders_are_told_with_their_numbers_and_lines_stand_elsewhere() -> None:
    told = as_json(DIAGNOSES["functions"], "joint_1")["remainders"]
    assert [one.pop("of") for one in told] == ["torque", "speed", "place", "time"]
    numbers = {"rms": pytest.approx(3.0 * ARCSEC), "largest": pytest.approx(9.0 * ARCSEC), "at": 20.0}
    assert told == [numbers | {"larger_than_usual": True, "in_model": True}] * 4


def test_a_probability_and_its_rest_are_told() -> None:
    (told,) = as_json(diagnosis(cause("hysteresis", alike=("coulomb_windup",), none=-6.0)), "j")["causes"]
    causes, none = 1.0 + np.exp(-0.1), np.exp(-6.0)
    assert told["class"] == ["hysteresis", "coulomb_windup"]
    assert told["probability"] == pytest.approx(causes / (causes + none))
    assert told["p_value"] == pytest.approx(none / (causes + none))
