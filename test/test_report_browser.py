"""The report's page in Chromium, for readers with a phone, a desktop or a printer."""

import base64
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import opened, page_faults
from report_samples import configured, hostile_page

from hd_diag.diagnosis.gain import Rms
from hd_diag.formatting import ARCSEC
from hd_diag.report.pictures.comparison import model_ladder
from hd_diag.report.pictures.markup import inline_svg
from hd_diag.report.pictures.teeth import tooth_maps
from hd_diag.report.stages import Rung
from hd_diag.report.teeth import teeth_over_turn


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(hostile_page(), encoding="utf-8")
    return path.as_uri()


def test_nothing_overflows_or_overlaps_and_all_can_be_read(browser: Any, hostile: str) -> None:
    assert page_faults(browser, hostile) == []


def test_such_faults_are_seen(browser: Any, tmp_path: Path) -> None:
    faulty = """<!DOCTYPE html><html lang="en"><title>a</title>
        <meta name="viewport" content="width=device-width"><p style="width: 500px">wide</p>
        <div style="overflow: auto; width: 9px">cutoff</div><p style="color: #999">pale</p>
        <p>above<span style="margin-left: -1em">below</span></p>
        <svg width="100" viewBox="0 0 100 20"><path id="m" d="M0 0H9V9H0Z"/><use href="#m" x="20" y="8"/>
        <text x="18" y="18" fill="#aaa">3.1</text></svg><script src="https://example.org/a.js"></script></html>"""
    path = tmp_path / "page.html"
    path.write_text(faulty, encoding="utf-8")
    told = "\n".join(page_faults(browser, path.as_uri()))
    wanted = ("390 px: the page is 5", "cut off or scrolled: div cutoff", "one over the other: above | below")
    wanted += ("a mark over: 3.1", "asked for https://example.org/a.js", "color-contrast: p", "letters: 3.1")
    assert [fault for fault in wanted if fault not in told] == []


def test_the_numbers_of_a_ladder_lie_free_of_its_marks(browser: Any, tmp_path: Path) -> None:
    """Also if held-out data fit worse than all stretches; a gear without load has a scale, too."""
    rungs = [
        Rung(name, k * ARCSEC, 0.95 * k * ARCSEC, 1.05 * k * ARCSEC) for name, k in (("a", 40), ("b", 5))
    ]
    told = Rms(*(k * ARCSEC for k in (47.0, 5.6, 5.6, 5.6, 5.6, 5.6, 3.2, 3.1, 3.4)))
    angle = np.linspace(0.0, 6.0, 200)
    idle = tooth_maps(teeth_over_turn(configured().joints[0].drive, angle, np.zeros(200)))
    drawn = {"ladder": model_ladder(rungs, told), "maps": idle}
    pictures = "".join(inline_svg(figure, name, name, "0") for name, figure in drawn.items())
    path = tmp_path / "page.html"
    wide = '<meta name="viewport" content="width=device-width"><body style="max-width: 32rem; margin: 0">'
    path.write_text(
        f'<!DOCTYPE html><html lang="en"><title>a</title>{wide}{pictures}</html>', encoding="utf-8"
    )
    assert page_faults(browser, path.as_uri(), rules=()) == []


def test_letters_in_pictures_can_be_read_on_a_phone(browser: Any, hostile: str) -> None:
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


def test_the_policy_stops_a_script_that_got_in_all_the_same(browser: Any, tmp_path: Path) -> None:
    """The second line of defence, tested without the first."""
    bad = "<script>document.title = 'taken'</script><img src=x onerror=\"document.title = 'taken'\">"
    path = tmp_path / "page.html"
    path.write_text(hostile_page().replace("<main>", f"<main>{bad}"), encoding="utf-8")
    opened(browser, path.as_uri())
    assert browser.title.startswith("Harmonic drive report")
    assert any("Content Security Policy" in entry["message"] for entry in browser.get_log("browser"))


def test_it_prints(browser: Any, hostile: str) -> None:
    opened(browser, hostile)
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})
    content = base64.b64decode(printed["data"])
    assert content.startswith(b"%PDF-")
    pages = len(re.findall(rb"/Type\s*/Page\b", content))
    assert 6 <= pages <= 30
