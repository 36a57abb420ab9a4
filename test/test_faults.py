"""The table of faults (`faults.py`), run through the command line; test_node.py tests the node's part."""

import ast
import os
import shutil
from pathlib import Path

import faults
import pytest
from cli_runner import assert_one_line_error, hd_diag
from faults import COMMANDS, EVENTS, FILES, PAGE, VALUES, VERBS
from models import write_model

from hd_diag.config.configuration import dump, resolve

ALL = {words: said for part in COMMANDS.values() for words, said in part.items()}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("faults")
    whole = faults.recording(folder / "a.mcap")
    two = dump(resolve({"joints": ["a", "b"]}))
    for name in ("two.yaml", "m_a.json", "a.html", "figures.md", "g.parquet.journal.jsonl"):
        (folder / name).write_text(two)
    (folder / "one.yaml").write_text(dump(resolve({"array_rate": 0.0})))
    write_model(folder / "model.json")
    (folder / "with_model").write_text(dump(resolve({"joint_1.model_file": str(folder / "model.json")})))
    for name in ("empty", "bag"):
        (folder / name).mkdir()
    (folder / "bag" / "bag_0.mcap").write_bytes(whole)
    (folder / "bag" / "metadata.yaml").touch()
    (folder / "link.mcap").symlink_to("a.mcap")
    (folder / "circle").symlink_to("circle")
    os.link(folder / "a.mcap", folder / "hard.mcap")
    return folder


@pytest.mark.parametrize("words", ALL)
def test_bad_usage_and_input_is_one_line_and_changes_nothing(words: str, place: Path, monkeypatch) -> None:
    monkeypatch.chdir(place)
    before = {path: path.is_file() and path.read_bytes() for path in place.rglob("*")}
    assert_one_line_error(hd_diag(*words.split()), ALL[words])
    assert {path: path.is_file() and path.read_bytes() for path in place.rglob("*")} == before


@pytest.mark.parametrize(("fault", "verb"), [(fault, verb) for fault in FILES for verb in VERBS])
def test_what_is_wrong_with_a_recording_is_told(fault, verb, place, tmp_path: Path, monkeypatch) -> None:
    made, told = FILES[fault]
    code, said = told[verb]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hd_diag.report.page.inline_svg", lambda *_, **__: "")  # test_report.py draws them
    shutil.copy(place / "one.yaml", tmp_path)
    Path("FILE.mcap").write_bytes(made((place / "a.mcap").read_bytes()))
    result = hd_diag(*VERBS[verb].replace("FILE", "FILE.mcap").split())
    assert (result.exit_code, said in result.stdout + result.stderr) == (code, True), result.output
    if code:
        assert_one_line_error(result, said)
    elif not said:
        assert "damaged" not in result.stdout + result.stderr


@pytest.mark.parametrize(("given", "reason"), VALUES, ids=[reason for _, reason in VALUES])
def test_a_bad_value_is_refused_by_check(given: dict[str, object], reason: str, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(faults.parameter_file(joints=["elbow"], **given))
    assert_one_line_error(hd_diag("check", path), reason)


def test_the_page_is_this_table_and_the_tests_that_it_names_exist() -> None:
    assert PAGE.read_text(encoding="utf-8") == faults.page(), "python test/faults.py writes it again"
    for *_, proof in EVENTS:
        file, _, name = proof.partition("::")
        tree = ast.parse((Path(__file__).parent / file).read_text(encoding="utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, proof
