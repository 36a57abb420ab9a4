"""SVG of pictures: their texts, harmless names, and equal output for equal numbers."""

import re
from itertools import combinations
from xml.etree import ElementTree as Xml

import matplotlib as mpl
import numpy as np
import pytest
from browser import contrast
from eccentric_drive import _least_backlash, drive_picture
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from report_samples import HOSTILE

from hd_diag.config.configuration import resolve
from hd_diag.diagnosis.gain import Rms
from hd_diag.formatting import ARCSEC
from hd_diag.report.pictures import canvas
from hd_diag.report.pictures.comparison import evidence, model_ladder, remainders
from hd_diag.report.pictures.markup import inline_svg
from hd_diag.report.stages import Curve, Rung

SVG = "{http://www.w3.org/2000/svg}"


@canvas.drawn
def labelled(title: str, curve: str = "a curve") -> Figure:
    figure, (axes,) = canvas.sheet(2.0)
    axes.plot([0.0, 1.0, 2.0], [0.0, 1.0, 0.5], "o-", label=curve)
    axes.imshow(np.eye(3), extent=(0.0, 2.0, 0.0, 1.0), aspect="auto")
    canvas.titled(axes, title)
    return figure


def texts(svg: str) -> list[str]:
    return [element.text or "" for element in Xml.fromstring(svg).iter(f"{SVG}text")]


def test_a_hostile_name_is_letters_and_nothing_else() -> None:
    """It contains no style either; ink has the page's colour."""
    name = HOSTILE.replace("\x07", "")  # not allowed in XML: the page spells it out before
    svg = inline_svg(labelled(name, name), "a", name, name)
    root = Xml.fromstring(svg)
    tags = {element.tag for element in root.iter()}
    assert not tags & {f"{SVG}script", f"{SVG}img", f"{SVG}style", f"{SVG}metadata"}
    assert texts(svg).count(name) == 2
    told = {element.get("id"): element.text for element in root if element.get("id")}
    assert told[root.get("aria-labelledby")] == told[root.get("aria-describedby")] == name
    assert [part for part in ("<script", "<img", "style=", "<style", canvas.INK) if part in svg] == []
    assert [part for part in ("currentColor", 'font-size="8.5"') if part not in svg] == []


def test_nothing_in_it_is_mathematics_whatever_matplotlib_is_set_to() -> None:
    with mpl.rc_context({"text.parse_math": True, "axes.titlesize": 40}):
        svg = inline_svg(labelled("$\\frac{1}{2}$ and $x$"), "a", "", "")
    assert "$\\frac{1}{2}$ and $x$" in texts(svg)
    assert svg == inline_svg(labelled("$\\frac{1}{2}$ and $x$"), "a", "", "")


def test_every_reference_has_an_id_of_the_picture_s_own() -> None:
    """Pictures of a page share no ids: test_report.py."""
    svg = inline_svg(labelled("same"), "first", "", "")
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', svg))
    assert used
    assert used | {"first-title", "first-text"} == set(re.findall(r'\bid="([^"]+)"', svg))


@pytest.mark.parametrize("page", ["#ffffff", "#15181d"])
def test_every_colour_stands_out_of_a_light_and_a_dark_page(page: str) -> None:
    """WCAG 2.1, success criterion 1.4.11: 3 to 1 for graphics."""
    used = (canvas.NOMINAL, canvas.REFIT, canvas.EXTENDED, canvas.ACCENT, canvas.GRID, *canvas.SERIES)
    for colour in used:
        assert contrast(*map(mpl.colors.to_rgb, (colour, page))) > 3.0, colour


def test_a_ladder_shows_its_numbers() -> None:
    rms = np.array([46.0, 12.5, 3.3]) * ARCSEC
    names = ["as configured", "refitted", "+ hysteresis"]
    held_out = Rms(*rms, rms[2], *rms[:2], *np.array([3.2, 3.1, 3.4]) * ARCSEC)
    rungs = [Rung(name, value, 0.9 * value, 1.1 * value) for name, value in zip(names, rms, strict=True)]
    svg = inline_svg(model_ladder(rungs, held_out), "a", "", "")
    assert {*names, "46.00", "12.50", "3.30"} <= set(texts(svg))


def test_the_evidence_s_bars_have_names_and_numbers() -> None:
    """The row without the cause comes first, then the closest alternatives; the cause itself has no row."""
    weighed = {
        "hysteresis": {"": -143.3, "hysteresis": 0.0, "viscous_windup": -30.0, "coulomb_windup": -6.65},
        "output_runout": {"": -8.0, "output_runout": 0.0},
    }
    seen = texts(inline_svg(evidence(weighed), "a", "", ""))
    windups = (f"{kind} windup for hysteresis" for kind in ("coulomb", "viscous"))
    rows = ["no hysteresis", *windups, "no output runout"]
    assert [text for text in seen if text in rows] == rows
    assert {"143", "30", "6.65", "8"} <= set(seen)


def test_remainders_are_drawn_over_what_they_follow() -> None:
    place = np.linspace(-1.0, 1.0, 50)
    torque = Curve("function of torque", "N m", 40.0 * place, 1e-5 * place**3)
    seen = texts(inline_svg(remainders([torque, Curve("line 2", "N m", place, place)]), "a", "", ""))
    assert {"Function of torque [arcsec], over [N m]", "Line 2 [arcsec], over [N m]"} <= set(seen)


def test_drawing_of_a_drive_has_readable_labels_and_its_interference() -> None:
    own = resolve({}).joints[0].drive
    figure = drive_picture(own)
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.canvas.draw()
    letters = [text for axes in figure.axes for text in axes.texts if text.get_text()]
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in letters]
    assert len(boxes) >= 15
    assert [(a, b) for (a, first), (b, second) in combinations(boxes, 2) if first.overlaps(second)] == []
    assert [text for text, box in boxes if not (box.x0 >= 0.0 and box.x1 <= figure.bbox.width)] == []
    where, least, positive = _least_backlash(own)
    struck = np.degrees(where[least < 0.0]) % 360.0
    assert np.all((struck > 20.0) & (struck < 75.0) == positive[least < 0.0])
    assert np.all((struck > 155.0) & (struck < 210.0) != positive[least < 0.0])
    assert np.nanmin(least) == pytest.approx(-18.3e-6, abs=0.1e-6)  # as for the paper's tooth 0, by symmetry
