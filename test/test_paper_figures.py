"""The paper's figures: claims hold for its drive, their numbers are the published ones, and they can fail."""

import dataclasses
import re
from pathlib import Path
from xml.etree import ElementTree as Xml

import drives
import numpy as np
import pytest
from cli_runner import runner
from numpy.testing import assert_allclose
from reference import published

from hd_diag.cli import cli
from hd_diag.drive import Drive
from hd_diag.model.transmission_error import Kinematics
from hd_diag.report.paper_figures import first_interference, neutral_layer, teeth_at_once, tooth_over_time

ROOT = Path(__file__).resolve().parent.parent


def drive(datum: float = drives.PAPER.circular_spline_datum) -> Drive:
    paper = dataclasses.replace(drives.PAPER, circular_spline_datum=datum)
    return Drive(drives.mesh(paper), Kinematics(100.0), published.RATED_TORQUE)


def test_every_claim_holds() -> None:
    claims = [
        claim
        for figure in (neutral_layer, teeth_at_once, tooth_over_time)
        for claim in figure(drive()).claims
    ]
    assert [claim.letter for claim in claims] == ["a", "a", "b", "b", "c", "d", "e", "e"]
    assert [claim.text for claim in claims if not claim.holds] == []


def test_interference_begins_where_it_was_published() -> None:
    assert first_interference(drive(published.DATUM_OF_INTERFERENCE)) == pytest.approx(23e-6, abs=0.05e-6)
    rounded = published.ECCENTRICITY_AT_ROUNDED_DATUM
    assert first_interference(drive()) == pytest.approx(rounded, abs=0.01e-6)


def test_the_example_drive_tells_where_interference_begins() -> None:
    """In a comment: with the exact datum, and with the rounded one that the file has."""
    lines = (ROOT / "config" / "example_drive.yaml").read_text().splitlines()
    text = " ".join(line.lstrip("# ") for line in lines)
    found = re.search(
        r"([\d.]+) mm let interference .*? of ([\d.]+) mm, .*? to ([\d.]+) mm .*? at ([\d.]+) mm", text
    )
    assert found is not None
    exact, first, rounded, begins = map(float, found.groups())
    assert drives.PAPER.circular_spline_datum == pytest.approx(rounded * 1e-3)
    assert round(first_interference(drive(exact * 1e-3)) * 1e3, 4) == first
    assert round(first_interference(drive()) * 1e3, 4) == begins


def test_numbers_of_the_load_are_the_published_ones() -> None:
    found = teeth_at_once(drive())
    assert_allclose(found.load.max(axis=1)[[0, -1]], [39.8, 60.1], atol=0.05)
    assert "from 70 to 64" in found.claims[-1].text
    assert "39.8 to 60.1 N" in found.claims[-1].text


def test_numbers_of_one_tooth_are_the_published_ones() -> None:
    found = tooth_over_time(drive())
    by_size = {turn.eccentricity: turn for turn in published.TURNS}
    for row, turn in ((0, by_size[0.0]), (-1, by_size[-published.ECCENTRICITY])):
        assert np.nanmin(found.backlash[row]) == pytest.approx(turn.least_backlash, abs=0.01e-6)
        assert found.load[row].max() == pytest.approx(turn.largest_force, abs=0.05)
    near = by_size[published.ECCENTRICITY]
    assert np.nanmin(found.near[0]) == pytest.approx(near.least_backlash, abs=0.01e-6)
    assert found.near[1].max() == pytest.approx(near.largest_force, abs=0.05)


def test_a_drive_of_another_clearance_does_not_agree() -> None:
    """Slots 8 um farther out never interfere at the published eccentricity."""
    claims = teeth_at_once(drive(29.876e-3)).claims
    assert "c" in [claim.letter for claim in claims if not claim.holds]


@pytest.mark.parametrize("kind", ["svg", "png", "pdf"])
def test_files_are_written_the_same_each_time(kind: str, tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("first", "second")]
    for folder in folders:
        result = runner().invoke(cli, ["figures", "--out", str(folder), "--format", kind])
        assert (result.exit_code, result.stderr) == (0, "")
        assert "does not agree" not in result.stdout
    names = {f"figure_{number}.{kind}" for number in (5, 6, 7)}
    assert {path.name for path in folders[0].iterdir()} == {*names, "figures.md"}
    for name in names:
        content = (folders[0] / name).read_bytes()
        assert content == (folders[1] / name).read_bytes()
        assert is_whole(content, kind)
    captions = (folders[0] / "figures.md").read_text(encoding="utf-8")
    assert all(f"]({name})" in captions for name in names)
    assert all(f"* ({letter}) " in captions for letter in "abcde")


def is_whole(content: bytes, kind: str) -> bool:
    if kind == "svg":
        return Xml.fromstring(content).tag == "{http://www.w3.org/2000/svg}svg"
    if kind == "png":
        return content.startswith(b"\x89PNG\r\n") and content.endswith(b"IEND\xaeB`\x82")
    return content.startswith(b"%PDF-") and content.rstrip().endswith(b"%%EOF")


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = runner().invoke(cli, ["figures", "--out", str(tmp_path / "file" / "in")])
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1
    assert "cannot be written" in result.stderr
