"""Tables in users' formats: the same record for any layout of the text; units of time."""

import contextlib
import functools
import os
import shlex
import time as clock
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from cli_runner import assert_one_line_error, hd_diag
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st
from joint_records import columns, joint, prepared
from numpy.testing import assert_allclose
from test_recording import NAMES, states, write

from hd_diag.diagnosis.record import Record, RecordError
from hd_diag.records.joint_record import read_bags, read_motion
from hd_diag.records.table_columns import table_columns
from hd_diag.records.tables import Table, read_table_motion, read_tables
from hd_diag.records.text_table import quantity

ORDER = ("time", "input", "output", "torque")
NAMED = {"time": "t", "input": "m", "output": "l", "torque": "tau"}
Columns = dict[str, np.ndarray]
NUMBERED = {"time": "1", "input": "2", "output": "3", "torque": "4"}


@pytest.fixture(scope="module")
def given() -> Columns:
    return columns(seconds=2.0)


def rows(given: Columns, between: str, decimal: str = ".") -> list[str]:
    values = np.stack([given[name] for name in ORDER], axis=1)
    return [between.join(f"{v:.17g}".replace(".", decimal) for v in row) for row in values]


@functools.cache
def expected() -> Record:
    return prepared(columns(seconds=2.0))


def written(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines))
    return path


def check(path: Path, table: Table, count: int = 1) -> None:
    record = read_tables([path], table, joint())
    for name in ("time", "input_angle", "output_angle", "reported_torque"):
        own = getattr(record, name).reshape(count, -1)
        wanted = np.tile(getattr(expected(), name), (count, 1))
        assert_allclose(own - own[:, :1] * (name == "time"), wanted, 0, 1e-6)


ABOVE = {
    "nothing": [],
    "names": ["t{}m{}l{}tau"],
    "remarks": ["Recorded by a logger, version 2.1", "Sample rate{}200", "", "t{}m{}l{}tau"],
    "marked": ["# made on Monday", "# t{}m{}l{}tau"],
    "units": ["t{}m{}l{}tau", "[s]{}[rad]{}[rad]{}[N m]"],
}


BETWEEN = [(",", "."), (";", ","), ("\t", ","), ("|", "."), (" ", "."), ("   ", ","), (", ", ".")]


@pytest.mark.parametrize(
    ("above", "between", "decimal"),
    [
        *((above, *each) for above in ("remarks", "units") for each in BETWEEN),
        *((above, *each) for above in ("nothing", "names", "marked") for each in BETWEEN[:6:5]),
    ],
)
def test_rows_are_found_below_whatever_stands_above(
    above: str, between: str, decimal: str, given: Columns, tmp_path: Path
) -> None:
    head = [line.replace("{}", between) for line in ABOVE[above]]
    if above == "units" and between.isspace():
        head[1] = head[1].replace("N m", "Nm")
    path = written(tmp_path / "a.csv", *head, *rows(given, between, decimal))
    check(path, Table(NUMBERED))
    if head:
        check(path, Table(NAMED))


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_encodings_of_spreadsheets(encoding: str, end: str, given: Columns, tmp_path: Path) -> None:
    """An angle in °, a name with umlaut, in a Windows code page or as Excel's Unicode text."""
    shown = {**given, "output": np.degrees(given["output"])}
    path, header = tmp_path / "a.csv", "Zeit [s];Motor;Länge (°);tau"
    path.write_bytes(end.join([header, *rows(shown, ";", ",")]).encode(encoding))
    check(path, Table({"time": "Zeit", "input": "Motor", "output": "Länge", "torque": "tau"}))


@pytest.mark.parametrize("above", ["names", "remarks", "marked", "units"])
def test_files_put_one_behind_the_other_are_recordings(above: str, given: Columns, tmp_path: Path) -> None:
    head = [line.replace("{}", ";") for line in ABOVE[above]]
    path = written(tmp_path / "a.csv", *[*head, *rows(given, ";")] * 2)
    check(path, Table(NAMED), 2)
    assert np.unique(read_tables([path], Table(NAMED), joint()).bag).size == 2


@pytest.mark.parametrize("style", ["{:%Y-%m-%dT%H:%M:%S.%f}Z", "{:%Y-%m-%d %H:%M:%S.%f}", "{:%H:%M:%S.%f}"])
def test_dates_and_times_of_the_day(style: str, given: Columns, tmp_path: Path) -> None:
    begin = datetime(2024, 2, 28, 23, 59, 50, tzinfo=timezone.utc)
    if "%Y" not in style:
        begin -= timedelta(hours=5)
    told = [style.format(begin + timedelta(seconds=float(t))) for t in given["time"]]
    lines = [f"{t},{line.partition(',')[2]}" for t, line in zip(told, rows(given, ","), strict=True)]
    check(written(tmp_path / "a.csv", "t,m,l,tau", *lines), Table(NAMED))


@drawn(st.datetimes(datetime(1970, 1, 1), datetime(2100, 1, 1)), st.integers(-12 * 60, 14 * 60))
@settings(max_examples=50, deadline=None)
def test_a_date_is_the_standard_library_s(when: datetime, minutes: int) -> None:
    aware = when.replace(tzinfo=timezone(timedelta(minutes=minutes)))
    plain = when.replace(tzinfo=timezone.utc).timestamp()
    assert quantity(aware.isoformat()) == pytest.approx(aware.timestamp(), abs=1e-6)
    assert quantity(when.isoformat(" ")) == pytest.approx(plain, abs=1e-6)


@drawn(st.text("0123456789.,;|\t #-eET:[]()abcN\n\"'", max_size=300))
@settings(max_examples=300, deadline=None)
def test_any_text_is_a_table_or_one_line(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_text(text)
    with pytest.raises(RecordError) as caught:  # too short, if no other reason
        read_tables([path], Table(NUMBERED), joint())
    assert "\n" not in str(caught.value)
    with contextlib.suppress(RecordError):
        table_columns(path)


def test_names_of_many_columns_are_compared_once(tmp_path: Path) -> None:
    """Comparing all pairs took 20 s for 3,000 names; duplicate names are addressed by number."""
    path, header = tmp_path / "wide.csv", [f"joint{k % 2999}_pos [rad]" for k in range(3000)]
    path.write_text(",".join(header) + "\n" + (",".join(map(str, range(3000))) + "\n") * 3)
    begin = clock.process_time()
    fields = table_columns(path).fields
    assert clock.process_time() - begin < 5.0
    assert [fields[k].field for k in (0, 1, 2998, 2999)] == ["1", "joint1_pos", "joint2998_pos", "3000"]


@pytest.mark.parametrize("verb", ["diagnose", "report", "ripple", "topics"])
def test_a_pipe_is_refused_at_once(verb: str, tmp_path: Path) -> None:
    path = tmp_path / "pipe.csv"
    os.mkfifo(path)
    begin = clock.monotonic()
    more = () if verb == "topics" else ("--columns", "time=1,input=2,output=3,torque=4")
    assert_one_line_error(hd_diag(verb, path, *more), "is no file but a pipe")
    assert clock.monotonic() - begin < 10.0


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("read", [read_tables, read_table_motion])
def test_a_time_in_another_unit_is_asked_about(
    unit: str, factor: float, read: Callable[..., object], given: Columns, tmp_path: Path
) -> None:
    shown = rows({**given, "time": factor * given["time"]}, ",")
    path = written(tmp_path / "a.csv", "t,m,l,tau", *shown)
    asked = rf"Hz\): is the time in {unit}\?.* give the column as time=t\[{unit}\],"
    with pytest.raises(RecordError, match=asked):
        read([path], Table(NAMED), joint())
    check(path, Table({**NAMED, "time": f"t[{unit}]"}))
    read([path], Table({**NAMED, "time": "t[s]"}), joint())  # accepted if the user says so


def test_a_joint_that_needs_hours_for_a_turn_is_asked_about(tmp_path: Path) -> None:
    """4 kHz in ms, which read as seconds still gives a plausible rate; also for a bag."""
    time = np.arange(2000) / 4.0
    angle = 1e-3 * time
    angles = 100 * angle, angle
    shown = rows(dict(zip(ORDER, (time, *angles, angle), strict=True)), ",")
    with pytest.raises(RecordError, match=r"would need 1\.7 hours for a turn: is the time in ms\?"):
        read_tables([written(tmp_path / "a.csv", "t,m,l,tau", *shown)], Table(NAMED), joint())
    for step in (1.0, 8.0):
        bag = write(tmp_path / f"{step}.mcap", states(step * time, NAMES, angles, (angle, angle)))
        for read in (read_bags, read_motion):
            with pytest.raises(RecordError, match=r"is the time in ms\? The robot's driver has to stamp"):
                read([bag], joint())


TURNED = 180 / np.pi
GUESSED = {
    "units": (
        "t [ms],motor [deg],link [turns],torque [N mm]",
        {"time": 1e3, "input": TURNED, "output": TURNED / 360, "torque": 1e3},
        "time=t,input=motor[deg],output=link[turns],torque=torque[N mm]",
    ),
    "milliseconds": ("stamp,m,l,effort", {"time": 1e3}, "time=stamp[ms],input=m,output=l,torque=effort"),
    "low lines": (
        "time_us,motor_q_deg,link_q_rad,from_current_Nm",
        {"time": 1e6, "input": TURNED},
        "time=time_us[us],input=motor_q_deg[deg],output=link_q_rad,torque=from_current_Nm[Nm]",
    ),
    "torque of a current": (
        "t,motor_position,link_position,torque_by_current",
        {},
        "time=t,input=motor_position,output=link_position,torque=torque_by_current",
    ),
    "nameless": ("", {}, "time=1,input=2,output=3"),
    "swapped names": ("time,a=b,c[0],tau", {}, "time=time,input=2,output=3,torque=tau"),
}


@pytest.mark.parametrize("case", list(GUESSED))
def test_columns_are_guessed_and_the_guess_is_taken(case: str, given: Columns, tmp_path: Path) -> None:
    """`topics` and `diagnose` without --columns print the same line, and it gives the record."""
    header, factors, guess = GUESSED[case]
    shown = {name: column * factors.get(name, 1.0) for name, column in given.items()}
    path = written(tmp_path / "a.csv", header, *rows(shown, ","))
    result = hd_diag("topics", path)
    assert (result.exit_code, result.stderr) == (0, "")
    line = result.stdout.splitlines()[-1]
    words = shlex.split(line)
    assert words == ["hd-diag", "diagnose", str(path), "--columns", guess]
    asked = hd_diag("diagnose", path)
    assert (asked.exit_code, asked.stdout) == (2, result.stdout)
    assert asked.stderr.endswith(f"needs --columns, such as: {line}\n")
    of_report = line.replace("diagnose", "report", 1)
    assert hd_diag("report", path).stderr.endswith(f"needs --columns, such as: {of_report}\n")
    taken = dict(pair.split("=", 1) for pair in guess.split(","))
    check(path, Table({"torque": "4"} | taken))


def test_one_angle_in_a_table_is_for_ripple(given: Columns, tmp_path: Path) -> None:
    """It uses the measured torque, not the model's."""
    path, model = tmp_path / "a.csv", 0.1 * given["torque"]
    columns = given["time"], given["output"], model, given["torque"]
    np.savetxt(path, np.stack(columns, axis=1), delimiter=";", header="t;q;tau_model;tau", comments="")
    line = hd_diag("topics", path).stdout.splitlines()[-1]
    assert line == f"hd-diag ripple {path} --columns time=t,output=q,torque=tau"
    assert "columns" not in hd_diag(*shlex.split(line)[1:]).stderr
