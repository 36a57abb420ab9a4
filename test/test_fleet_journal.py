"""What a run keeps: the journal that survives a crash, and the table in Parquet."""

import os
from pathlib import Path

import fleet_tasks
import pyarrow.parquet as pq
import pytest

from hd_diag.fleet import FleetError, table
from hd_diag.fleet.journal import Journal
from hd_diag.fleet.table import COLUMNS, write_table


def kept(path: Path) -> dict[str, dict[str, object]]:
    with Journal(path) as journal:
        return dict(journal.results)


def test_results_are_there_at_once_and_later(tmp_path: Path) -> None:
    path = tmp_path / "j"
    with Journal(path) as journal:
        journal.add("a", {"joint": "é\n", "size": 0.1})
        assert path.read_bytes().count(b"\n") == 1
        journal.add("b", {"joint": None})
    assert kept(path) == {"a": {"joint": "é\n", "size": 0.1}, "b": {"joint": None}}
    with Journal(path, fresh=True) as journal:
        assert journal.results == {}
        journal.add("b", {})
        with pytest.raises(FleetError, match="another run is writing it"):
            Journal(path, fresh=True)
    assert kept(path) == {"b": {}}


def test_every_cut_of_a_journal_is_read_and_written_on(tmp_path: Path) -> None:
    """Wherever a crash cuts it, whole lines count and the next result is not lost in the rest."""
    path = tmp_path / "j"
    with Journal(path) as journal:
        journal.add("a", {"n": 1})
        journal.add("b", {"n": 2})
    whole = path.read_bytes()
    first = whole.index(b"\n")
    for size in range(len(whole) + 1):
        path.write_bytes(whole[:size])
        ends = {"a": first, "b": len(whole) - 1}
        with Journal(path) as journal:
            assert set(journal.results) == {key for key, end in ends.items() if size >= end}
            journal.add("c", {"n": 3})
        assert kept(path)["c"] == {"n": 3}


@pytest.mark.parametrize(
    "line", [b"[]", b'{"key": 1, "row": {}}', b'{"key": "a", "row": []}', b"\xff\0", b"null"]
)
def test_lines_of_others_are_left_out(line: bytes, tmp_path: Path) -> None:
    (tmp_path / "j").write_bytes(line + b'\n{"key": "b", "row": {}}\n')
    assert kept(tmp_path / "j") == {"b": {}}


def test_a_journal_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(FleetError, match="No such file"):
        Journal(tmp_path / "none" / "j")
    if os.path.exists("/dev/full"):
        journal = Journal(tmp_path / "j")
        with open("/dev/full", "wb", buffering=0) as full:
            journal._file, own = full, journal._file
            with pytest.raises(FleetError, match="No space left"):
                journal.add("a", {})
            own.close()


# The table ---


def test_the_table_has_every_column_with_unit_and_values_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "f.parquet"
    row = {**fleet_tasks.row(1e-6 / 3), "bag": "a\n\udcff.mcap", "start": fleet_tasks.BEGIN + 1_002_003}
    write_table(path, [row, {"bag": "b", "error": "why"}])
    stored = pq.read_table(path)
    assert stored.schema.names == COLUMNS.names
    assert [f.metadata[b"unit"] for f in stored.schema] == [f.metadata[b"unit"] for f in COLUMNS]
    endings = {"m": "_m", "rad": "_rad", "s": "_s", "m/N": "_m_per_N", "rad/(N m)": "_rad_per_Nm"}
    for column in COLUMNS:
        assert column.name.endswith(endings.get(column.metadata[b"unit"].decode(), "")), column
    assert stored.schema.metadata[b"schema"] == b"hd_diag/fleet/1"
    first, second = stored.to_pylist()
    assert first["bag"] == "a\n\\udcff.mcap"
    assert first["rms_refit_rad"] == 1e-6 / 3
    assert first["start"].isoformat() == "2026-01-01T00:00:00.001002+00:00"
    assert first["tested"] == ["hysteresis"]
    assert {name for name, value in second.items() if value is not None} == {"bag", "error"}


def test_a_table_that_cannot_be_finished_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "f.parquet"
    write_table(path, [{"bag": "old"}])

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(table.os, "fsync", full)
    with pytest.raises(FleetError, match="cannot be written: No space left"):
        write_table(path, [{"bag": "new"}])
    assert [row["bag"] for row in pq.read_table(path).to_pylist()] == ["old"]
    assert list(tmp_path.iterdir()) == [path]


def test_the_table_has_the_rights_of_any_new_file(tmp_path: Path) -> None:
    write_table(tmp_path / "f.parquet", [])
    (tmp_path / "other").touch()
    assert (tmp_path / "f.parquet").stat().st_mode == (tmp_path / "other").stat().st_mode
