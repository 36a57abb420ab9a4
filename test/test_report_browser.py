"""The report's page in Chromium: what a reader on a phone, at a desk or with a printer gets."""

import base64
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import chromium, contrast, requested, sized
from challenge import records
from cli_runner import hd_diag
from report_samples import hostile_page, joint_report, known_to_the_command_line, made

from hd_diag.formatting import ARCSEC, arcsec


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as driver:
        yield driver


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Address of a page of two joints with names that want to be markup."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(hostile_page(), encoding="utf-8")
    return path.as_uri()


def opened(browser: Any, address: str, width: int = 1280) -> Any:
    """The browser with a page; what was logged before is forgotten."""
    sized(browser, width)
    browser.get_log("browser")
    browser.get_log("performance")
    browser.get(address)
    return browser


@pytest.mark.parametrize("width", [360, 1280])
def test_it_fits_its_window_and_nothing_complains(browser: Any, hostile: str, width: int) -> None:
    opened(browser, hostile, width)
    across = "const page = document.documentElement; return [page.scrollWidth, page.clientWidth]"
    whole, seen = browser.execute_script(across)
    assert whole == seen <= width
    beyond = """return [...document.querySelectorAll('main *:not(svg *), header *, footer *')]
        .filter(e => e.getBoundingClientRect().right > window.innerWidth + 1 && !e.closest('thead'))
        .map(e => e.tagName + ' ' + e.textContent.slice(0, 60))"""
    assert browser.execute_script(beyond) == []
    assert browser.get_log("browser") == []


def test_letters_in_pictures_can_be_read_on_a_phone(browser: Any, hostile: str) -> None:
    """At least 9 px high, and none reaches out of its picture."""
    opened(browser, hostile, 360)
    found = browser.execute_script("""return [...document.querySelectorAll('svg')].flatMap(svg => {
        const frame = svg.getBoundingClientRect(), scale = frame.width / svg.viewBox.baseVal.width;
        return [...svg.querySelectorAll('text')].map(text => {
            const box = text.getBoundingClientRect();
            const out = Math.max(frame.left - box.left, box.right - frame.right);
            return [text.textContent, parseFloat(getComputedStyle(text).fontSize) * scale, out];
        })})""")
    assert len(found) > 100
    assert [text for text, size, _ in found if size < 9.0] == []
    assert [text for text, _, out in found if out > 2.0] == []


def test_letters_in_pictures_do_not_cover_each_other(browser: Any, hostile: str) -> None:
    opened(browser, hostile, 360)
    covering = browser.execute_script("""return [...document.querySelectorAll('svg')].flatMap(svg => {
        const boxes = [...svg.querySelectorAll('text')].map(t => [t.textContent, t.getBoundingClientRect()]);
        const pairs = [];
        boxes.forEach(([a, p], i) => boxes.slice(i + 1).forEach(([b, q]) => {
            const width = Math.min(p.right, q.right) - Math.max(p.left, q.left);
            const height = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
            if (width > 2 && height > 4) pairs.push([svg.querySelector('title').textContent, a, b]);
        }));
        return pairs;})""")
    assert covering == []


def test_it_asks_the_network_for_nothing(browser: Any, hostile: str) -> None:
    opened(browser, hostile)
    asked = requested(browser)
    assert hostile in asked
    assert [address for address in asked if address != hostile and not address.startswith("data:")] == []


def test_names_out_of_a_bag_do_nothing(browser: Any, hostile: str) -> None:
    opened(browser, hostile)
    count = "return document.querySelectorAll('script, img, [onerror], b, foreignObject').length"
    assert browser.execute_script(count) == 0
    text = browser.execute_script("return document.body.textContent")
    assert "<script>alert(1)</script><img src=x onerror=alert(2)>$\\frac{1}{2}$" in text
    ids = browser.execute_script("return [...document.querySelectorAll('[id]')].map(e => e.id)")
    assert len(set(ids)) == len(ids)


def test_the_policy_stops_a_script_that_got_in_all_the_same(browser: Any, tmp_path: Path) -> None:
    """The second line of defence, tried with the first one taken away."""
    bad = "<script>document.title = 'taken'</script><img src=x onerror=\"document.title = 'taken'\">"
    path = tmp_path / "page.html"
    path.write_text(hostile_page().replace("<main>", f"<main>{bad}"), encoding="utf-8")
    opened(browser, path.as_uri())
    assert browser.title.startswith("Harmonic drive report")
    assert any("Content Security Policy" in entry["message"] for entry in browser.get_log("browser"))


def test_its_colours_have_contrast_by_day_and_by_night(browser: Any, hostile: str) -> None:
    """WCAG 2.1, success criterion 1.4.3: 4.5 to 1 for text."""
    pairs = """const seen = {};
        const back = e => { while (e) { const c = getComputedStyle(e).backgroundColor;
            if (c !== 'rgba(0, 0, 0, 0)') return c; e = e.parentElement; } return 'rgb(255, 255, 255)'; };
        for (const e of document.querySelectorAll('body *')) {
            if (![...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim())) continue;
            const style = getComputedStyle(e);
            seen[(e instanceof SVGElement ? style.fill : style.color) + '|' + back(e)] = e.tagName;
        }
        return seen"""
    for scheme in ("light", "dark"):
        media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
        opened(browser, hostile)
        found = browser.execute_script(pairs)
        assert len(found) > 3
        for colours, tag in found.items():
            if tag not in ("title", "desc"):
                assert contrast(*map(colour, colours.split("|"))) >= 4.5, (scheme, tag, colours)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def colour(told: str) -> list[float]:
    return [int(part) / 255 for part in re.findall(r"\d+", told)[:3]]


def test_it_prints(browser: Any, hostile: str) -> None:
    opened(browser, hostile)
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})
    content = base64.b64decode(printed["data"])
    assert content.startswith(b"%PDF-")
    pages = len(re.findall(rb"/Type\s*/Page\b", content))
    assert 6 <= pages <= 30


def test_what_the_command_draws_is_what_it_says(
    browser: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Numbers seen in the page are those of the JSON of the same run."""
    known_to_the_command_line(monkeypatch, "output_runout")
    bag, out, told_file = (tmp_path / name for name in ("joint.mcap", "page.html", "told.json"))
    records.write_bag(made("output_runout"), bag)
    assert hd_diag("diagnose", bag, "--report", out, "--json", told_file).exit_code == 0
    told = json.loads(told_file.read_text())
    opened(browser, out.as_uri())
    verdict, gain, cards, ladder = (
        browser.find_element("css selector", selector).text
        for selector in (".verdict", ".gain", ".cards", "svg[aria-labelledby='joint1-ladder-title']")
    )
    assert verdict.lower() == told["verdict"].lower()
    assert all(arcsec(told[stage]["rms"]) in gain for stage in ("nominal", "refit", "extended"))
    size = told["refit"]["parameters"]["eccentricity.magnitude"]["value"]
    seen = re.search(r"eccentricity\s+([\d.]+) ±", cards)
    assert seen is not None
    assert float(seen[1]) == pytest.approx(size * 1e6, abs=0.06)
    judgement = joint_report("output_runout").judgement
    assert judgement is not None
    assert f"{judgement.ladder[-1].rms / ARCSEC:.2f}" in ladder
