"""Numbers and page of a report: the diagnosis's own; nothing in a bag acts on the page."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, TRUE, bench, solved
from browser import Markup
from challenge import records
from cli_runner import ASSUMED, assert_one_line_error, config_file, hd_diag
from joint_records import ARCSEC, columns, prepared
from numpy.testing import assert_allclose, assert_array_equal
from report_samples import (
    HOSTILE,
    configured,
    diagnosis,
    eccentric,
    hostile_page,
    joint_report,
    known_to_the_command_line,
    letters,
    made,
    report_of,
    without_output,
)
from test_verdict import cause as cause_of

from hd_diag.cli.record import Judged, Records, judge_each
from hd_diag.config.configuration import JointConfig, dump, resolve
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.evidence.unexplained import Unexplained
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.verdict import as_json
from hd_diag.drive import mesh_state, transmission_error
from hd_diag.formatting import arcsec, words
from hd_diag.gears.catalogue import table
from hd_diag.records.joint_record import InputRecord
from hd_diag.report.cards import cards
from hd_diag.report.facts import Fact, Judgement, of_motion, quality_of, settings
from hd_diag.report.page import TERMS, Links, page, used
from hd_diag.report.torsion import k_shown

SOURCES = [Fact("a.mcap", "SHA-256 0")]
OTHER = pytest.param("input_encoder_eccentricity", marks=pytest.mark.slow)
EACH = pytest.mark.parametrize("name", ["output_runout", OTHER])


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the pictures of a page, which take two seconds; other tests draw them."""
    monkeypatch.setattr("hd_diag.report.page.inline_svg", lambda *_, **__: "")


def judged(name: str) -> Judgement | None:
    return joint_report(name).judgement


# Numbers ---


@EACH
def test_the_ladder_s_rungs_lead_down_to_the_noise(name: str) -> None:
    """The ladder holds out other data than the diagnosis: their figures agree within a fifth."""
    found, rms = judged(name), diagnosis(name).rms
    nominal, refitted, named, extended = found.ladder
    for compared in (found.over_angle, found.over_torque):  # over the same samples
        assert list(compared.simulated) == ["as configured", "refitted", "extended"]
        assert compared.measured.samples.sum() == compared.samples
        for residual in compared.residual.values():
            assert_array_equal(residual.samples, compared.measured.samples)
    rungs = ["as configured", "refitted", f"+ {words(name)}", "+ remainders"]
    assert [rung.name for rung in found.ladder] == rungs
    assert nominal.rms > refitted.rms > named.rms > 0.9 * extended.rms > 0.8 * rms.noise
    own = [rms.nominal, rms.refit, rms.offline]
    assert_allclose([nominal.rms, refitted.rms, extended.rms], own, rtol=0.2)
    for rung, before in zip(found.ladder[1:], found.ladder, strict=False):
        assert rung.low < rung.rms < rung.high
        assert_allclose(rung.gain, 1.0 - (rung.rms / before.rms) ** 2, rtol=1e-9)
        assert rung.gain_low < rung.gain < rung.gain_high


@pytest.mark.parametrize("name", [OTHER])
def test_the_order_of_a_cause_is_marked(name: str) -> None:
    """An off-centre input encoder is order 1 of the wave generator, which turns with the input."""
    found, (mark,) = judged(name), judged(name).marks
    assert (mark.name, mark.order) == (words(name), pytest.approx(1.0, abs=0.01))
    amplitude = float(np.std(records.added_by(made(name), name)))
    assert mark.amplitude == pytest.approx(np.sqrt(2.0) * amplitude, rel=0.15)
    stages = (found.orders[name] for name in ("refitted", "extended"))
    before, after = (size[np.abs(order - 1.0) < 0.02].max() for order, size in stages)
    assert before > 4.0 * after


@EACH
def test_stiffness_is_that_of_the_drive_that_made_the_record(name: str) -> None:
    """Measured and fitted stiffness agree: within 10 % where teeth come into contact, 5 % beyond."""
    for entry, reach in zip(joint_report(name).torsion.stiffness, (0.1, 0.05, 0.05), strict=True):
        if np.isfinite(entry.measured):
            assert entry.measured_low < entry.measured < entry.measured_high
            assert entry.measured == pytest.approx(entry.fitted, rel=reach)
    assert np.isfinite(joint_report("output_runout").torsion.stiffness[1].measured)


def test_cards_are_sorted_by_size_and_leave_out_what_may_be_nothing() -> None:
    """A harmonic below two standard deviations is not on the card; a cause without any other has no card."""
    found, told = diagnosis("output_runout"), judged("output_runout").cards
    alike = {"output runout", "output encoder eccentricity"}
    hidden = next(card for card in told if card.title.lower() in alike)
    assert {hidden.title.lower(), *(name for name, _ in hidden.alternatives)} == alike
    assert all(inspect for _, inspect in hidden.alternatives)
    sizes = [card.size for card in told]
    assert len(sizes) > 2
    assert sizes == sorted(sizes, reverse=True)
    (cause,) = found.causes
    effect, given = cause.effect, (cause.coefficients, cause.nonlinear)
    name = effect.quantities[0].name
    value, _ = effect.to_physical(*given)[name]
    spread = effect.standard_deviations(*given, cause.covariance)[name]
    for sigmas, shown in ((2.1, [words(name)]), (1.9, [])):
        wider = dataclasses.replace(cause, covariance=cause.covariance * (value / sigmas / spread) ** 2)
        doubted = dataclasses.replace(found, found=dataclasses.replace(found.found, causes=(wider,)))
        own = [card for card in cards(Answer(doubted)) if card.title == words(effect.name).capitalize()]
        assert [measure for card in own for measure in dict(card.measures) if measure == words(name)] == shown
        assert bool(own) == bool(shown)


def test_what_to_do_stands_first_then_how_bad_the_joint_is(undrawn: None) -> None:
    found, report = judged("output_runout"), joint_report("output_runout")
    told = as_json(diagnosis("output_runout"), "joint_1")
    part = r"\(\d+ of 90 arcsec peak to peak\)"
    assert re.fullmatch(rf"The joint is within its accuracy {part}\.", report.said[0])
    assert letters("".join(report.said)) == letters(told["verdict"])
    assert report.lines == [told["advice"], *report.said]
    (gauge,) = found.gauges
    assert gauge.share == pytest.approx(float(re.findall(r"\d+", report.said[0])[0]) / 90.0, abs=0.01)
    read = Markup(page([report], SOURCES))
    places = [read.text.index(text) for text in (told["advice"], *report.said[:2])]
    assert places == sorted(places)
    (light,) = (span for span in read.all("span") if span.get("class") == "light")
    assert light["aria-label"] == "Traffic light: red"
    assert told["advice"].startswith("Inspect: output runout or output encoder eccentricity (")


def test_what_is_usual_asks_for_nothing(undrawn: None) -> None:
    """A loop as in catalogues and an eccentricity within all limits have cards without instructions."""
    made = dataclasses.replace(diagnosis("output_runout"), findings=())
    loop = cause_of("hysteresis")
    sizes = {"coefficients": np.full(loop.coefficients.size, 5.0 * ARCSEC)}
    small = dataclasses.replace(loop, **sizes, covariance=1e-10 * loop.covariance)
    usual = dataclasses.replace(made, found=dataclasses.replace(made.found, causes=(small,)))
    shown = {card.title: card for card in cards(Answer(usual))}
    assert {card.usual for card in shown.values()} == {"Usual for a new gear", "No limit is exceeded"}
    assert {"sharpness", "spread"}.isdisjoint(dict(shown["Hysteresis"].measures))
    assert "bending reach" in dict(shown["Hysteresis"].measures)
    report = report_of(usual)
    text = Markup(page([report], SOURCES)).text
    assert (report.advice.light, report.advice.action) == ("green", "nothing")
    assert "What was found and asks for nothing" in text
    assert EFFECTS["hysteresis"].inspect not in text


def test_terms_are_explained_where_they_come_first() -> None:
    links = Links()
    first = links("The datum & <overlap>; Overlaps by windup.")
    assert str(first) == (
        'The <a class="term" href="#term-datum">datum</a> &amp; &lt;<a class="term" href="#term-overlap">'
        'overlap</a>&gt;; Overlaps by <a class="term" href="#term-windup">windup</a>.'
    )
    assert str(links("the datum, and lost motion")) == (
        'the datum, and <a class="term" href="#term-lost-motion">lost motion</a>'
    )
    assert list(used("lost motion of a datum")) == ["datum", "lost motion"]
    assert {"datum", "overlap", "interference", "lost motion", "windup"} <= set(TERMS)


def test_stiffness_stands_beside_that_of_the_page_between_its_t1_and_t2(undrawn: None) -> None:
    config = resolve({f"joint_1.gear.{n}": value for n, value in table()["CSG-14-50"].given.items()})
    motion = InputRecord(np.arange(300) * 0.01, np.linspace(0.0, 20.0, 300), None, np.zeros(300, np.int64))
    found = of_motion(motion, config.joints[0], config.flat, "nothing")
    assert [(one.low, one.high) for one in found.torsion.stiffness[1:]] == [(2.0, 6.9), (6.9, 13.8)]
    assert [one.page for one in found.torsion.stiffness] == [3400.0, 4700.0, 5700.0]
    shown = page([found], [])
    assert 'data-name="page">0.340<' in shown
    assert "K2, 2 to 6.9 N m" in shown
    config = resolve({})
    assert 'data-name="page"' not in page([of_motion(motion, config.joints[0], config.flat, "nothing")], [])
    # Small and large gears have the same number of digits.
    assert [k_shown(k) for k in (512.0, 2.55e4, 3.0e4, 25.34e4)] == ["0.0512", "2.55", "3.00", "25.3"]


def test_the_eccentricity_s_card_tells_what_a_dial_gauge_reads() -> None:
    values = diagnosis("output_runout").parameters
    card = next(c for c in judged("output_runout").cards if c.title.startswith("Eccentricity"))
    told = {name: float(value.split()[0]) for name, value in card.measures}
    size, turned = (values[f"eccentricity.{key}"]["value"] for key in ("magnitude", "direction"))
    assert told["eccentricity"] == pytest.approx(size * 1e6, abs=0.06)
    assert told["dial gauge, total travel"] == pytest.approx(2e6 * size, abs=0.06)
    direction = told["direction, from slot 0"]
    assert direction == pytest.approx(np.degrees(turned) % 180.0, abs=0.6)
    # The long axis turns opposite to the input and stands on slot 0 at input angle zero.
    assert told["input angle with the long axis there"] == pytest.approx(-direction % 180.0, abs=0.6)
    assert all("modulo 180°" in value for name, value in card.measures if "direction" in name)


def test_teeth_are_those_of_the_refitted_drive() -> None:
    teeth, refitted = joint_report("output_runout").teeth, diagnosis("output_runout").refitted
    rows = [0, 60, teeth.moment]
    cup = refitted.drive.frame.cup_torque(np.full(3, teeth.torque))
    state = mesh_state(refitted.drive, teeth.input_angle[rows], cup)
    assert_array_equal(teeth.load[rows], state.load.sum(axis=1))
    assert_array_equal(teeth.backlash[rows], np.fmin(state.backlash[:, 0], state.backlash[:, 1]))
    assert teeth.load[teeth.moment].max() == teeth.load.max() == teeth.greatest_load.max()
    assert np.nanmin(teeth.least_backlash) == np.nanmin(teeth.backlash)
    assert teeth.visited.all()


def test_quality_counts_gaps_and_jitter() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(1000) * 0.002 + 1e-4 * rng.uniform(-1.0, 1.0, 1000)
    time[500:] += 0.5
    found = dict(quality_of(time, 10.0 * time, None, 100.0, np.zeros(1000, dtype=np.int64)))
    assert found["Gaps"] == "1, 0.502 s in all"
    assert float(found["Sample rate"].split()[0]) == pytest.approx(500.0, rel=0.01)
    mean, most = (float(part.split()[0]) for part in found["Jitter of the stamps"].split(","))
    assert (mean, most) == (pytest.approx(67.0, abs=5.0), pytest.approx(185.0, abs=15.0))
    assert (found["Ways turned"], found["Torque"]) == ("100 % forwards, 0 % back", "not measured")


def test_settings_are_told_with_their_units() -> None:
    whole = configured(output_joint="link")
    told = dict(settings(whole.joints[0], whole.flat))
    assert (told["output_joint"], told["teeth"]) == ("link", "those of the example drive")
    assert told["tooth_compliance"] == f"{configured().flat['joint_1.tooth_compliance']} m/N"
    assert not [name for name in told if name.startswith("limits.")]


def test_a_wrong_ratio_is_all_that_is_said_first() -> None:
    """Nothing was fitted: the page exists, with one card, one stage and no ladder."""
    given = columns(seconds=6.0)
    record, own = prepared(given | {"output": -given["output"]}), configured().joints[0].drive
    wrong = diagnose(record, own, np.random.default_rng(0))
    report = report_of(wrong)
    found = report.judgement
    assert [card.title for card in found.cards] == ["Ratio error"]
    assert (list(found.over_angle.residual), found.ladder) == (["as configured"], ())
    read = Markup(page([report], SOURCES))
    assert wrong.findings[0].text in read.text
    assert "Nothing was tested." in read.text
    assert len(read.all("svg")) == 7


def test_a_joint_that_is_eccentric_and_no_more(undrawn: None) -> None:
    """The card's size is the displacement's effect on the error; without a cause no stage is extended."""
    found = eccentric()
    judgement = report_of(found).judgement
    (card,) = judgement.cards
    assert card.title == "Eccentricity of the wave generator in the housing"
    motion = found.record.input_angle, found.record.torque
    added = transmission_error(TRUE, *motion) - transmission_error(CONFIGURED, *motion)
    assert card.size == pytest.approx(np.std(added), rel=0.04)  # a line of order 2 may take a part of it
    assert list(judgement.orders) == ["as configured", "refitted"]
    # A meter is yellow from low to high: over its whole length if the limit is too near to judge.
    near = tuple(gauge._replace(state="near") for gauge in judgement.gauges)
    told = dataclasses.replace(report_of(found), judgement=dataclasses.replace(judgement, gauges=near))
    read = Markup(page([told], SOURCES))
    assert {(meter["low"], meter["high"]) for meter in read.all("meter")} == {("1e-06", "2.0")}
    assert "extended by the causes" not in read.text


def test_a_bearing_that_slips_has_its_order_marked() -> None:
    """The fit has more columns for it than the cause keeps coefficients."""
    bearing = EFFECTS["bearing_passage"]
    fitted = bench(lambda signals: 2e-5 * np.cos(2.6 * signals.wave_generator_angle))
    (cause,) = (whole := solved(fitted, (bearing, (2.6, 1.0)))).causes
    assert fitted.columns(bearing, cause.nonlinear).shape[1] > cause.coefficients.size
    found = Diagnosis(fitted.data.record, CONFIGURED, (), None, whole, None, None)
    (mark,) = report_of(found).judgement.marks
    assert (mark.name, mark.order) == ("bearing passage", pytest.approx(2.6, abs=0.05))


def test_a_record_without_torque_has_no_measured_stiffness(undrawn: None) -> None:
    """An unexplained part without a period is described in words on the page."""
    given = {name: column for name, column in columns(seconds=10.0).items() if name != "torque"}
    record = prepared(given, assumed_torque=30.0)
    slow = Unexplained(0.0, "input", 1e-5, "none", "none", "wanders", "forwards")
    lines = (slow, Unexplained(2.5, "output", 1e-5, "none", "none"))
    report = report_of(Diagnosis(record, CONFIGURED, (), None, None, None, None, unexplained=lines))
    assert not [entry for entry in report.torsion.stiffness if np.isfinite(entry.measured)]
    assert report.torsion.measured == ()
    assert dict(report.quality)["Torque"] == "not measured"
    text = Markup(page([report], SOURCES)).text
    assert text.count("not measured") == 4  # three stiffnesses and the torque
    assert "a part that wanders forwards" in text
    assert "2.50 per output turn" in text


# Page ---


def section(text: str, number: int = 1) -> str:
    return text[text.index(f'<section id="joint{number}"') :].partition("</section>")[0]


def test_equal_numbers_give_an_equal_small_page() -> None:
    text = hostile_page()
    parts = (section(text, number).replace(f"joint{number}", "joint") for number in (1, 2))
    # Terms are explained once and linked at their first use.
    first, again = (re.sub(r'<a class="term"[^>]*>|</a>|<h3>Words (?s:.*?)</dl>\n', "", p) for p in parts)
    assert first == again
    assert len(text.encode()) < 2 * 450_000  # seven joints stay near 3 MB
    text, found = Markup(text).text, diagnosis("output_runout")
    rms = map(arcsec, (found.rms.nominal, found.rms.refit, found.rms.extended, found.rms.noise))
    tested = (part for test in found.testable for part in (words(test.name), test.reason))
    alike = " or ".join(map(words, found.causes[0].alike))
    assert letters("".join(joint_report("output_runout").said)) in letters(text)
    assert [part for part in (*rms, *tested) if part not in text] == []
    assert f"{alike}: this record fits both about as well." in text
    assert {(m["low"], m["high"]) for m in Markup(hostile_page()).all("meter")} == {("1.0", "1.0")}


def test_every_joint_and_picture_is_told_with_ids_of_its_own() -> None:
    text = hostile_page()
    ids = Markup(text).values("id")
    assert len(set(ids)) == len(ids)
    assert {"joint1", "joint2"} <= set(ids)
    places = [attributes["href"] or "" for attributes in Markup(text).all("a")]
    assert places[:2] == ["#joint1", "#joint2"]
    assert "#term-datum" in places
    assert {place.removeprefix("#") for place in places} <= set(ids)
    told = dict(re.findall(r'<(?:title|desc) id="(joint1-[^"]+)">([^<]+)<', text))
    pictures = Markup(section(text)).all("svg")
    assert len(pictures) == 10
    for picture in pictures:
        assert picture["role"] == "img"
        assert len(told[picture["aria-labelledby"] or ""]) > 5
        assert re.search(r"\d", told[picture["aria-describedby"] or ""])


def test_text_of_a_bag_does_nothing_on_the_page() -> None:
    text = hostile_page()
    read = Markup(text)
    assert {tag for tag, _ in read.tags} & {"script", "img", "iframe", "object", "link", "base"} == {"link"}
    assert not [name for _, attributes in read.tags for name in attributes if name.startswith("on")]
    assert HOSTILE.replace("\u202e", "\\u202e").replace("\x07", "\\x07") in read.text
    assert not set(text) & {"\u202e", "\x07"}
    policy = next(a["content"] for a in read.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    safe = r"default-src 'none'; style-src 'sha256-[\w+/=]{44}'; img-src data:; base-uri 'none'"
    assert re.fullmatch(f"{safe}; form-action 'none'", policy or "")
    assert read.values("style") == []
    places = read.values("src", "href", "xlink:href")
    assert places
    assert [place for place in places if not place.startswith(("#", "data:"))] == []


# Command line ---


def test_a_bag_without_output_gets_the_model_s_side(tmp_path: Path) -> None:
    """The JSON gives the reason, and a hostile name in the bag is shown as plain text."""
    bag, out, told = tmp_path / "<b>bag.mcap", tmp_path / "page.html", tmp_path / "a.json"
    without_output(bag, HOSTILE)
    config = config_file(tmp_path, input_joint=f"{HOSTILE}_motor", output_joint=HOSTILE)
    result = hd_diag("report", bag, "--config", config, "--out", out, "--json", told)
    assert (result.exit_code, result.stderr) == (0, "")
    assert "Cannot be judged: no input angle" in result.stdout
    read = Markup(out.read_text(encoding="utf-8"))
    assert {tag for tag, _ in read.tags} & {"script", "img"} == set()
    parts = ("Cannot be judged: no input angle", "<b>bag.mcap", "Measured against simulated")
    assert [part in read.text for part in parts] == [True, True, False]
    assert len(read.all("svg")) == 4  # including the torque over position
    assert not list(tmp_path.glob(".*"))
    found = json.loads(told.read_text())
    assert (found["schema"], found["joint"]) == ("hd_diag/not_judged/1", "joint_1")
    assert re.search(r"(?s)no input angle \('<script>.*with output angle", found["error"])


def test_a_bag_that_goes_while_it_is_judged_loses_nothing(tmp_path: Path) -> None:
    bag, out = tmp_path / "j.mcap", tmp_path / "a.json"
    records.write_bag(made("output_runout"), bag)
    config = resolve({})

    def judged(_joint: JointConfig) -> Judged:
        bag.unlink()
        return {"judgement": "causes"}, [], None

    _, code = judge_each(Records((bag,), config, [*config.joints], None, ()), judged, None, str(out))
    (file,) = json.loads(out.read_text())["files"]
    assert (code, file["path"]) == (0, str(bag))


def test_both_verbs_write_what_they_say(
    monkeypatch: pytest.MonkeyPatch, undrawn: None, tmp_path: Path
) -> None:
    """Bag and table give the same record; both verbs write the same JSON, except for the file."""
    asked = known_to_the_command_line(monkeypatch, "output_runout")
    bag, table, out = (tmp_path / name for name in ("j.mcap", "bench.csv", "a.html"))
    records.write_bag(made("output_runout"), bag)
    records.write_csv(made("output_runout"), table)
    drawn = hd_diag("diagnose", bag, "--report", out, "--json", tmp_path / "a.json")
    assert (drawn.exit_code, drawn.stderr) == (0, ASSUMED)
    told, lines = json.loads((tmp_path / "a.json").read_text()), drawn.stdout.splitlines()
    assert (lines[0], lines[-1]) == (f"joint_1: {told['advice']}", f"report written: {out}")
    assert letters(told["verdict"]) in letters(Markup(out.read_text(encoding="utf-8")).text)
    monkeypatch.setattr("hd_diag.report.page.page", lambda *_: "a page, which takes its time")
    names = ("--columns", "time=time,input=input,output=output,torque=torque,temperature=temperature")
    result = hd_diag("report", table, *names, "--out", out, "--json", "-")
    assert (result.exit_code, result.stderr) == (0, f"report written: {out}\n{ASSUMED}")
    again = json.loads(result.stdout)
    (one,), (other,) = told.pop("files"), again.pop("files")
    assert other == {"path": str(table), "from": None, "to": None}
    assert (one["path"], one["to"] - one["from"]) == (str(bag), pytest.approx(made("output_runout").time[-1]))
    assert (again, out.read_text()) == (told, "a page, which takes its time")
    assert told["report"] == str(out)
    (from_bag, _), (from_table, _) = asked
    assert from_bag.size == made("output_runout").time.size
    assert_allclose(from_bag.input_angle, from_table.input_angle)
    assert_allclose(from_bag.torque, from_table.torque)


@pytest.mark.parametrize("verb", ["diagnose", "report"])
def test_a_joint_that_the_bag_lacks_does_not_stop_the_others(
    verb: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Stderr, JSON and exit code report the missing joint; the page has the others."""
    known_to_the_command_line(monkeypatch, "output_runout")
    monkeypatch.setattr("hd_diag.report.page.page", lambda reports, *_: str([each.said for each in reports]))
    bag, out, told = tmp_path / "joint.mcap", tmp_path / "page.html", tmp_path / "told.json"
    records.write_bag(made("output_runout"), bag)
    config = tmp_path / "two.yaml"
    config.write_text(dump(resolve({"joints": ["elbow", "joint_1"]})), encoding="utf-8")
    given = (verb, bag, "--config", config, *(("--out", out) if verb == "report" else ()), "--json", told)
    alone = hd_diag(*given, "--joint", "elbow")
    assert_one_line_error(alone, "hd-diag: elbow: no input angle ('elbow_motor')")
    assert (out.exists(), told.exists()) == (False, False)
    result = hd_diag(*given)
    said = r"hd-diag: elbow: not judged: no input angle \('elbow_motor'\).*\n"
    assert (result.exit_code, bool(re.fullmatch(said, result.stderr))) == (2, True)
    elbow, joint = json.loads(told.read_text())["joints"]
    assert (elbow["schema"], joint["schema"]) == ("hd_diag/not_judged/1", "hd_diag/diagnosis/1")
    assert verb == "diagnose" or letters(joint["verdict"]) in letters(out.read_text("utf-8"))
