"""The paper's figures: claims hold for its drive, with the published numbers, and can fail for others."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import drives
import numpy as np
import pytest
from cli_runner import assert_one_line_error, hd_diag
from numpy.testing import assert_allclose
from reference import published

from hd_diag.cli.examples import load_example
from hd_diag.config.configuration import resolve
from hd_diag.drive import Drive, mesh_state
from hd_diag.model.mesh import Mesh
from hd_diag.model.transmission_error import Kinematics
from hd_diag.report.pictures.canvas import save

ROOT = Path(__file__).resolve().parent.parent
paper, sections = load_example("paper_figures"), load_example("section_figures")


def drive(datum: float = drives.PAPER.circular_spline_datum) -> Drive:
    geometry = dataclasses.replace(drives.PAPER, circular_spline_datum=datum)
    return Drive(drives.mesh(geometry), Kinematics(100.0), published.RATED_TORQUE)


@pytest.fixture(scope="module")
def teeth() -> Any:
    return paper.teeth_at_once(drive())


def test_every_claim_holds_with_the_published_numbers(teeth: Any) -> None:
    tooth = paper.tooth_over_time(drive())
    claims = [*paper.neutral_layer(drive()).claims, *teeth.claims, *tooth.claims]
    assert [claim.letter for claim in claims] == ["a", "a", "b", "b", "c", "d", "e", "e"]
    assert [claim.text for claim in claims if not claim.holds] == []
    others = paper.teeth_at_once(drive(29.876e-3)).claims  # slots 8 um farther out never interfere
    assert "c" in [claim.letter for claim in others if not claim.holds]
    assert_allclose(teeth.load.max(axis=1)[[0, -1]], [39.8, 60.1], atol=0.05)
    assert "from 70 to 64" in teeth.claims[-1].text
    assert "39.8 to 60.1 N" in teeth.claims[-1].text
    by_size = {turn.eccentricity: turn for turn in published.TURNS}
    away = {-size: (tooth.backlash[row], tooth.load[row]) for row, size in enumerate(tooth.eccentricity)}
    largest = published.ECCENTRICITY
    for size, (backlash, load) in ((0.0, away[0.0]), (-largest, away[-largest]), (largest, tooth.near)):
        assert np.nanmin(backlash) == pytest.approx(by_size[size].least_backlash, abs=0.01e-6)
        assert load.max() == pytest.approx(by_size[size].largest_force, abs=0.05)


def test_interference_begins_where_published() -> None:
    """The example file's comment gives it for the exact datum and for the file's rounded one."""
    lines = (ROOT / "config" / "example_drive.yaml").read_text().splitlines()
    text = " ".join(line.lstrip("# ") for line in lines)
    told = r"([\d.]+) mm let interference .*? of ([\d.]+) mm, .*? to ([\d.]+) mm .*? at ([\d.]+) mm"
    exact, first, rounded, begins = (float(group) * 1e-3 for group in re.search(told, text).groups())
    assert drives.PAPER.circular_spline_datum == pytest.approx(rounded)
    assert exact == pytest.approx(published.DATUM_OF_INTERFERENCE, abs=1e-9)
    assert paper.first_interference(drive(exact)) == pytest.approx(first, abs=0.05e-6)
    assert first == pytest.approx(23e-6)
    at_rounded = paper.first_interference(drive())
    assert at_rounded == pytest.approx(published.ECCENTRICITY_AT_ROUNDED_DATUM, abs=0.01e-6)
    assert at_rounded == pytest.approx(begins, abs=0.05e-6)


def test_the_command_writes_figures_and_captions(tmp_path: Path) -> None:
    result = hd_diag("figures", "--out", tmp_path / "new", "--format", "png")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "does not agree" not in result.stdout
    names, data = ({f"figure_{number}.{kind}" for number in (5, 6, 7)} for kind in ("png", "csv"))
    assert {path.name for path in (tmp_path / "new").iterdir()} == {*names, *data, "drive.png", "figures.md"}
    captions = (tmp_path / "new/figures.md").read_text(encoding="utf-8")
    assert all(f"]({name})" in captions for name in names)
    assert all(f"* ({letter}) " in captions for letter in "abcde")


def test_figures_are_drawn_of_what_is_asked_with_their_data(tmp_path: Path) -> None:
    words = ("--torque", "20", "--eccentricities-um", "0,4,8", "--direction-deg", "0")
    result = hd_diag("figures", "--out", tmp_path, *words)
    assert (result.exit_code, result.stderr) == (0, "")
    assert "* (" not in (tmp_path / "figures.md").read_text(encoding="utf-8")  # claims are of the paper's
    header = (tmp_path / "figure_6.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    table = np.loadtxt(tmp_path / "figure_6.csv", delimiter=",", skiprows=1)
    own = resolve({"joint_1.eccentricity.magnitude": 8e-6}).joints[0].drive
    teeth = own.mesh.geometry.flexspline_teeth
    state = mesh_state(own, np.zeros(1), np.array([20.0]))
    place = table[:, 0].astype(int) % teeth
    found = table[:, header.index("load at 8 um [N]")]
    assert_allclose(found, state.load[0].sum(axis=0)[place], rtol=1e-8, atol=1e-8)
    for wrong in ("0,x", "-1", "1,2,3,4,5,6,7", "nan"):
        said = "--eccentricities-um takes one to 6 numbers"
        assert_one_line_error(hd_diag("figures", "--out", tmp_path, "--eccentricities-um", wrong), said)


CUP = {"face_width": published.FACE_WIDTH, "cup_length": 40e-3}


def coned(sections: int, **changes: complex) -> Drive:
    mesh = Mesh(drives.geometry(sections=sections, **CUP), **changes)
    return Drive(mesh, Kinematics(100.0), published.RATED_TORQUE)


def test_sections_are_drawn_with_the_claims_at_the_middle_and_both_ends(tmp_path: Path) -> None:
    """Least backlash at L = 40 mm from the brute-force calculation, beginning at the cup's bottom."""
    file, out = tmp_path / "cup.yaml", tmp_path / "out"
    rows = {**CUP, "sections": 5}
    text = "hd_diag:\n  ros__parameters:\n    joint_1:\n"
    file.write_text(text + "".join(f"      {name}: {value}\n" for name, value in rows.items()))
    result = hd_diag("figures", "--config", file, "--out", out, "--format", "png", "--eccentricities-um", "0")
    assert (result.exit_code, result.stderr) == (0, "")
    ends = ("", "_bottom", "_middle", "_open_end")
    pictures = {f"figure_{number}{end}" for number in (5, 6, 7) for end in ends} | {"sections"}
    assert {path.stem for path in out.glob("*.csv")} == pictures
    assert {path.stem for path in out.glob("*.png")} == {*pictures, "drive"}
    with (out / "sections.csv").open(encoding="utf-8") as lines:
        names = lines.readline().rstrip().split(",")
        table = np.loadtxt(lines, delimiter=",")
    assert_allclose(np.nanmin(table[:, 1:6], axis=0) * 1e6, [-4.56, -2.09, 0.95, 3.32, 4.68], atol=0.03)
    assert names[1] == "backlash at z = -4.984 mm [m]"
    assert names[-1] == "load per width at z = 4.984 mm [N/m]"
    for column, end in ((1, "bottom"), (3, "middle"), (5, "open_end")):
        tooth = np.loadtxt(out / f"figure_6_{end}.csv", delimiter=",", skiprows=1)
        assert_allclose(tooth[:, :2], table[:, [0, column]], rtol=1e-8)


def test_loads_of_sections_over_the_width_are_the_whole_load() -> None:
    cup = coned(3, tilt=1e-3)
    found = sections.along_width(cup)
    widths = cup.mesh.geometry.face_width * cup.mesh.geometry.section_weights
    whole = paper.teeth_at_once(cup, paper.PAPER._replace(sizes=paper.PAPER.sizes[-1:]))
    assert_allclose(widths @ found.load, whole.load[0], rtol=1e-12, atol=1e-12)
    assert_allclose(np.fmin.reduce(found.backlash), whole.backlash[0], rtol=1e-12)


def test_claims_hold_in_the_middle_of_a_cup(teeth: Any) -> None:
    """The cup's middle is the paper's section; at the bottom teeth interfere by 4.56 um from the start."""
    cup = coned(3)
    drawn = {each.name: each for each in sections.figures(cup)}
    bottom, middle = (drawn[f"figure_6_{end}"] for end in ("bottom", "middle"))
    in_middle = {claim.letter: claim for claim in middle.claims}
    plane = {claim.letter: claim for claim in teeth.claims}
    assert [in_middle[letter] for letter in "bc"] == [plane[letter] for letter in "bc"]
    (told,) = (claim for claim in bottom.claims if claim.letter == "c")
    assert not told.holds
    assert re.fullmatch(r"Teeth interfere without eccentricity, by [34]\.\d µm\.", told.text)


ENDS = {"svg": (b"<?xml", b"</svg>"), "png": (b"\x89PNG\r\n", b"IEND\xaeB`\x82"), "pdf": (b"%PDF-", b"%%EOF")}


@pytest.mark.parametrize("kind", ["svg", "png", pytest.param("pdf", marks=pytest.mark.slow)])
def test_the_same_figure_is_the_same_whole_file(kind: str, teeth: Any, tmp_path: Path) -> None:
    first, second = (tmp_path / f"{name}.{kind}" for name in ("first", "second"))
    for path in (first, second):
        save(paper.figure_6(teeth), path)
    content, begin, end = first.read_bytes(), *ENDS[kind]
    assert content == second.read_bytes()
    assert content.startswith(begin)
    assert content.rstrip().endswith(end)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = hd_diag("figures", "--out", tmp_path / "file" / "in")
    assert_one_line_error(result, "cannot be made: Not a directory")


def test_an_example_that_was_not_installed_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hd_diag.__file__", "/nowhere/hd_diag/__init__.py")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    said = "hd-diag: examples/paper_figures.py is not installed"
    assert_one_line_error(hd_diag("figures", "--out", "never"), said)
