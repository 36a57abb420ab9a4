"""The fleet's weekly page: at a desk and on a phone, filtered, with names that look like markup."""

import re
from pathlib import Path
from typing import Any

import pytest
from browser import opened, page_faults
from fleet_tasks import BEGIN, CAUSED, DAY, fleet_rows, judged, row
from report_samples import HOSTILE

from hd_diag.fleet.health_page import health_page
from hd_diag.report.facts import Fact

ROWS = "return [...document.querySelectorAll('.joints tbody tr')].filter(r => r.checkVisibility())"
NAMES = ROWS + ".map(r => r.querySelector('th bdi').textContent)"


def page_of(rows: list[dict[str, Any]]) -> str:
    return health_page(judged(rows), [Fact("Table", "f.parquet")])


def written(path: Path, rows: list[dict[str, Any]]) -> str:
    """Write the page of these rows; returns its address."""
    path.write_text(page_of(rows), encoding="utf-8")
    return path.as_uri()


@pytest.fixture(scope="module")
def some(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Address of a page of five robots, with every state and a name that looks like markup."""
    folder = tmp_path_factory.mktemp("page")
    rows = fleet_rows(robots=5)
    hostile = {"robot": "robot_6", "bag": f"{HOSTILE}.mcap", "joint": HOSTILE, "verdict": HOSTILE}
    own = {"inspect": [f"{HOSTILE}: {HOSTILE}"], "page": f"week_joints/{HOSTILE}"}
    rows += [row(120.0, **hostile, **CAUSED, **own)]
    rows += [{**hostile, "joint": None, "error": HOSTILE, "problems": [f"{HOSTILE}.mcap: {HOSTILE}"]}]
    return written(folder / "week.html", rows)


def test_nothing_is_in_the_way_of_a_reader(browser: Any, some: str, tmp_path: Path) -> None:
    page, unfolded = Path(some.removeprefix("file://")).read_text(), tmp_path / "week.html"
    unfolded.write_text(page.replace("<details>", "<details open>"))
    assert page_faults(browser, unfolded.as_uri()) == []


def test_a_fleet_of_240_joints_fits_both_windows(browser: Any, tmp_path: Path) -> None:
    page = written(tmp_path / "week.html", fleet_rows())
    for width in (390, 1280):
        opened(browser, page, width)
        across = "const page = document.documentElement; return [page.scrollWidth, page.clientWidth]"
        whole, seen = browser.execute_script(across)
        assert whole == seen <= width
        assert len(browser.execute_script(ROWS)) == 240
    marks = "return document.querySelector('.robots').getBoundingClientRect().height"
    assert browser.execute_script(marks) < 800  # pixels of the window: the whole fleet in one view


def test_names_out_of_a_bag_do_nothing(browser: Any, some: str) -> None:
    opened(browser, some)
    count = "return document.querySelectorAll('script, img, [onerror], b, foreignObject').length"
    assert browser.execute_script(count) == 0
    assert "<script>alert(1)</script>" in browser.execute_script("return document.body.textContent")


def test_the_worst_come_first_and_can_be_chosen(browser: Any, some: str) -> None:
    opened(browser, some)

    def shown(*choices: str) -> list[str]:
        for choice in choices:
            browser.find_element("id", choice).click()
        return list(browser.execute_script(NAMES))

    assert len(shown()) == 31
    red = shown("show-red")
    assert red == [name for name in shown("show-all") if name in red]  # red joints come first
    assert [name.split()[0] for name in red] == ["robot_5", "robot_6", "robot_2"]
    assert len(shown("show-look")) == 31 - len(shown("show-green")) == 7
    assert set(shown("robot-0", "show-all")) == {f"robot_1 joint_{number}" for number in range(1, 7)}
    # A click on a mark in the overview shows its joints, whatever the filter.
    hidden = browser.find_element("css selector", ".chips a.red")
    browser.execute_script("arguments[0].click()", hidden)
    assert set(shown()) - {f"robot_1 joint_{number}" for number in range(1, 7)} == {"robot_2 joint_2"}


@pytest.mark.parametrize(
    ("joints", "marks"),
    [
        (("joint_1", "joint_2"), ["1", "2"]),
        (("joint_10", "joint_11"), ["10", "11"]),
        (("joint", "joint_2"), ["joint", "joint_2"]),
        (("elbow", "elbow"), ["elbow", "elbow"]),
    ],
)
def test_a_mark_has_a_name(joints: tuple[str, str], marks: list[str]) -> None:
    page = page_of([row(joint=joint, robot=f"robot_{n}") for n, joint in enumerate(joints)])
    assert sorted(re.findall(r'<bdi aria-hidden="true">(\w*)</bdi>', page)) == marks


def test_what_is_missing_stands_before_the_joints(some: str) -> None:
    page = Path(some.removeprefix("file://")).read_text()
    before, _, rows = page.partition('<table class="joints">')
    assert "is cut off or damaged at byte 228680 of 261683" in before
    assert "too short: 12 usable samples" in before
    assert "date unknown" in before
    assert before.index("cut off") < before.index('id="robots"') < len(before)
    assert rows.count("recorded 2026-") == 31


def test_what_changed_stands_in_its_row_with_its_day() -> None:
    """A drift towards the limit, and the day on which it reaches the limit."""
    page = page_of([row(30.0 + 2.0 * n, start=BEGIN + n * DAY, bag=f"{n}.mcap") for n in range(16)])
    assert "1 changed over time" in page
    drift = re.search(r"transmission error drifts by \+60.*?reaches the limit of 90 arcsec on ([\d-]+)", page)
    assert drift[1] == "2026-01-31"  # 30 days after the first
