"""Time limit of a diagnosis: parts that it ends, parts that it never ends, and reported progress."""

import json
from pathlib import Path

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, bench, of, swinging
from cli_runner import hd_diag
from joint_records import ARCSEC, columns

from hd_diag.diagnosis import work
from hd_diag.diagnosis.diagnosis import diagnose
from hd_diag.diagnosis.evidence.naming import standings
from hd_diag.diagnosis.evidence.search import DATUM_REACH, FURTHER_CAUSES, Found, search
from hd_diag.diagnosis.evidence.solution import solution
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.verdict import as_json, sentence
from hd_diag.diagnosis.work import Work

LINES = {"amplitude": 5e-5, "phase": 0.4, "second_amplitude": 0.0, "second_phase": 0.0, "lines": 128.0}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Process time [s], set by the test."""
    now = [100.0]
    monkeypatch.setattr(work.time, "process_time", lambda: now[0])
    return now


def test_a_part_ends_where_its_share_of_the_time_is_gone(clock: list[float]) -> None:
    limited, steps = Work(10.0), list[str]()
    for name in ("one", "one", "other"):
        with limited.until(0.5, name):
            for _ in range(3):
                limited.check()
                clock[0] += 2.0
                steps.append(name)
        limited.check()  # outside a part there is no limit
    assert (steps, limited.left_out) == (["one"] * 3, ["one", "other"])


def test_what_may_take_a_minute_is_half_done_after_half_of_it(clock: list[float]) -> None:
    told: list[float] = []
    limited = Work(60.0, lambda share, text: told.append(share))
    for share in (0.02, 0.15, 0.6, 0.9):
        limited.tell(share, "")
        clock[0] += 30.0
    assert told == [0.02, 0.5, 0.6, 0.9]


def test_a_search_that_is_cut_off_gives_what_it_has_found(clock: list[float]) -> None:
    fit, said = bench(of(EFFECTS["output_encoder_interpolation"], **LINES)), dict[str, float]()

    def progress(share: float, text: str) -> None:
        said[text] = share
        clock[0] += 100.0 * (text == "looking for cause 2")

    fit.work.seconds, fit.work.progress = 100.0, progress
    best = search([fit], fit, np.random.default_rng(0)).best
    (cause,) = solution(best, standings(Found(best)), np.random.default_rng(0)).causes
    assert (cause.effect.name, cause.gain_low > 0.5) == ("output_encoder_interpolation", True)
    sizes = cause.effect.to_physical(cause.coefficients, cause.nonlinear)
    assert (sizes["amplitude"][0], sizes["lines"][0]) == (pytest.approx(5e-5, rel=0.05), 128.0)
    assert cause.standing.doubt == "there was no time to weigh it"
    assert fit.work.left_out == [FURTHER_CAUSES, DATUM_REACH]
    assert [*said] == ["looking for cause 1", "looking for cause 2", "weighing causes on all rows"]
    assert sorted(said.values()) == [*said.values()]


def test_a_diagnosis_out_of_time_says_what_it_left_out() -> None:
    shares: list[float] = []
    record = bench(of(EFFECTS["stream_delay"], delay=5e-3), record=swinging(10.0)).data.source
    hurried = Work(0.0, lambda share, text: shares.append(share))
    found = diagnose(record, CONFIGURED, np.random.default_rng(0), hurried)
    assert (found.causes, found.left_out[:2]) == ((), (DATUM_REACH, FURTHER_CAUSES))
    assert not any(test.testable for test in found.testable)
    assert "testing what this motion could have shown" in found.left_out
    assert found.refitted.doubt.startswith("there was no time")  # so it reports no displacement
    told = json.loads(json.dumps(as_json(found, "joint_1"), allow_nan=False))
    assert (told["judgement"], told["left_out"]) == ("misfit", [*found.left_out])
    floor = told["noise_floor"]["rms"]
    assert told["extended"]["rms"] > 2.0 * floor > 2.0 * ARCSEC  # remainders contain slow parts
    assert (len(told["unexplained"]) > 0, told["refit"]["parameters"] != {}) == (True, True)
    verdict = sentence(Answer(found))
    assert verdict.startswith("the model does not describe this record")
    assert "no cause was found within the time limit" in verdict
    assert verdict.endswith(f"so this was left out: {', '.join(found.left_out)}.")
    assert 0.0 < shares[0] < shares[-1] < 1.0
    assert sorted(shares) == shares


def test_the_command_line_s_limit_begins_when_all_is_compiled(monkeypatch, tmp_path: Path, clock) -> None:
    limits: list[tuple[float, float]] = []

    def judge(record: object, configured: object, rng: object, limited: Work, catalogue: object) -> None:
        limits.append((limited.seconds, limited.spent))
        raise RecordError("enough")

    monkeypatch.setattr("hd_diag.cli.record.diagnose", judge)
    monkeypatch.setattr("hd_diag.cli.record.warm_up", lambda: clock.append(clock.pop() + 100.0))
    rows, path = columns(4.0), tmp_path / "joint.csv"
    np.savetxt(path, np.stack([*rows.values()], axis=1), delimiter=",", header=",".join(rows), comments="")
    given = ("diagnose", path, "--columns", "time=time,input=input,output=output,torque=torque")
    for more in ((), ("--time-limit", "5")):
        assert "enough" in hd_diag(*given, *more).stderr
    assert limits == [(60.0, 0.0), (5.0, 0.0)]
