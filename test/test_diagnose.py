"""The end-to-end diagnosis on records of the independent generator, and `hd-diag diagnose`.

Development seeds only; bench/challenge.py has the whole benchmark.
"""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from challenge import records
from cli_runner import ASSUMED, assert_one_line_error, hd_diag
from click.testing import Result
from joint_records import ARCSEC, NOISE, RATIO, columns, joint, prepared
from numpy.testing import assert_allclose
from report_samples import RUN, diagnosed, diagnosis, eccentric, generated, known_to_the_command_line, made

from hd_diag.diagnosis import gain
from hd_diag.diagnosis.calibration import MISFIT, MORE
from hd_diag.diagnosis.diagnosis import diagnose
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.screening import screened
from hd_diag.diagnosis.statements import sentence
from hd_diag.drive import transmission_error
from hd_diag.effects import CATALOGUE
from hd_diag.simulation import Motion, Noise, SimulatedJoint, simulate

Patch = pytest.MonkeyPatch
ROOT = Path(__file__).resolve().parent.parent
COLUMNS = "time=time,input=input,output=output,torque=torque"


def diagnosed_by(*arguments: object) -> Result:
    return hd_diag("diagnose", *arguments)


def slow(*values: object) -> Any:
    return pytest.param(*values, marks=pytest.mark.slow)


def test_a_wave_of_two_lines_of_one_order_is_in_the_extended_model() -> None:
    """Either line alone adds nothing beside the other, so they are judged together."""
    wave, made = 10.0 * ARCSEC, columns()
    made["output"] += wave * np.cos(2.0 * made["input"] + 0.4)
    drive = joint(eccentricity__magnitude=12e-6, eccentricity__direction=0.6).drive
    found = diagnose(prepared(made), drive, np.random.default_rng(0))
    assert found.causes == ()
    (line,) = found.larger
    assert line.rms == pytest.approx(wave / np.sqrt(2.0), rel=0.1)
    assert found.rms.refit > 2.0 * NOISE
    assert found.rms.extended < 1.1 * NOISE


def test_a_wave_that_a_named_cause_imitates_is_in_the_extended_model() -> None:
    """An eccentric encoder may read twice per turn as well; its fit leaves that to the wave of any gear."""
    made = columns()
    made["output"] += 5.0 * ARCSEC * np.cos(made["input"] - 1.0)
    made["output"] += 5.0 * ARCSEC * np.cos(2.0 * made["input"] + 0.4)
    drive = joint(eccentricity__magnitude=12e-6, eccentricity__direction=0.6).drive
    found = diagnose(prepared(made), drive, np.random.default_rng(0))
    assert [cause.effect.name for cause in found.causes] == ["input_encoder_eccentricity"]
    assert found.rms.extended < 1.1 * NOISE
    assert not any("as the model runs" in one.torque_law for one in found.unexplained)


@pytest.mark.parametrize(
    ("name", "seed", "run"),
    [
        ("output_runout", None, RUN),
        slow("input_encoder_eccentricity", None, RUN),
        slow("bearing_passage", 4, 2 * RUN),
        slow("circular_spline_pitch", 5, RUN),
        slow("flexspline_pitch", 6, RUN),
        slow("hysteresis", 9, RUN),
    ],
)
def test_a_cause_is_named_with_its_size_and_no_other(name: str, seed: int | None, run: float) -> None:
    record = made(name) if seed is None else generated("one_effect", seed, name, run=run)
    found = diagnosis(name) if seed is None else diagnosed(record)
    assert [name in cause.alike for cause in found.causes] == [True]
    amplitude = float(np.std(records.added_by(record, name)))
    assert found.causes[0].amplitude == pytest.approx(amplitude, rel=0.1)
    assert found.rms.nominal > found.rms.refit > found.rms.offline


def test_what_cannot_be_told_from_a_cause_has_the_size_at_which_it_does_the_same() -> None:
    (cause,) = diagnosis("output_runout").causes
    ((other, coefficients),) = cause.others
    assert {cause.effect.name, other.name} == {*cause.alike}
    assert_allclose(coefficients[:2], cause.coefficients, rtol=0.05)


def test_a_drift_of_every_recording_is_fitted_to_all_of_them() -> None:
    """The drift is as slow as noise: it is no cause, and changes no parameter and no running model."""
    parts, rng = [columns(12.0, 100.0, seed) for seed in range(4)], np.random.default_rng(3)
    for number, part in enumerate(parts):
        bends = 4.0 * ARCSEC * rng.standard_normal(7)
        part["output"] += np.interp(part["time"], np.linspace(0.0, 12.0, 7), bends)
        part["time"] = part["time"] + 20.0 * number
    bag = np.repeat(np.arange(4), parts[0]["time"].size)
    record = prepared({name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, bag)
    found = diagnose(record, joint().drive, np.random.default_rng(0))
    assert not found.causes
    assert [change.name for change in Answer(found).changes] == ["eccentricity"]
    assert [term.effect.name for term in found.model.effects] == []


@pytest.mark.parametrize("within", [1.0, slow(2.0)])
def test_intervals_are_longer_where_more_than_noise_is_left(within: float, monkeypatch: Patch) -> None:
    """Displacements widen with the residual in input turns, and by the displacement that it would equal."""
    plain, real = eccentric(), gain.measured_gain

    def worse(*given: Any) -> Any:
        rms, share = real(*given)
        twice = {"extended": 2.0 * rms.extended, "offline": 2.0 * rms.offline}
        return dataclasses.replace(rms, **twice, gear=within), share

    monkeypatch.setattr("hd_diag.diagnosis.diagnosis.measured_gain", worse)
    found = diagnose(prepared(columns(8.0)), joint().drive, np.random.default_rng(0))
    assert found.misfit.suspected

    left = found.rms.noise * float(np.sqrt(max(within**2 - MORE**2, 0.0)))
    size, way = (found.parameters[f"eccentricity.{name}"]["value"] for name in ("magnitude", "direction"))
    moved = joint(eccentricity__magnitude=size, eccentricity__direction=way).drive
    angle, torque = found.record.input_angle, found.record.torque
    part = transmission_error(moved, angle, torque) - transmission_error(joint().drive, angle, torque)
    own = size * left / float(np.nanstd(part))
    std = {name: one["std"] for name, one in found.parameters.items()}
    before = {name: one["std"] for name, one in plain.parameters.items()}
    expected = float(np.hypot(min(within, found.misfit.value) * before["eccentricity.magnitude"], own))
    assert std["eccentricity.magnitude"] == pytest.approx(expected, rel=0.2)
    assert std["tooth_compliance"] == pytest.approx(found.misfit.value * before["tooth_compliance"], rel=0.2)


def test_what_lacks_is_said_of_every_cause_that_cannot_be_tested() -> None:
    """Friction acts through the torque: without a torque it cannot be judged, even if the motion would do."""
    given = columns(12.0)
    del given["torque"]
    found = diagnose(prepared(given), joint().drive, np.random.default_rng(0))
    reasons = {one.name: one.reason for one in found.testable}
    assert all(reasons.values())
    for name in ("viscous_windup", "torsional_hardening", "circular_spline_form", "torque_offset"):
        assert reasons[name].startswith("no torque is measured"), (name, reasons[name])


@pytest.mark.parametrize(
    ("name", "seed", "frame", "order"),
    [("strange_order", 0, "input", 3.37), slow("floor_vibration", 6, "time", 7.3)],
)
def test_what_no_catalogue_has_is_described(name: str, seed: int, frame: str, order: float) -> None:
    found = diagnosed(generated("unknown", seed, name))
    assert (found.findings, found.causes) == ((), ())
    assert [line.frame for line in found.unexplained] == [frame]
    assert found.unexplained[0].order == pytest.approx(order, abs=0.02)


@pytest.mark.parametrize("seed", [16, *map(slow, (36, 96))])
def test_a_wrong_ratio_is_said_first(seed: int) -> None:
    made = generated("one_effect", seed, "ratio_error", run=2 * RUN)
    found = diagnosed(made)
    assert [finding.name for finding in found.findings] == ["ratio_error"]
    fraction = made.truth["effects"]["ratio_error"]["fraction"]
    assert found.findings[0].value == pytest.approx(100.0 * (1.0 + fraction), abs=0.02)
    assert found.causes == ()


@pytest.mark.parametrize("seed", [56, slow(76)])
def test_a_ratio_that_is_off_by_little_is_a_cause(seed: int) -> None:
    made = generated("one_effect", seed, "ratio_error", run=2 * RUN)
    found = diagnosed(made)
    assert found.findings == ()
    assert [cause.alike for cause in found.causes] == [("ratio_error",)]
    error = -made.truth["effects"]["ratio_error"]["fraction"]
    assert found.causes[0].coefficients[0] == pytest.approx(error, rel=1e-2)


def wide(seconds: float = 100.0) -> dict[str, np.ndarray]:
    """Columns of a joint that moves to and fro over half a turn of the output."""
    given = columns(seconds=seconds)
    return given | {"output": given["output"] + 1.5 * given["input"] / RATIO, "input": 2.5 * given["input"]}


def of_a_disc(phase: float) -> dict[str, np.ndarray]:
    """Over half a turn, orders 1 and 2 of the output together look like a ramp."""
    given = wide()
    turn = given["input"] / RATIO - phase
    error = 45.0 * ARCSEC * (np.cos(turn) + 0.3 * np.cos(2.0 * turn - 1.0))
    return given | {"output": given["output"] + error}


def of_a_spring() -> dict[str, np.ndarray]:
    """Torque and torsion follow the angle, and noise reduces only the torque's fitted share."""
    given = wide()
    noise = np.random.default_rng(0).standard_normal((2, given["time"].size))
    turned = given["input"] / RATIO
    torque = 20.0 * turned / float(np.max(np.abs(turned)))
    return given | {"torque": torque + 0.5 * noise[1], "output": turned - 4e-5 * torque + 1e-6 * noise[0]}


def without_torque() -> dict[str, np.ndarray]:
    """Torsion may make the ramp of a ratio that is off by 0.03 %."""
    given = wide()
    return {"time": given["time"], "input": 1.0003 * given["input"], "output": given["output"]}


def one_way(seconds: float) -> dict[str, np.ndarray]:
    """Ripple of a large eccentricity over any part of its turn, in one direction under one load."""
    drive = joint(eccentricity__magnitude=18e-6).drive
    motion = Motion(60.0, 250.0, (13.2,), (14.0,), both_directions=False, ramp_share=0.01, rest_share=0.0)
    run = simulate(SimulatedJoint(drive, Noise(white=ARCSEC)), motion, np.random.default_rng(0))
    time = 1e-9 * (run.stamp - run.stamp[0])
    given = {"time": time, "input": run.input_angle, "output": run.output_angle, "torque": run.torque}
    return {name: column[: round(250.0 * seconds)] for name, column in given.items()}


@pytest.mark.parametrize(
    ("of", "given"),
    [
        (of_a_spring, ()),
        (without_torque, ()),
        (of_a_disc, (0.5,)),
        *map(slow, (of_a_disc, of_a_disc), ((2.0,), (-1.0,))),
        (one_way, (24.0,)),
        *map(slow, (one_way, one_way), ((17.5,), (47.0,))),
    ],
)
def test_what_only_looks_like_a_ramp_is_no_other_ratio(of: Any, given: tuple) -> None:
    drive = joint().drive
    found = diagnose(screened(prepared(of(*given)), drive), drive, np.random.default_rng(0))
    assert "ratio_error" not in {finding.name for finding in found.findings}
    assert "ratio_error" not in {name for cause in found.causes for name in cause.alike}


def test_a_move_one_way_tests_the_model_only_where_it_returns() -> None:
    """By gravity, with torsion of another shape and waves of the output, which no other rows foretell."""
    time = np.arange(2000) / 250.0
    share = np.clip((time - 0.3) / 7.4, 0.0, 1.0)
    place = 5.2 * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    torque = 18.0 + 55.0 * np.cos(place - 0.4)
    other = 150.0 * np.tanh(torque / 15.0) + 80.0 * np.cos(place + 1.0) + 40.0 * np.cos(3.0 * place)
    drive = joint().drive
    output = place + transmission_error(drive, place * RATIO, torque) + other * ARCSEC
    output += NOISE * np.random.default_rng(1).standard_normal(time.size)
    record = prepared({"time": time, "input": place * RATIO, "output": output, "torque": torque})
    found = diagnose(screened(record, drive), drive, np.random.default_rng(0))
    assert (found.findings, found.causes) == ((), ())
    assert found.rms.left > MISFIT * found.rms.noise
    assert not found.misfit.suspected
    assert "this record tests the model only to " in sentence(Answer(found))


def test_a_cause_in_a_table(monkeypatch: Patch, tmp_path: Path) -> None:
    asked = known_to_the_command_line(monkeypatch, "output_runout")
    whole = made("output_runout")
    divided = dataclasses.replace(whole, input_angle=whole.input_angle / 100.0)
    records.write_csv(divided, tmp_path / "bench.csv")
    given = (tmp_path / "bench.csv", "--columns", f"{COLUMNS},temperature=temperature")
    result = diagnosed_by(*given, "--input-divided", "--fail-on-cause", "--json", "-")
    assert (result.exit_code, result.stderr) == (1, ASSUMED)
    ((record, _),) = asked
    assert_allclose(record.input_angle, whole.input_angle)
    (cause,) = json.loads(result.stdout)["causes"]
    assert set(cause["class"]) == {"output_runout", "output_encoder_eccentricity"}
    assert cause["amplitude"] == diagnosis("output_runout").causes[0].amplitude
    assert cause["p_value"] < 0.01


def test_an_effect_of_one_s_own_is_searched_too(monkeypatch: Patch, tmp_path: Path) -> None:
    asked = known_to_the_command_line(monkeypatch, "output_runout")
    given = (table(tmp_path / "a.csv"), "--columns", COLUMNS, "--effects")
    assert diagnosed_by(*given, ROOT / "docs/examples/encoder_pinion.py").exit_code == 0
    ((_, catalogue),) = asked
    assert [effect.name for effect in catalogue] == [*(e.name for e in CATALOGUE), "encoder_pinion"]
    (tmp_path / "none.py").write_text("EFFECT = 3")
    assert_one_line_error(diagnosed_by(*given, tmp_path / "none.py"), "none.py: expected an effect")


def table(path: Path, **changes: Any) -> Path:
    given = {**columns(seconds=6.0), **changes}
    rows = zip(*(np.broadcast_to(c, given["time"].shape).tolist() for c in given.values()), strict=True)
    path.write_text("\n".join([",".join(given), *(",".join(map(repr, row)) for row in rows)]))
    return path


def test_a_wrong_ratio_fails_on_request_at_once(tmp_path: Path) -> None:
    given = columns(seconds=6.0)
    path = table(tmp_path / "a.csv", input=-given["input"])
    result = diagnosed_by(path, "--columns", COLUMNS, "--fail-on-cause")
    assert result.exit_code == 1
    told = re.match(r"joint_1: Cannot be judged: the output follows .* ratio of (\S+), not ", result.stdout)
    assert float(told[1]) == pytest.approx(-100.0, rel=1e-3)
    assert diagnosed_by(path, "--columns", COLUMNS).exit_code == 2


TWICE = "--columns names something twice"


@pytest.mark.parametrize(
    ("changes", "arguments", "said"),
    [
        ({}, ["--columns", "time=time,input=nothing,output=output"], "has no column 'nothing'"),
        ({}, ["--columns", "time=time,input"], "--columns takes pairs like"),
        ({}, ["--columns", "time=time,output=a,output=b"], f"{TWICE}: time=time,output=a"),
        ({}, ["--columns", "time=time,input=input"], "columns need output"),
        ({}, ["--columns", COLUMNS, "--joint", "elbow"], "no joint 'elbow' in the configuration"),
        (
            {},
            ["--columns", COLUMNS, "--orders-only", "--model", "m.json"],
            "--orders-only has no tooth model",
        ),
        ({"input": 0.0}, ["--columns", COLUMNS], "joint_1: no motion: the input turns by 0 rad"),
        ({"output": np.nan}, ["--columns", COLUMNS], "joint_1: too short: 0 usable samples"),
        ({"time": 1.0}, ["--columns", COLUMNS], "joint_1: too short: 1 usable samples"),
    ],
)
def test_bad_input_is_told_in_one_line(
    changes: dict[str, Any], arguments: list[str], said: str, tmp_path: Path
) -> None:
    given = columns(seconds=6.0)
    whole = {name: np.full_like(given[name], value) for name, value in changes.items()}
    assert_one_line_error(diagnosed_by(table(tmp_path / "a.csv", **whole), *arguments), said)
