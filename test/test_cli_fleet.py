"""`hd-diag fleet`: end to end with the real diagnosis; then interrupted runs, with a quick substitute."""

import json
import os
import re
import shutil
import signal
import socket
import sys
from collections import Counter
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import fleet_tasks
import numpy as np
import pool_tasks
import pyarrow.parquet as pq
import pytest
from browser import opened, page_faults
from cli_runner import ASSUMED, assert_one_line_error, config_file, files_up_to, hd_diag
from click.testing import Result
from live import config

from hd_diag.cli import fleet as cli_fleet
from hd_diag.fleet import run
from hd_diag.fleet.rows import Row, Task
from hd_diag.simulation import Motion, Noise, SimulatedJoint, write_bag

ARCSEC = np.pi / 648000.0
SAME = 1e-4  # of an optimum: the search stops at such steps


def fleet(*arguments: object, jobs: bool = True) -> Result:
    return hd_diag("fleet", *arguments, *(("--jobs", "1") if jobs else ()))


def findings(errors: str) -> list[str]:
    """Lines of stderr, without the progress every ten seconds and the note about the assumed drive."""
    lines = [line for line in errors.splitlines() if not re.match("hd-diag: (reading|diagnosing): ", line)]
    return [line for line in lines if line != ASSUMED.strip()]


def table(path: Path) -> list[dict[str, Any]]:
    return pq.read_table(path).to_pylist()


class Runs:
    """Runs over small bags; a substitute for the diagnosis notes each request."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self._monkeypatch = folder, monkeypatch
        self.bags, self.out = folder / "bags", folder / "f.parquet"
        self.journal, self._calls = folder / "f.parquet.journal.jsonl", folder / "calls"
        self._calls.mkdir()
        monkeypatch.setenv(pool_tasks.CALLS, str(self._calls))
        self.judge(fleet_tasks.quick)

    def judge(self, diagnosis: Callable[[Task], Row]) -> None:
        self._monkeypatch.setattr(run, "judge", diagnosis)

    def __call__(self, days: int, *options: object, out: Path | None = None) -> Result:
        return fleet(self.made(days), "--out", out or self.out, *options)

    def made(self, days: int, folder: Path | None = None) -> Path:
        """A folder with the given number of bags, one per day."""
        bags = folder or self.bags
        bags.mkdir(exist_ok=True)
        for day, path in enumerate(bags / f"{day:02}.mcap" for day in range(days)):
            if not path.exists():
                fleet_tasks.small_bag(path, day)
        return bags

    @property
    def asked(self) -> list[str]:
        return [name for name, _ in pool_tasks.calls(self._calls)]

    @property
    def errors(self) -> list[str | None]:
        return [row["error"] for row in table(self.out)]


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Runs:
    """Runs whose tasks are done by workers."""
    return Runs(tmp_path, monkeypatch)


@pytest.fixture
def here(elsewhere: Runs, monkeypatch: pytest.MonkeyPatch) -> Runs:
    """Runs whose tasks are done in this process."""
    monkeypatch.setattr(cli_fleet, "_pool", lambda options: pool_tasks.PoolHere())
    return elsewhere


# The real diagnosis ---

HOSTILE = "[red]$x^2$\n\x1b[31m'; DROP.mcap"


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    """A run over a bag, copies of it with hostile names, a truncated bag, and some that cannot be judged."""
    folder = tmp_path_factory.mktemp("fleet")
    bags = folder / "bags"
    (bags / "deep").mkdir(parents=True)
    truth = config(joint_1__eccentricity__magnitude=12e-6)
    joints = {"joint_1": SimulatedJoint(truth.joints[0].drive, Noise(white=2.0 * ARCSEC))}
    motion = Motion(20.0, 100.0, (2.0 * np.pi,))
    rng = np.random.default_rng(0)
    write_bag(bags / "good.mcap", truth, motion, rng, joints, start=fleet_tasks.BEGIN)
    shutil.copy(bags / "good.mcap", bags / HOSTILE)
    shutil.copy(bags / "good.mcap", os.path.join(os.fsencode(bags), b"deep", b"\xff\xfe.mcap"))
    whole = (bags / "good.mcap").read_bytes()
    (bags / "zeros.mcap").write_bytes(whole[:8] + bytes(len(whole) - 8))
    fleet_tasks.small_bag(bags / "short.mcap")
    fleet_tasks.small_bag(bags / "strange.mcap", names=("elbow_\x07motor", "elbow"))
    (bags / "notes.txt").touch()
    later = fleet_tasks.BEGIN + fleet_tasks.DAY
    write_bag(bags / "torn.mcap", truth, motion, np.random.default_rng(1), joints, start=later)
    torn = (bags / "torn.mcap").read_bytes()
    (bags / "torn.mcap").write_bytes(torn[: 3 * len(torn) // 4])
    outputs = ("--out", folder / "f.parquet", "--json", folder / "f.json", "--figure", folder / "f.png")
    return fleet(bags, *outputs, "--report", folder / "week.html", "--fail-on", "amber"), folder


def test_every_bag_has_its_row(judged: tuple[Result, Path]) -> None:
    result, folder = judged
    assert result.exit_code == 1, result.output  # some state is not green
    errors = {Path(row["bag"]).name: row["error"] for row in table(folder / "f.parquet")}
    assert len(errors) == 7
    assert [errors[name] for name in ("good.mcap", HOSTILE, "\\udcff\\udcfe.mcap")] == [None] * 3
    assert "too short: 12 usable samples" in errors["short.mcap"]
    assert errors["strange.mcap"] == (
        "no 'joint_1'; joint states there hold 'elbow', 'elbow_\\x07motor'; its topics are '/j'; "
        "see hd-diag topics"
    )
    assert errors["zeros.mcap"]


def test_a_row_is_what_diagnose_says(judged: tuple[Result, Path]) -> None:
    """Numbers agree to the step at which the search for an optimum stops."""
    _, folder = judged
    rows = [row for row in table(folder / "f.parquet") if row["error"] is None and not row["problems"]]
    told = hd_diag("diagnose", folder / "bags" / "good.mcap", "--json", "-", "--fail-on-cause")
    written = json.loads(told.stdout)
    assert (told.exit_code, told.stderr, written["unexplained"]) == (0, ASSUMED, [])
    size = written["refit"]["parameters"]["eccentricity.magnitude"]
    normal = written["normal"]
    equal = {name: written[name] for name in ("verdict", "judgement", "advice")}
    equal |= {"samples": 2000, "causes": [cause["name"] for cause in written["causes"]]}
    equal |= {"start": datetime(2026, 1, 1, tzinfo=timezone.utc)}
    near = {"rms_extended_rad": written["gain"]["rms_extended"], "accuracy_rad": normal["accuracy"]}
    near |= {"error_rad": normal["measured"], "error_std_rad": normal["std"]}
    near |= {"eccentricity_m": size["value"], "eccentricity_std_m": size["std"]}
    near |= {"eccentricity_allowed_m": written["tolerance"]["allowed"]}
    assert written["record"]["samples"] == 2000
    assert abs(size["value"] - 12e-6) < 4.0 * size["std"]
    for row in rows:
        assert {name: row[name] for name in equal} == equal
        assert {name: row[name] for name in near} == pytest.approx(near, rel=SAME)
    assert len({row["bag_sha256"] for row in rows}) == 1


def test_what_a_run_says_in_the_terminal_and_in_json(judged: tuple[Result, Path]) -> None:
    """No bag's name reaches the terminal unescaped."""
    result, folder = judged
    said = result.stdout + result.stderr
    assert "\x1b" not in said
    assert "\x07" not in said
    assert "cannot tell yet" in " ".join(result.stdout.split())
    told = Counter(line.partition(": ")[0] for line in findings(result.stderr))
    assert told == {"not judged": 3, "cut off": 2, "recorded at the same time": 1}
    written = json.loads((folder / "f.json").read_text())
    assert (written["schema"], written["bags"], written["rows"]) == ("hd_diag/fleet/1", 7, 7)
    assert len(written["errors"]) == 3
    trend = next(trend for trend in written["trends"] if trend["quantity"] == "eccentricity")
    assert (trend["joint"], trend["bags"], trend["form"]) == ("joint_1", 4, "unknown")
    assert trend["needed"] > 4
    assert trend["last"]["time"] == "2026-01-02T00:00:00+00:00"
    assert (folder / "f.png").read_bytes().startswith(b"\x89PNG")
    # Equal contents are judged once: good, torn and short bag. Unreadable bags are never started.
    assert len((folder / "f.parquet.journal.jsonl").read_text().splitlines()) == 3


def test_the_weekly_page_says_how_the_joint_stands_and_leads_to_its_page(
    judged: tuple[Result, Path], browser: Any
) -> None:
    """The last, truncated recording gives the state; top and row report the damage; no link is dead."""
    _, folder = judged
    assert page_faults(browser, (folder / "week.html").as_uri()) == []
    told = json.loads((folder / "f.json").read_text())
    (joint,), problems = told["joints"], {Path(each["bag"]).name: each for each in told["problems"]}
    assert (Path(joint["bag"]).name, {*problems}) == ("torn.mcap", {"torn.mcap", "zeros.mcap"})
    assert (joint["state"], joint["recorded"]) == ("red", "2026-01-02T00:00:00+00:00")
    assert (joint["since"], joint["recordings"]) == ("2026-01-01T00:00:00+00:00", 4)
    assert "is cut off or damaged at byte" in problems["torn.mcap"]["problems"][0]
    assert ["eccentricity" in reason or "cut off" in reason for reason in joint["reasons"]] == [True, True]
    opened(browser, (folder / "week.html").as_uri())
    row = browser.find_element("css selector", ".joints tbody tr").text
    assert re.search(r"red\s+since 2026-01-01 \(4 recordings\)", row)
    assert re.search(r"1[12]\.\d+ ± 0\.\d+ µm\s+of 10\.2 µm", row)
    assert "is cut off or damaged" in browser.find_element("css selector", ".attention").text
    links = browser.execute_script("return [...document.querySelectorAll('a')].map(a => a.href)")
    outside = [link for link in links if "#" not in link]
    assert outside == [(folder / joint["page"]).as_uri()]
    opened(browser, outside[0])
    assert "eccentricity" in browser.find_element("css selector", ".verdict").text


# Continuation of runs ---


def test_what_is_known_is_not_judged_again_and_what_failed_is(here: Runs) -> None:
    here.judge(lambda task: [][0])
    failed = here(4)
    assert (failed.exit_code, failed.stderr.count("joint_1: IndexError: ")) == (2, 4)
    here.judge(fleet_tasks.quick)
    assert here(4).exit_code == 0
    first = here.out.read_bytes()
    assert (here(4).exit_code, len(here.asked), here.out.read_bytes()) == (0, 4, first)
    changed = ("--config", config_file(here.folder, torque=1.0))
    for more, asked in (((), 5), (("--fresh",), 10), (changed, 15)):
        assert (here(5, *more).exit_code, len(here.asked)) == (0, asked)
    assert here.asked[4] == "04.mcap"


def test_an_interrupted_run_goes_on(here: Runs) -> None:
    """Ctrl-C: code 130, one line, no table. The next run judges the rest and writes the same table."""

    def interrupting(task: Task) -> Row:
        if len(here.asked) == 2:
            signal.raise_signal(signal.SIGINT)
        return fleet_tasks.quick(task)

    here.judge(interrupting)
    result = here(6)
    kept = len(here.journal.read_text().splitlines())
    line = f"hd-diag: interrupted: {kept} results are in {here.journal}; the same command goes on\n"
    assert (result.exit_code, result.stdout, result.stderr, here.out.exists()) == (130, "", line, False)
    here.judge(fleet_tasks.quick)
    begun, whole = len(here.asked), here.folder / "whole.parquet"
    assert (here(6).exit_code, here(6, out=whole).exit_code) == (0, 0)
    assert 2 <= kept < 6
    assert len(here.asked) == begun + (6 - kept) + 6
    assert whole.read_bytes() == here.out.read_bytes()


def test_a_full_disk_under_the_journal_ends_a_run_that_then_goes_on(here: Runs) -> None:
    """The system ends a write in the second line; with room again, only the missing bags are judged."""
    here.made(4)
    with files_up_to(1500):
        result = here(4)
    assert_one_line_error(result, f"{here.journal}: cannot be written: File too large")
    begun = len(here.asked)
    assert (here.journal.stat().st_size, here.out.exists()) == (1500, False)
    result = here(4)
    lost = f"{here.journal}: 1 of its lines are cut off or damaged; what they held is judged again"
    assert (result.exit_code, lost in result.stderr) == (0, True)
    assert len(here.asked) == begun + 3
    assert here.errors == [None] * 4


def test_robots_are_reported_apart(here: Runs, tmp_path: Path) -> None:
    for robot in ("arm_a", "arm_b"):
        here.made(2, tmp_path / robot)
    arms = (tmp_path / "arm_a", tmp_path / "arm_b")
    result = fleet(*arms, "--robot", r"(arm_.)/", "--out", here.out, "--json", "-")
    trends = json.loads(result.stdout)["trends"]
    assert {(trend["robot"], trend["bags"]) for trend in trends} == {("arm_a", 2), ("arm_b", 2)}
    assert Counter(row["robot"] for row in table(here.out)) == {"arm_a": 2, "arm_b": 2}
    none = fleet(arms[0], "--robot", "leg", "--out", here.out)
    assert_one_line_error(none, "--robot leg matches nothing")


def test_pages_are_drawn_once_and_replaced_by_newer_ones(here: Runs) -> None:
    """Bags judged earlier without a page get one; files that the run did not write stay."""
    here.judge(fleet_tasks.drawn)
    page, folder = here.folder / "week.html", here.folder / "week_joints"
    assert (here(3).exit_code, page.exists(), folder.exists()) == (0, False, False)
    assert here(3, "--report", page).exit_code == 0
    (first,) = folder.iterdir()
    assert first.read_text() == "02.mcap"
    assert [row["page"] for row in table(here.out)] == [None, None, f"week_joints/{first.name}"]
    assert f'href="week_joints/{first.name}"' in page.read_text()
    (folder / "notes.html").touch()
    assert [here(days, "--report", page).exit_code for days in (3, 4)] == [0, 0]
    assert here.asked == ["00.mcap", "01.mcap", "02.mcap", "02.mcap", "03.mcap"]
    (second,) = {*folder.iterdir()} - {folder / "notes.html"}
    assert (first.exists(), second.read_text()) == (False, "03.mcap")
    assert first.name not in page.read_text()


@pytest.mark.parametrize(
    ("arcsec", "least", "code"), [(40, "amber", 0), (90, "amber", 1), (90, "red", 0), (99, "red", 1)]
)
def test_it_fails_on_colours_where_asked(here: Runs, arcsec: int, least: str, code: int) -> None:
    here.judge(lambda task: fleet_tasks.result(1e-6, arcsec=arcsec))
    assert (here(1).exit_code, here(1, "--fail-on", least).exit_code) == (0, code)


def test_steps_and_causes_are_reported_and_fail_on_request(here: Runs) -> None:
    here.judge(fleet_tasks.stepped)
    result = here(16, "--fail-on-change", "--figure", here.folder / "f.svg")
    assert result.exit_code == 1
    steps = [line for line in result.stdout.splitlines() if "stepped by" in line]
    named = {line.partition(" stepped")[0] for line in steps}
    assert named == {"joint_1: residual nominal", "joint_1: residual refit"}
    assert all("between 2026-01-08 00:00 and 2026-01-09 00:00" in line for line in steps)
    assert here(16, "--fail-on-cause").exit_code == 0
    here.judge(fleet_tasks.caused)
    given = (here.bags / "00.mcap", here.bags / "01.mcap", "--out", here.folder / "c.parquet")
    assert (fleet(*given).exit_code, fleet(*given, "--fail-on-cause").exit_code) == (0, 1)


def test_a_drift_is_reported_with_the_day_of_its_limit(here: Runs) -> None:
    here.judge(fleet_tasks.drifting)
    result = here(14, "--limit", "residual_refit=3e-5", "--json", "-")
    found = {trend["quantity"]: trend for trend in json.loads(result.stdout)["trends"]}
    limit = found["residual_refit"]["limit"]
    assert limit["reached_low"] < limit["reached"] < limit["reached_high"]
    reached = datetime.fromisoformat(limit["reached"]) - datetime(2026, 1, 1, tzinfo=timezone.utc)
    assert reached.days == pytest.approx(20, abs=1)  # 1e-5 rad, growing by 1e-6 a day
    assert found["residual_refit"]["slope"]["value"] == pytest.approx(1e-6 / 86_400.0, rel=0.1)
    assert found["eccentricity"]["form"] == "constant"


@pytest.mark.slow
def test_a_bag_that_hangs_while_it_is_looked_at(elsewhere: Runs, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "survey", fleet_tasks.stuck_survey)
    assert elsewhere(2, "--bag-timeout", "4").exit_code == 0
    assert elsewhere.errors == ["took longer than 4 s", None]


def test_what_is_no_file_is_reported_and_not_opened(here: Runs, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening them would hang (FIFO) or never end (device); no circular link is followed."""
    bags = here.bags
    for folder in ("deep", "whole"):
        (bags / folder).mkdir(parents=True)
    fleet_tasks.small_bag(bags / "good.mcap")
    (bags / "deep" / "back").symlink_to(bags)
    (bags / "circle.mcap").symlink_to("circle.mcap")
    (bags / "device.db3").symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as bound:
        monkeypatch.chdir(bags)  # a socket's name must be short
        bound.bind("socket.mcap")
    for name in ("fifo.mcap", "whole/metadata.yaml", "whole/whole_0.mcap"):
        os.mkfifo(bags / name)
    assert here(0, "--bag-timeout", "60").exit_code == 0
    errors = {Path(row["bag"]).name: row["error"] for row in table(here.out)}
    expected = dict.fromkeys(("fifo.mcap", "device.db3", "socket.mcap"), "is not a file or folder")
    expected |= {"circle.mcap": "does not exist", "whole": "holds no .mcap or .db3 file", "good.mcap": None}
    assert errors == expected


# Bad input ---


def test_no_bag_that_can_be_judged(here: Runs) -> None:
    here.bags.mkdir()
    (here.bags / "a.mcap").write_bytes(b"garbage")
    result = here(0)
    assert (result.exit_code, here.errors) == (2, ["is not an MCAP file"])
    assert findings(result.stderr)[-1] == "hd-diag: no bag could be judged"


def test_what_is_not_installed_or_of_another_version_is_reported(
    elsewhere: Runs, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(cli_fleet, "_NEEDED", ("pyarrow", "no_such_module"))
        said = f"fleet needs no_such_module: {sys.executable} -m pip install 'hd_diag[fleet]'"
        assert_one_line_error(elsewhere(1), said)
    monkeypatch.setitem(sys.modules, "distributed", None)
    needs = fleet(elsewhere.bags, "--out", elsewhere.out, "--scheduler", "tcp://127.0.0.1:9", jobs=False)
    assert_one_line_error(needs, "--scheduler needs Dask: pip install 'hd_diag[cluster]'")
    monkeypatch.setattr("hd_diag.__version__", "9.9")
    assert_one_line_error(elsewhere(1), "a worker has hd_diag 0.1.0, this is 9.9")
