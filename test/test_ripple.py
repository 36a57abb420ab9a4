"""Ripple of a torque over position, on records of an independent generator, and its messages."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import fleet_tasks
import numpy as np
import pyarrow.parquet as pq
import pytest
from challenge.one_angle import Line, OneAngle, record
from cli_runner import ASSUMED, assert_one_line_error, config_file, hd_diag
from test_recording import states, write, write_table

from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.ripple.ripple import Ripple, ripple
from hd_diag.diagnosis.ripple.verdict import row, sentence
from hd_diag.fleet.series import series_of
from hd_diag.model.transmission_error import Kinematics

RATIO = 100.0
LOBES = Line(200.0, 0.2, 1.0)
BRAKE = Line(100.0, 0.25, 2.0, reverses=True)


def found(records: Sequence[OneAngle], ratio: float = RATIO, reach: slice = slice(None)) -> Ripple:
    rows = [(one.time[reach], one.angle[reach], one.torque[reach]) for one in records]
    time, angle, torque = (np.concatenate(columns) for columns in zip(*rows, strict=True))
    number = np.repeat(np.arange(len(rows)), [row[0].size for row in rows])
    return ripple(time, ratio * angle, torque, number, Kinematics(ratio))


def names(of: Ripple) -> list[tuple[float, bool]]:
    return [(line.order, line.reverses) for line in of.found]


@pytest.fixture(scope="module")
def hidden() -> Ripple:
    return found([record(3, [LOBES, BRAKE])])


def test_lines_are_found_with_their_sizes_and_phases(hidden: Ripple) -> None:
    assert sorted(names(hidden)) == [(100.0, True), (200.0, False)]
    for line, truth in zip(sorted(hidden.found, key=lambda line: line.order), (BRAKE, LOBES), strict=True):
        assert abs(line.amplitude - truth.size) < 2.5 * line.std < 0.3 * truth.size
        assert abs(math.remainder(line.phase - truth.phase, 2.0 * math.pi)) < 3.0 * line.std / truth.size
        assert line.repeats
        assert line.agreement > 0.8
    assert hidden.others == ()
    assert max(line.least for line in hidden.lines if not line.found) < 0.3


def test_a_gear_turned_about_has_the_same_lines(hidden: Ripple) -> None:
    turned = found([record(3, [LOBES, BRAKE])], -RATIO)
    rows, expected = ([(one.order, one.amplitude, one.phase) for one in of.lines] for of in (turned, hidden))
    np.testing.assert_allclose(rows, expected, rtol=1e-6)


@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(3, 60), marks=pytest.mark.slow)])
def test_a_record_without_ripple_shows_none(seeds: range) -> None:
    for seed in seeds:
        seen = found([record(seed, duration=30.0)])
        assert (seen.found, seen.others) == ((), ()), seed


def test_lines_of_another_ratio_are_seen_and_asked_about() -> None:
    # Teeth of the flexspline: over more than half a turn the two orders differ by a whole period.
    assert names(found([record(3, [Line(202.0, 0.2, 1.0)])])) == [(202.0, False)]
    seen = found([record(3, [Line(240.0, 0.3, 1.0)])])
    assert names(seen) == []
    assert [line.order for line in seen.others] == [pytest.approx(240.0, abs=0.2)]
    assert seen.others[0].amplitude == pytest.approx(0.3, abs=0.03)
    assert sentence(seen).startswith("The torque shows no line of a gear of ratio 100 above ")
    assert sentence(seen).endswith(" Is the ratio right?")


def test_records_tell_whether_a_line_repeats() -> None:
    same = found([record(3, [LOBES], 30.0, stream) for stream in range(3)])
    (line,) = same.found
    assert line.repeats
    assert len(line.records) == 3
    assert [part.amplitude for part in line.records] == pytest.approx([LOBES.size] * 3, abs=0.06)
    turned = [record(3, [Line(200.0, 0.2, 1.0 + 2.1 * stream)], 30.0, stream) for stream in range(3)]
    (line,) = found(turned).found
    assert line.repeats is False
    assert math.isnan(line.phase)
    assert line.amplitude == pytest.approx(LOBES.size, abs=0.06)
    assert row(line)[2] == "another in each"


def test_a_vibration_is_no_line() -> None:
    """A wave in time with the frequency of the second order at the usual speed."""
    made = record(3)
    usual = float(np.median(np.abs(made.speed[np.abs(made.speed) > 0.1])))
    shaken = made.torque + 0.3 * np.cos(200.0 * usual * made.time)
    assert names(found([OneAngle(made.time, made.angle, made.speed, shaken)])) == []


@pytest.mark.parametrize(
    ("reach", "torque", "said"),
    [
        (slice(0, 600), 1.0, "turns of the wave generator"),
        (slice(0, 2500), 1.0, "5 are needed"),
        (slice(None), 0.0, "never changes"),
        (slice(None, None, 100), 1.0, "4 samples each"),
        (slice(None, None, 50), 1.0, "record faster"),
    ],
)
def test_what_cannot_be_judged_is_said(reach: slice, torque: float, said: str) -> None:
    made = record(3)
    with pytest.raises(RecordError, match=said):
        found([OneAngle(made.time, made.angle, made.speed, torque * made.torque)], reach=reach)


def bag(path: Path, made: OneAngle, effort: bool = True) -> Path:
    torque = (made.torque,) if effort else None
    return write(path, states(made.time, ("joint_1",), (made.angle,), torque, (made.speed,)))


@pytest.fixture(scope="module")
def one_angle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag(tmp_path_factory.mktemp("one_angle") / "joint.mcap", record(3, [LOBES, BRAKE]))


def test_the_verb_tells_lines_and_writes_them(one_angle: Path, hidden: Ripple, tmp_path: Path) -> None:
    done = hd_diag("ripple", one_angle, "--json", tmp_path / "ripple.json")
    assert (done.exit_code, done.stderr) == (0, ASSUMED)
    assert "joint_1: The torque ripples with the gear of ratio 100: " in done.stdout
    assert "100, reverses" in done.stdout
    told = json.loads((tmp_path / "ripple.json").read_text())
    assert (told["schema"], told["joint"], told["unit"]) == ("hd_diag/ripple/1", "joint_1", "N m")
    seen = {(line["order"], line["reverses"]): line for line in told["lines"] if line["found"]}
    assert seen[200.0, False]["amplitude"] == pytest.approx(LOBES.size, abs=3 * seen[200.0, False]["std"])
    assert told["record"]["windows"] == hidden.windows


def test_tables_and_mapped_signals_serve_as_well(one_angle: Path, tmp_path: Path) -> None:
    """Current in milliampere, angle in degrees; also the motor's angle, which is the ratio times it."""
    made, told = record(3, [LOBES, BRAKE]), list[str]()
    degrees = {"t": made.time, "q": np.degrees(made.angle), "i": made.torque / 11.2 * 1e3}
    motor = {"t": made.time, "m": RATIO * made.angle, "tau": made.torque}
    tables = (degrees, "time=t,output=q[deg],torque=i[mA]*11.2"), (motor, "time=t,input=m,torque=tau")
    for given, columns in tables:
        path = write_table(tmp_path / "r.csv", given)
        done = hd_diag("ripple", path, "--columns", columns, "--json", "-")
        assert (done.exit_code, done.stderr) == (0, ASSUMED)
        told.append(done.stdout)
    config = config_file(tmp_path, output_signal__scale=-1.0, torque_signal__sign=-1)
    told.append(hd_diag("ripple", one_angle, "--config", config, "--json", "-").stdout)
    for text in told:
        each = {(x["order"], x["reverses"]): x["amplitude"] for x in json.loads(text)["lines"]}
        assert each[200.0, False] == pytest.approx(LOBES.size, abs=0.03)
        assert each[100.0, True] == pytest.approx(BRAKE.size, abs=0.05)


def test_the_report_has_the_ripple(one_angle: Path, tmp_path: Path) -> None:
    done = hd_diag("report", one_angle, "--out", tmp_path / "r.html", "--json", tmp_path / "r.json")
    assert (done.exit_code, done.stderr) == (0, ASSUMED)
    told = json.loads((tmp_path / "r.json").read_text())
    assert "what the torque shows: hd-diag ripple" in told["error"]
    assert [line["order"] for line in told["ripple"]["lines"] if line["found"]] == [100.0, 200.0]
    page = (tmp_path / "r.html").read_text()
    assert "<h3>Ripple of the torque</h3>" in page
    assert 'id="joint1-ripple' in page
    assert "with the gear of ratio 100" in page


@pytest.mark.parametrize("verb", ["diagnose", "report", "ripple"])
def test_one_angle_and_nothing_else_is_one_line(verb: str, tmp_path: Path) -> None:
    path = bag(tmp_path / "bare.mcap", record(3, duration=5.0), effort=False)
    out = ("--out", tmp_path / "page.html") if verb == "report" else ()
    parts = ("one angle has no transmission error", "publish the motor encoder's", "an effort or a current")
    assert_one_line_error(hd_diag(verb, path, *out), *parts)


def test_a_fleet_keeps_the_ripple(one_angle: Path, tmp_path: Path) -> None:
    done = hd_diag("fleet", one_angle, "--jobs", "1", "--out", tmp_path / "f.parquet")
    assert done.exit_code == 0
    (kept,) = pq.read_table(tmp_path / "f.parquet").to_pylist()
    at = kept["ripple_orders"].index(200.0)
    assert (kept["ripple_found"][at], kept["error"]) == (True, None)
    assert kept["ripple_amplitudes_Nm"][at] == pytest.approx(LOBES.size, abs=0.05)
    assert "with the gear of ratio 100" in kept["verdict"]


def test_a_ripple_makes_a_series_where_it_was_seen_once() -> None:
    lines = {"orders": [200.0, 400.0], "reverses": [False, True], "stds_Nm": [0.02, 0.02]}
    rows = []
    for day in range(3):
        seen = lines | {"amplitudes_Nm": [0.1 * day, 0.01], "found": [day > 1, False]}
        row = {"bag": f"{day}.mcap", "joint": "joint_1", "start": fleet_tasks.BEGIN + day * fleet_tasks.DAY}
        rows.append(row | {f"ripple_{name}": values for name, values in seen.items()})
    (series,) = series_of(rows, {("joint_1", "ripple_200"): 0.5})
    assert (series.quantity, series.unit, series.limit) == ("ripple_200", "N m", 0.5)
    assert series.value == pytest.approx([0.0, 0.1, 0.2])
    assert series.std == pytest.approx(0.02)
