"""``hd-diag tolerance``: what it writes, what it shows, what it refuses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import runner
from click.testing import Result
from reference import published

from hd_diag.cli import cli
from hd_diag.config.configuration import dump, resolve
from hd_diag.drive import mesh_state
from hd_diag.tolerance.assembly import FACTORS
from hd_diag.tolerance.criteria import NAMES
from hd_diag.tolerance.study import Question

QUICK = ("--samples", "12", "--sensitivity-samples", "2", "--jobs", "1")


def run(*arguments: str) -> Result:
    return runner().invoke(cli, ["tolerance", *arguments])


def refused(*arguments: str) -> str:
    result = run(*arguments)
    assert result.exit_code == 2
    assert isinstance(result.exception, SystemExit)
    assert result.stdout == ""
    assert len(result.stderr.splitlines()) == 1
    assert result.stderr.startswith("hd-diag: ")
    return result.stderr


def config_file(folder: Path, **values: Any) -> str:
    """A parameter file with some values of joint_1; double underscores for dots."""
    path = folder / "drive.yaml"
    path.write_text(dump(resolve({f"joint_1.{k.replace('__', '.')}": v for k, v in values.items()})))
    return str(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str, bytes]:
    """JSON, text and picture of one run."""
    folder = tmp_path_factory.mktemp("tolerance")
    result = run(*QUICK, "--json", str(folder / "a.json"), "--figure", str(folder / "a.png"))
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    told = json.loads((folder / "a.json").read_text())
    return told, result.stdout, (folder / "a.png").read_bytes()


def test_json_holds_what_the_contract_says(whole: tuple[dict[str, Any], str, bytes]) -> None:
    told = whole[0]
    assert told["schema"] == "hd_diag/tolerance/1"
    assert (told["joint"], told["torques"]) == ("joint_1", [published.RATED_TORQUE])
    assert [row["torque"] for row in told["limits"]] == told["torques"]
    assert tuple(told["limits"][0]["criteria"]) == NAMES
    for name, found in told["limits"][0]["criteria"].items():
        assert found["limit"] == resolve({}).flat[f"joint_1.tolerance.limits.{name}"]
        assert set(found["worst"]) >= {"direction", "direction_deg", "input_angle", "value"}
        assert len(found["curve"]["eccentricity"]) == len(found["curve"]["value"]) == 61
    shares = told["assemblies"]["yield"]
    assert tuple(shares) == ("all", *NAMES)
    for share in shares.values():
        assert all(low <= s <= high for s, low, high in zip(*share.values(), strict=True))
    assert tuple(told["sensitivity"]["criteria"]) == NAMES
    assert tuple(told["sensitivity"]["criteria"]["overlap"]) == FACTORS


def test_first_interference_is_the_paper_s(whole: tuple[dict[str, Any], str, bytes]) -> None:
    first = whole[0]["interference"]
    across = first["across_long_axis"]["eccentricity"]
    assert across == pytest.approx(published.ECCENTRICITY_AT_ROUNDED_DATUM, abs=0.01e-6)
    assert first["all_teeth"]["eccentricity"] < first["any_direction"]["eccentricity"] < across


def test_the_least_limit_is_what_is_allowed(whole: tuple[dict[str, Any], str, bytes]) -> None:
    told = whole[0]
    criteria = told["limits"][0]["criteria"]
    least = min(criteria, key=lambda name: criteria[name]["eccentricity"])
    assert told["allowed"] == {"eccentricity": criteria[least]["eccentricity"], "criterion": least}


def test_a_direction_and_input_angle_of_the_json_are_the_mesh_s(
    whole: tuple[dict[str, Any], str, bytes], tmp_path: Path
) -> None:
    found = whole[0]["limits"][0]["criteria"]["peak_tooth_load"]
    worst = found["worst"]
    given = {
        "joint_1.eccentricity.magnitude": found["eccentricity"],
        "joint_1.eccentricity.direction": worst["direction"],
    }
    drive = resolve(given).joints[0].drive
    torque = drive.frame.cup_torque(np.array([56.0]))
    state = mesh_state(drive, np.array([worst["input_angle"]]), torque)
    assert state.peak_load[0] == pytest.approx(60.0, rel=1e-6)


def test_text_has_units_resolution_and_every_criterion(whole: tuple[dict[str, Any], str, bytes]) -> None:
    text = whole[1]
    for part in (
        "[um]",
        "[rad]",
        "[deg]",
        "transmission_error [arcsec]",
        "peak_tooth_load [N]",
        "Resolution",
    ):
        assert part in text
    for name in NAMES:
        assert name in text
    assert max(len(line) for line in text.splitlines()) <= 80


def test_picture_is_one(whole: tuple[dict[str, Any], str, bytes]) -> None:
    picture = whole[2]
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 50_000


def test_svg_and_several_torques_without_assemblies(tmp_path: Path) -> None:
    svg, told = tmp_path / "a.svg", tmp_path / "a.json"
    result = run(
        *("--samples", "0", "--sensitivity-samples", "0", "--jobs", "1", "--torque", "14", "--torque", "-56"),
        *("--largest-um", "1", "--json", str(told), "--figure", str(svg)),
    )
    found = json.loads(told.read_text())
    assert found["torques"] == [14.0, -56.0]
    assert (found["assemblies"], found["sensitivity"], found["allowed"]) == (None, None, None)
    assert {limit["eccentricity"] for row in found["limits"] for limit in row["criteria"].values()} == {None}
    assert "not reached" in result.stdout
    assert "No limit is reached." in result.stdout
    assert "eccentricity" in svg.read_text()


@pytest.mark.slow
def test_the_seed_decides_what_is_drawn(whole: tuple[dict[str, Any], str, bytes]) -> None:
    other = json.loads(run(*QUICK[:4], "--jobs", "2", "--seed", "1", "--json", "-").stdout)
    assert other["limits"] == whole[0]["limits"]
    assert other["sensitivity"] != whole[0]["sensitivity"]
    assert other["assemblies"]["yield"] != whole[0]["assemblies"]["yield"]


def test_options_take_the_place_of_configured_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is asked; the study itself is not done."""
    asked: list[Question] = []

    def study(question: Question, *_: object) -> None:
        asked.append(question)
        raise ValueError("enough")

    monkeypatch.setattr("hd_diag.cli.tolerance.study", study)
    config = config_file(tmp_path, tolerance__limits__peak_tooth_load=45.0)
    limits = ("--overlap-um", "5", "--te-arcsec", "7", "--stiffness-loss", "0.02", "--interference-um", "0")
    assert "enough" in refused(
        "--config", config, "--largest-um", "20", *limits, "--load-concentration", "9", *QUICK
    )
    (question,) = asked
    given = [question.limits[name] for name in NAMES]
    assert given == pytest.approx([0.0, 5e-6, 45.0, 9.0, 0.02, 7 * np.pi / 648000])
    assert (question.largest, question.samples, question.target) == (pytest.approx(20e-6), 12, 0.95)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--joint", "elbow"), ("no joint 'elbow'", "joint_1")),
        (("--torque", "0"), ("torque", "not zero")),
        (("--torque", "nan"), ("torque", "finite")),
        (("--largest-um", "500"), ("strikes the circular spline",)),
        (("--largest-um", "0"), ("must be positive",)),
        (("--sensitivity-samples", "100"), ("power of two", "100")),
        (("--sensitivity-samples", "1"), ("power of two",)),
        (("--samples", "-1"), ("--samples",)),
        (("--overlap-um", "nan"), ("overlap", "finite")),
        (("--figure", "a.txt"), ("a.txt", ".png")),
        (("--figure", "no/folder/a.png"), ("no such folder",)),
        (("--config", "none.yaml"), ("none.yaml", "No such file or directory")),
    ],
)
def test_what_cannot_be_is_told_in_one_line(arguments: tuple[str, ...], parts: tuple[str, ...]) -> None:
    told = refused(*QUICK, *arguments)
    for part in parts:
        assert part in told


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (
            "tolerance: {eccentricity: {distribution: gauss}}",
            ("tolerance.eccentricity.distribution", "rayleigh"),
        ),
        ("tolerance: {pitch: {distribution: rayleigh}}", ("tolerance.pitch.distribution", "triangular")),
        ("tolerance: {pitch: {size: -1.0e-6}}", ("tolerance.pitch.size", "[m]")),
        ("tolerance: {limits: {stiffness: 0.1}}", ("stiffness", "tolerance.limits.stiffness_loss")),
        ("tolerance: {tooth_compliance: {size: 0.9}}", ("tooth_compliance.size", "from 0 to 0.2")),
    ],
)
def test_bad_configuration(text: str, parts: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(f"hd_diag: {{ros__parameters: {{joint_1: {{{text}}}}}}}")
    told = refused("--config", str(path), *QUICK)
    for part in (str(path), *parts):
        assert part in told


def test_assemblies_that_cannot_be_assembled_are_told(tmp_path: Path) -> None:
    config = config_file(tmp_path, tolerance__eccentricity__size=9e-5)
    assert "strikes the circular spline" in refused("--config", config, *QUICK)
