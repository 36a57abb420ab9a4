"""``hd-diag fleet``: every joint of many bags, in parallel, as a table, and what changes over time."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.cli.joints import chosen_joints, configured, tell_assumed
from hd_diag.cli.lines import show_table, tell
from hd_diag.cli.options import check_files
from hd_diag.cli.progress import Advance, showing
from hd_diag.cli.targets import Problem, write_json, writing
from hd_diag.config.catalogue import load
from hd_diag.config.configuration import JointConfig
from hd_diag.fleet import FleetError
from hd_diag.fleet.cluster import ClusterPool
from hd_diag.fleet.health_page import health_page
from hd_diag.fleet.journal import JOURNAL_SUFFIX, BagPages, Journal
from hd_diag.fleet.rows import PAGE
from hd_diag.fleet.run import Fleet, Progress, diagnose_fleet, find_bags
from hd_diag.fleet.series import ECCENTRICITY, ERROR, NOMINAL, REFIT, RIPPLE, series_of
from hd_diag.fleet.standing import Health, health, limits_of
from hd_diag.fleet.summary import as_json, attention_lines, headline, notes, sentences, table
from hd_diag.fleet.trend import trends
from hd_diag.model.threads import cores
from hd_diag.process_pool import ProcessPool
from hd_diag.report.facts import Fact
from hd_diag.ros.stop_signals import Stopped, noted_signals, signalled

_NEEDED = ("pyarrow", "ruptures")
_MEMORY_SHARE = 0.9  # of the machine's, for all workers together
_ERRORS_SHOWN = 20


def fleet(bags: tuple[Path, ...], config_file: str | None, names: tuple[str, ...], **given: Any) -> int:
    """Run ``hd-diag fleet``."""
    config = configured(config_file)
    joints = tuple(chosen_joints(config, names))
    try:
        limits = _limits(joints, given["limits"])
        health = _run(_fleet(bags, config, joints, given), joints, limits, given)
        _write(health, given)
    except FleetError as error:
        raise Problem(str(error)) from error
    if given["json_file"] != "-":
        _show(health, given)
    tell_assumed(config_file, config)
    return _code(health, given)


def _fleet(
    bags: tuple[Path, ...], config: Any, joints: tuple[JointConfig, ...], given: dict[str, Any]
) -> Fleet:
    """Bags, joints and robots of the run, checked as far as possible before hours of work."""
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        get = f"{sys.executable} -m pip install 'hd_diag[fleet]'"
        raise FleetError(f"fleet needs {' and '.join(missing)}: {get}")
    if given["scheduler"] and (given["jobs"] or given["memory"]):
        raise FleetError("--jobs and --memory are of this machine: with --scheduler its workers set them")
    for path in bags:
        if not given["scheduler"] and not path.exists():
            raise FleetError(f"{path}: does not exist")
    found = find_bags(bags)
    if not found:
        raise FleetError(f"no bag in {', '.join(map(str, bags))}")
    check_files((*(given[name] for name in ("out", "figure", "json_file", "report")), _journal(given)), found)
    try:
        robot = None if given["robot"] is None else re.compile(given["robot"])
    except re.error as error:
        raise FleetError(f"--robot {given['robot']}: {error}") from error
    return Fleet(found, config, joints, robot)


def _journal(given: dict[str, Any]) -> Path:
    out: Path = given["out"]
    return out.with_name(out.name + JOURNAL_SUFFIX)


def _limits(joints: Sequence[JointConfig], wanted: tuple[str, ...]) -> dict[tuple[str, str], float]:
    """Limits of the command line by joint and quantity."""
    known = (ECCENTRICITY, ERROR, NOMINAL, REFIT, *(effect.name for effect in load()))
    limits: dict[tuple[str, str], float] = {}
    for text in wanted:
        name, _, number = text.partition("=")
        if name not in known and not name.startswith(RIPPLE):
            names = f"{', '.join(known)}, {RIPPLE}ORDER"
            raise FleetError(f"--limit {text}: no quantity {name!r}; there are {names}")
        try:
            value = float(number)
        except ValueError:
            raise FleetError(f"--limit {text}: {number!r} is not a number") from None
        if not 0.0 < value < float("inf"):
            raise FleetError(f"--limit {text}: must be positive and finite")
        limits |= {(joint.name, name): value for joint in joints}
    return limits


def _run(
    chosen: Fleet,
    joints: Sequence[JointConfig],
    given_limits: dict[tuple[str, str], float],
    given: dict[str, Any],
) -> Health:
    path = _journal(given)
    pages = BagPages(given["report"]) if given["report"] else None
    with Journal(path, given["fresh"]) as journal:
        if journal.lost:
            lines = f"{journal.lost} of its lines are cut off or damaged; what they held is judged again"
            tell(f"hd-diag: {path}: {lines}", err=True)
        try:
            with _watched() as (report_step, tick):
                with _pool(given) as pool:
                    rows = diagnose_fleet(
                        chosen, pool, journal, report_step, tick, given["bag_timeout"], pages
                    )
                own = limits_of(rows) | given_limits
                alarms = {(joint.name, NOMINAL): joint.limits["residual_rms"].error for joint in joints}
                found = trends(series_of(rows, alarms | own), np.random.default_rng(0), tick)
                return health(rows, found, own)
        except KeyboardInterrupt as error:
            text = f"{len(journal.results)} results are in {path}; the same command goes on"
            tell(f"hd-diag: interrupted: {text}", err=True)
            sys.exit(signalled(error))


@contextlib.contextmanager
def _watched() -> Iterator[tuple[Progress, Callable[[], None]]]:
    """Functions that show the progress of a run, and that end it after Ctrl-C."""
    with showing() as part, noted_signals() as came:
        stages: dict[str, Advance] = {}

        def tick() -> None:
            if came:
                raise Stopped(came[0])

        def report_step(stage: str, done: int, total: int, tasks: int) -> None:
            stages.setdefault(stage, part(stage))(done, total, f"{tasks} done")

        yield report_step, tick


def _pool(given: dict[str, Any]) -> Any:
    if given["scheduler"]:
        return ClusterPool(given["scheduler"])
    jobs = given["jobs"] or cores()
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    each = given["memory"] * 2**30 if given["memory"] else _MEMORY_SHARE * machine / jobs
    return ProcessPool(jobs, int(each))


def _write(found: Health, given: dict[str, Any]) -> None:
    from hd_diag.fleet.plots import draw
    from hd_diag.fleet.table import write_table

    with writing(given["out"]) as place:
        write_table(place, found.rows)
    write_json(given["json_file"], as_json(str(given["out"]), found))
    if given["figure"]:
        with writing(given["figure"]) as place:
            draw(found.trends, place)
    if given["report"]:
        with writing(given["report"]) as place:
            place.write_text(health_page(found, _made(given)), encoding="utf-8")
        BagPages(given["report"]).keep(one.row.get(PAGE) for one in found.standings)


def _made(given: dict[str, Any]) -> list[Fact]:
    """Facts on the making of a page."""
    when = datetime.now(timezone.utc).isoformat(" ", "minutes").removesuffix("+00:00")
    limits = ", ".join(given["limits"]) or "accuracy and tolerance of the configuration"
    return [Fact("Written", f"{when} UTC"), Fact("Table", str(given["out"])), Fact("Limits", limits)]


def _show(found: Health, given: dict[str, Any]) -> None:
    if found.standings:
        show_table(table(found))
    for line in sentences(found.trends):
        tell(line)
    present, past = found.attention
    lines = [line for n in (*present, *past) for line in attention_lines(found.rows[n], found.colours[n])]
    for line in lines[:_ERRORS_SHOWN]:
        tell(line, err=True)
    if len(lines) > _ERRORS_SHOWN:
        more = f"{len(lines) - _ERRORS_SHOWN} more"
        tell(f"not judged or cut off: {more}; see the columns error and problems", err=True)
    for note in notes(found):
        tell(note, err=True)
    tell(headline(found))
    tell(f"{len(found.rows)} rows of {len({row['bag'] for row in found.rows})} bags in {given['out']}")
    if given["report"]:
        tell(f"report written: {given['report']}")


def _code(found: Health, given: dict[str, Any]) -> int:
    if all(row.get("error") for row in found.rows):
        tell("hd-diag: no bag could be judged", err=True)
        return 2
    caused = any(row.get("causes") or row.get("unexplained_orders") for row in found.rows)
    changed = any(trend.changed for trend in found.trends)
    failed = given["fail_on"] is not None and found.fails(given["fail_on"])
    return int((given["fail_on_cause"] and caused) or (given["fail_on_change"] and changed) or failed)
