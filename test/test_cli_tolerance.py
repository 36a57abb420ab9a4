"""``hd-diag tolerance``: what it writes, shows and refuses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import assert_one_line_error, config_file, hd_diag
from reference import published

from hd_diag.config.configuration import resolve
from hd_diag.config.defaults import EXAMPLE
from hd_diag.drive import mesh_state
from hd_diag.tolerance.assembly import FACTORS, Share
from hd_diag.tolerance.evaluation import NAMES
from hd_diag.tolerance.study import CHARTED, Question, Yield, limits_and_spreads, yielded

QUICK = ("tolerance", "--samples", "12", "--sensitivity-samples", "2", "--jobs", "1")


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """JSON and text of one run, which also draws a picture."""
    folder = tmp_path_factory.mktemp("tolerance")
    result = hd_diag(*QUICK, "--json", folder / "a.json", "--figure", folder / "a.png")
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    picture = (folder / "a.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 50_000
    return json.loads((folder / "a.json").read_text()) | {"text": result.stdout}


def test_json_holds_what_the_contract_says(told: dict[str, Any]) -> None:
    assert told["schema"] == "hd_diag/tolerance/1"
    assert (told["joint"], told["torques"]) == ("joint_1", [published.RATED_TORQUE])
    assert [row["torque"] for row in told["limits"]] == told["torques"]
    criteria = told["limits"][0]["criteria"]
    assert tuple(criteria) == NAMES
    for name, found in criteria.items():
        assert found["limit"] == resolve({}).flat[f"joint_1.tolerance.limits.{name}"]
        assert set(found["worst"]) >= {"direction", "direction_deg", "input_angle", "value"}
        assert len(found["curve"]["eccentricity"]) == len(found["curve"]["value"]) == 61
    least = min(criteria, key=lambda name: criteria[name]["eccentricity"])
    assert told["allowed"] == {"eccentricity": criteria[least]["eccentricity"], "criterion": least}
    shares = told["assemblies"]["yield"]
    assert tuple(shares) == ("all", *NAMES)
    for share in shares.values():
        assert all(low <= s <= high for s, low, high in zip(*share.values(), strict=True))
    assert tuple(told["sensitivity"]["criteria"]) == NAMES
    assert tuple(told["sensitivity"]["criteria"]["overlap"]) == FACTORS


FEW = "12 assemblies do not tell: 92.5 % are (80.0 to 97.4 %); draw more (--samples)."


@pytest.mark.parametrize(
    ("share", "high", "at", "said"),
    [
        (0.9, 0.94, np.nan, "95 % of the assemblies are not within all limits even without eccentricity."),
        (0.925, 0.974, np.nan, FEW),
        (0.97, 0.99, 3e-6, "up to a tolerance of 3.00 µm"),
    ],
)
def test_few_assemblies_do_not_tell_of_a_share(share: float, high: float, at: float, said: str) -> None:
    flat = resolve({}).flat
    limits, spreads = limits_and_spreads(flat, "joint_1")
    question = Question(EXAMPLE, np.array([56.0]), limits, spreads, 6e-5, 12, 0, 0, 0.95)
    column = Share(np.array([share]), np.array([0.8]), np.array([high]))
    assert said in yielded(question, Yield(np.zeros(1), 1e-5, column, [], at))


def test_numbers_of_the_json_are_the_paper_s_and_the_mesh_s(told: dict[str, Any]) -> None:
    first = told["interference"]
    across = first["across_long_axis"]["eccentricity"]
    assert across == pytest.approx(published.ECCENTRICITY_AT_ROUNDED_DATUM, abs=0.01e-6)
    assert first["all_teeth"]["eccentricity"] < first["any_direction"]["eccentricity"] < across
    found = told["limits"][0]["criteria"]["peak_tooth_load"]
    magnitude, direction = found["eccentricity"], found["worst"]["direction"]
    given = {"joint_1.eccentricity.magnitude": magnitude, "joint_1.eccentricity.direction": direction}
    drive = resolve(given).joints[0].drive
    torque = drive.frame.cup_torque(np.array([56.0]))
    state = mesh_state(drive, np.array([found["worst"]["input_angle"]]), torque)
    assert state.peak_load[0] == pytest.approx(60.0, rel=1e-6)


def test_text_has_units_resolution_and_every_criterion(told: dict[str, Any]) -> None:
    units = ("[µm]", "[rad]", "[deg]", "transmission_error [arcsec]", "peak_tooth_load [N]")
    assert [part for part in (*units, "Resolution", *NAMES) if part not in told["text"]] == []
    tables = [line for line in told["text"].splitlines() if not line.endswith(".")]  # sentences stay whole
    assert max(map(len, tables)) <= 90  # the widest table needs as much


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search up to 1 um may be coarse."""
    steps = {"STEPS": 2, "CHART_STEPS": 2, "_ROUNDS": 1, "_SEARCH": (12, 2), "_SEARCH_OF_JUMPS": (12, 2)}
    for name, value in steps.items():
        monkeypatch.setattr(f"hd_diag.tolerance.limit.{name}", value)


NONE = ("--samples", "0", "--sensitivity-samples", "0", "--jobs", "1", "--largest-um", "1")


def test_svg_and_several_torques_without_assemblies(coarse: None, tmp_path: Path) -> None:
    svg, file = tmp_path / "a.svg", tmp_path / "a.json"
    torques = ("--torque", "14", "--torque", "-56")
    result = hd_diag("tolerance", *NONE, *torques, "--json", file, "--figure", svg)
    found = json.loads(file.read_text())
    assert found["torques"] == [14.0, -56.0]
    assert {found[name] for name in ("assemblies", "sensitivity", "allowed", "tilt")} == {None}
    assert {limit["eccentricity"] for row in found["limits"] for limit in row["criteria"].values()} == {None}
    assert "not reached" in result.stdout
    assert "No limit is reached." in result.stdout
    assert "eccentricity" in svg.read_text()


def test_a_drive_in_sections_has_limits_of_its_tilt_and_a_chart(coarse: None, tmp_path: Path) -> None:
    """Up to 1 um, only the effect of coning exceeds a limit."""
    config = config_file(tmp_path, face_width=11e-3, cup_length=0.04, sections=2)
    svg, file = tmp_path / "a.svg", tmp_path / "a.json"
    given = ("--config", config, "--overlap-um", "1", "--json", file, "--figure", svg)
    result = hd_diag("tolerance", *NONE, *given)
    assert (result.exit_code, result.stderr) == (0, "")
    tilt = json.loads(file.read_text())["tilt"]
    arm = 11e-3 / 2 / np.sqrt(3.0)  # lever arm of two Gauss-Legendre points
    assert tilt["largest_tilt"] == pytest.approx(1e-6 / arm)
    (criteria,) = (row["criteria"] for row in tilt["limits"])
    assert tuple(criteria) == NAMES
    assert (criteria["overlap"]["tilt"], criteria["peak_tooth_load"]["tilt"]) == (0.0, None)
    assert criteria["overlap"]["curve"]["tilt"][-1] == pytest.approx(tilt["largest_tilt"])
    assert tilt["allowed"] == {"tilt": 0.0, "criterion": "overlap"}
    assert set(tilt["chart"]["criteria"]) == set(CHARTED)
    assert set(tilt["chart"]["criteria"]["peak_tooth_load"]["tilt"]) == {None}
    built = "As built, without eccentricity, teeth of the lobe at tooth 0 overlap by 2."
    parts = (
        "Limits of a tilt alone at 56 N m",
        "[mrad]",
        "Allowed without eccentricity: 0.000 mrad, by overlap",
    )
    assert [part for part in (built, *parts) if part not in result.stdout] == []
    assert "against it [mrad]" in svg.read_text()


@pytest.mark.slow
def test_the_seed_decides_what_is_drawn(told: dict[str, Any]) -> None:
    other = json.loads(hd_diag(*QUICK[:-1], "2", "--seed", "1", "--json", "-").stdout)
    assert other["limits"] == told["limits"]
    assert other["sensitivity"] != told["sensitivity"]
    assert other["assemblies"]["yield"] != told["assemblies"]["yield"]


def test_options_take_the_place_of_configured_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test checks the question; the study itself is skipped."""
    asked: list[Question] = []

    def study(question: Question, *_: object) -> None:
        asked.append(question)
        raise ValueError("enough")

    monkeypatch.setattr("hd_diag.cli.tolerance.study", study)
    config = config_file(tmp_path, tolerance__limits__peak_tooth_load=45.0)
    limits = "--overlap-um 5 --te-arcsec 7 --stiffness-loss 0.02 --interference-um 0 --load-concentration 9"
    given = ("--config", config, "--largest-um", "20", *limits.split())
    assert_one_line_error(hd_diag(*QUICK, *given), "enough")
    (question,) = asked
    expected = [0.0, 5e-6, 45.0, 9.0, 0.02, 7 * np.pi / 648000]
    assert [question.limits[name] for name in NAMES] == pytest.approx(expected)
    assert (question.largest, question.samples, question.target) == (pytest.approx(20e-6), 12, 0.95)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("eccentricity: {distribution: gauss}", ("tolerance.eccentricity.distribution", "rayleigh")),
        ("pitch: {distribution: rayleigh}", ("tolerance.pitch.distribution", "triangular")),
        ("pitch: {size: -1.0e-6}", ("tolerance.pitch.size", "[m]")),
        ("limits: {stiffness: 0.1}", ("stiffness", "tolerance.limits.stiffness_loss")),
        ("tooth_compliance: {size: 0.9}", ("tooth_compliance.size", "from 0 to 0.2")),
        ("eccentricity: {size: 9.0e-5}", ("strikes the circular spline",)),
    ],
)
def test_bad_configuration(text: str, parts: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(f"hd_diag: {{ros__parameters: {{joint_1: {{tolerance: {{{text}}}}}}}}}")
    assert_one_line_error(hd_diag(*QUICK, "--config", path), *parts)
