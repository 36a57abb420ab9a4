"""Messages on a node's console for faults that begin, continue, return, get worse and end."""

from types import SimpleNamespace

import pytest

from hd_diag.monitor.publications import Status
from hd_diag.ros import faults
from hd_diag.ros.faults import Console


def test_the_console_is_told_what_changes_and_not_what_flickers(monkeypatch: pytest.MonkeyPatch) -> None:
    now, said = [0.0], list[tuple[str, str]]()
    monkeypatch.setattr(faults, "time", SimpleNamespace(monotonic=lambda: now[0]))
    told = {name: lambda text, name=name: said.append((name, text)) for name in ("info", "warning", "error")}
    console = Console(SimpleNamespace(**told))

    def report(level: int, code: str, seconds: float = 1.0) -> list[tuple[str, str]]:
        """Messages for a report; afterwards the clock advances by ``seconds``."""
        console.follow([Status("a", level, f"{code} at {level}", {"fault_code": code})])
        now[0] += seconds
        found = said[:]
        said.clear()
        return found

    assert report(0, "OK") == []
    assert report(1, "STALE", 100.0) == [("warning", "a: STALE: STALE at 1")]
    assert report(1, "STALE") == []  # independent of its duration and of the report rate
    assert report(2, "STALE") == [("error", "a: STALE: STALE at 2")]
    for _ in range(100):
        assert [*report(0, "OK", 2.0), *report(1, "STALE", 0.1), *report(2, "STALE", 0.1)] == []
    assert report(1, "RESIDUAL") == [("warning", "a: RESIDUAL: RESIDUAL at 1")]
    assert report(1, "LOG_FAILED", 4.0) == []  # not a fault of the joint
    assert report(0, "OK", 2.0) == []
    assert report(0, "OK") == [("info", "a: OK, no fault for 5 s")]
    assert report(0, "OK") == []
    assert report(1, "STALE") == [("warning", "a: STALE: STALE at 1")]
