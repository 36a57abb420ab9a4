"""The benchmark of `hd-diag diagnose`: hidden causes to be found, beside plain methods on the same records.

    python bench/challenge.py [--seeds N] [--families F ...] [--development | --final] [--first SEED]
        [--jobs N] [--time S] [--no-baselines] [--again FILE] [--json FILE] [--markdown FILE]
        [--diagram FILE]

Records come from test/challenge, which shares no code with the package. Development seeds may be looked at
while the method is made; final seeds are for the last count only. `--time` begins no record after so many
seconds. Times are CPU seconds of one core.
"""

# ruff: noqa: D103, T201, E402

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import multiprocessing
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "test"), str(ROOT / "bench")]  # `challenge` is the package in test/
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import baselines
import numpy as np
import scoring
from aims import OWN, PARAMETERS, targets
from challenge.families import DEVELOPMENT, FAMILIES, FINAL, made
from reliability import draw, table, wilson
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from scoring import Score

from hd_diag.model.torsion import warm_up

Column = tuple[str, Callable[[list[Score]], str]]


def judged(family: str, seed: int, with_baselines: bool) -> tuple[list[Score], str]:
    """Scores of a record, and the traceback if it failed."""
    found: list[Score] = []
    try:
        record = made(family, seed)
        found.append(scoring.score(record, family, seed))
        if with_baselines:
            found += baselines.scores(record, family, seed)
    except Exception:
        return found, f"{family} {seed}: {traceback.format_exc()}"
    return found, ""


# Figures ---


def rate(hits: Iterable[bool]) -> str:
    given = list(hits)
    if not given:
        return "–"
    low, high = wilson(sum(given), len(given))
    return f"{100 * np.mean(given):.1f} % ({100 * low:.0f}–{100 * high:.0f})"


def median(values: Iterable[float | None], form: str, scale: float = 1.0) -> str:
    given = [scale * v for v in values if v is not None and np.isfinite(v)]
    return form.format(np.median(given)) if given else "–"


def coverage(scores: list[Score]) -> str:
    """Share of parameters inside their intervals. Parameters are dependent: its interval counts records."""
    given = [s.covered for s in scores if s.covered is not None]
    if not given:
        return "–"
    share = sum(given) / (PARAMETERS * len(given))
    low, high = wilson(round(share * len(given)), len(given))
    return f"{100 * share:.1f} % ({100 * low:.0f}–{100 * high:.0f})"


NAMES: tuple[Column, ...] = (
    ("right up to class", lambda s: rate(x.right for x in s)),
    ("exact", lambda s: rate(x.exact for x in s)),
    ("records with a false name", lambda s: rate(x.false_names > 0 for x in s)),
    ("a cause denied", lambda s: rate(bool(x.denied) for x in s if x.hidden and x.method == OWN)),
    ("amplitude error", lambda s: median((e for x in s for e in x.amplitude_errors), "{:.1f} %", 100.0)),
    ("time [s]", lambda s: median((x.seconds for x in s), "{:.1f}")),
)
FITS: tuple[Column, ...] = (
    ("residual / noise, fit", lambda s: median((x.over_floor for x in s), "{:.4f}")),
    ("residual / noise and the torque's, fit", lambda s: median((x.over_noise for x in s), "{:.4f}")),
    ("residual / noise, as it runs", lambda s: median((x.running_over_floor for x in s), "{:.4f}")),
    ("parameters in their 95 % interval", coverage),
    ("claims an eccentricity", lambda s: rate(x.claimed for x in s)),
    ("misfit passed over", lambda s: rate(x.passed_over for x in s if x.over_noise is not None)),
    ("unknown flagged", lambda s: rate(x.flagged for x in s if x.unknown)),
    ("its order", lambda s: rate(x.order_right for x in s if x.order_right is not None)),
)


def rows(scores: list[Score], columns: Sequence[Column], methods: Sequence[str]) -> Iterator[list[str]]:
    for family in FAMILIES:
        for method in methods:
            own = [s for s in scores if (s.family, s.method) == (family, method)]
            if own:
                figures = [figure(own) for _, figure in columns]
                yield [family.replace("_", " "), method, str(len(own)), *figures]


def markdown(scores: list[Score], columns: Sequence[Column], methods: Sequence[str]) -> str:
    head = ["family", "method", "records", *(name for name, _ in columns)]
    lines = [head, ["---"] * len(head), *rows(scores, columns, methods)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def report(scores: list[Score], summary: str) -> str:
    """The tables, ready for a page."""
    methods = list(dict.fromkeys(s.method for s in scores))
    return "\n\n".join(
        (
            f"{summary} In brackets: 95 % intervals (Wilson).",
            targets(scores),
            markdown(scores, NAMES, methods),
            markdown(scores, FITS, [OWN]),
            table([s for s in scores if s.method == OWN]),
        )
    )


def missed(scores: list[Score]) -> Iterator[str]:
    for s in scores:
        if s.method == OWN and not s.right:
            hidden = ", ".join(s.hidden) or s.unknown or "nothing"
            yield f"{s.family} {s.seed}: {hidden} -> {' + '.join('|'.join(f) for f in s.found) or 'nothing'}"
        if s.method == OWN and s.passed_over:
            yield f"{s.family} {s.seed}: {s.over_noise:.2f} times the noise is left: {s.verdict}"
        if s.method == OWN and s.claimed and s.family == "faultless":
            yield f"{s.family} {s.seed}: there is no eccentricity: {s.verdict}"


# Run ---


def tell(scores: list[Score], failure: str, console: Console) -> None:
    """Print the misses or the failure of a record."""
    lines = [f"missed: {line}" for line in missed(scores)] + [f"FAILED: {failure}"] * bool(failure)
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def run(
    work: Sequence[tuple[str, int]], jobs: int, with_baselines: bool, limit: float, console: Console
) -> tuple[list[Score], list[str]]:
    """Scores of all records, in the order of `work`."""
    begin, results, waiting = time.monotonic(), {}, list(reversed(work))
    progress = Progress(
        TextColumn("{task.description}"), MofNCompleteColumn(), TimeRemainingColumn(), console=console
    )
    context = multiprocessing.get_context("spawn")
    with progress, ProcessPoolExecutor(jobs, context, warm_up) as pool:
        bar = progress.add_task("records", total=len(work))
        pending = {}
        while pending or waiting:
            if time.monotonic() - begin > limit:
                waiting.clear()
            while waiting and len(pending) < jobs:
                item = waiting.pop()
                pending[pool.submit(judged, *item, with_baselines)] = item
            if not pending:
                break
            for done in wait(pending, return_when=FIRST_COMPLETED).done:
                results[pending.pop(done)] = done.result()
                tell(*done.result(), console)
                progress.advance(bar)
    ordered = [results[item] for item in work if item in results]
    return [s for scores, _ in ordered for s in scores], [text for _, text in ordered if text]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="records of each family")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES), metavar="F")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--development", action="store_true", help="development seeds (default)")
    which.add_argument("--final", action="store_true", help="final seeds")
    parser.add_argument(
        "--first", type=int, default=0, metavar="SEED", help="first of them, counted from zero"
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N")
    parser.add_argument("--time", type=float, default=math.inf, metavar="S")
    parser.add_argument("--no-baselines", action="store_true")
    parser.add_argument("--again", type=Path, metavar="FILE", help="tables of an earlier run's --json")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE")
    parser.add_argument("--diagram", type=Path, metavar="FILE", help="stated probabilities, drawn")
    return parser.parse_args()


def again(given: argparse.Namespace) -> int:
    """Print the tables of an earlier run."""
    read = json.loads(given.again.read_text())
    names = {field.name for field in dataclasses.fields(Score)}
    scores = [Score(**{k: v for k, v in one.items() if k in names}) for one in read["records"]]
    text = report(scores, read.get("told", f"{len(scores)} scores."))
    print(text)
    if given.markdown:
        given.markdown.write_text(text + "\n")
    if given.diagram:
        draw(scores, given.diagram)
    return 0


def main() -> int:
    given, console = arguments(), Console(stderr=True)
    if given.again:
        return again(given)
    seeds = (FINAL if given.final else DEVELOPMENT)[given.first : given.first + given.seeds]
    # Seeds come first, so that a run that ends early covers every family.
    work = [(family, seed) for seed in seeds for family in given.families]
    with_baselines = not given.no_baselines
    missing = set(baselines.METHODS) - set(baselines.available())
    if with_baselines and missing:
        console.print(f"not installed, left out: {', '.join(sorted(missing))} (make challenge installs them)")
    scores, failures = run(work, given.jobs, with_baselines, given.time, console)
    done = len({(s.family, s.seed) for s in scores})
    kind = "final" if given.final else "development"
    summary = f"{done} of {len(work)} records, {kind} seeds from {seeds[0]} on."
    text = report(scores, summary)
    print(text)
    if given.markdown:
        given.markdown.write_text(text + "\n")
    if given.json:
        found = {
            "schema": "hd_diag/challenge/1",
            "told": summary,
            "records": [scoring.plain(each) for each in scores],
        }
        given.json.write_text(json.dumps(found, indent=1) + "\n")
    if given.diagram:
        draw(scores, given.diagram)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
