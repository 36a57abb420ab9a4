"""Stored results of a run: the journal that survives a crash, and the table in Parquet."""

from pathlib import Path

import fleet_tasks
import pyarrow.parquet as pq
import pytest

from hd_diag.fleet import FleetError
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
    with pytest.raises(FleetError, match="No such file"):
        Journal(tmp_path / "none" / "j")


def test_every_cut_of_a_journal_is_read_and_written_on(tmp_path: Path) -> None:
    """For a crash at any byte, whole lines count, and the next result is not lost in the rest."""
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


def test_a_result_that_has_changed_is_none(tmp_path: Path) -> None:
    """With any bit flipped, all results read are unchanged. Lines of other origin do not count."""
    path = tmp_path / "j"
    rows = {"a": {"size": 9.26e-6, "joint": "é"}, "b": {"size": 1.5, "joint": None}}
    with Journal(path) as journal:
        for key, row in rows.items():
            journal.add(key, row)
    whole = path.read_bytes()
    for bit in range(8 * len(whole)):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        with Journal(path) as journal:
            assert all(rows[key] == row for key, row in journal.results.items())
            assert journal.lost or journal.results == rows
    for line in (b"[]", b'{"key": "a", "row": {}}', b"\xff\0", b"null", b'{, "crc32": 1}', b"}"):
        path.write_bytes(line + b"\n" + whole)
        with Journal(path) as journal:
            assert (journal.results, journal.lost) == (rows, 1)


def test_the_table_has_every_column_with_unit_and_values_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "f.parquet"
    own = {"bag": "a\n\udcff.mcap", "start": fleet_tasks.BEGIN + 1_002_003, "tested": ["hysteresis"]}
    row = fleet_tasks.row(residual=1e-6 / 3, **own)
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
