"""Reliability of stated probabilities: how often a class is present that has some probability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scoring import Score

EDGES = (0.5, 0.8, 0.95, 0.99, 0.999, 1.0)


def wilson(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a rate (Wilson)."""
    if count == 0:
        return 0.0, 1.0
    share = hits / count
    middle = share + z**2 / (2 * count)
    half = z * math.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    scale = 1 + z**2 / count
    return max((middle - half) / scale, 0.0), min((middle + half) / scale, 1.0)


def _bins(scores: Sequence[Score]) -> list[tuple[str, float, int, int]]:
    """Name, mean stated probability, number of classes and number of present classes of each bin."""
    stated = [one for score in scores for one in score.stated]
    found = []
    for low, high in pairwise(EDGES):
        own = [one for one in stated if low <= one[0] < high or one[0] == high == 1.0]
        mean = float(np.mean([p for p, _ in own])) if own else math.nan
        name = f"{100 * low:.4g} to {100 * high:.4g} %"
        found.append((name, mean, len(own), sum(right for _, right in own)))
    return found


def table(scores: Sequence[Score]) -> str:
    """The bins as a Markdown table; empty if no probability was stated."""
    rows = [
        f"| {name} | {count} | {100 * mean:.2f} % | {100 * hits / count:.1f} % "
        f"({100 * wilson(hits, count)[0]:.0f}–{100 * wilson(hits, count)[1]:.0f}) |"
        for name, mean, count, hits in _bins(scores)
        if count
    ]
    head = ["| stated probability | classes | mean of it | there |", "| --- | --- | --- | --- |"]
    return "\n".join([*head, *rows]) if rows else ""


def draw(scores: Sequence[Score], file: Path) -> None:
    """Plot the share of classes that are present over the stated probability, with 95 % intervals."""
    figure, axes = plt.subplots(figsize=(4.5, 4.5), layout="constrained")
    axes.plot((50, 100), (50, 100), "--", color="0.6", label="as stated")
    for _, mean, count, hits in _bins(scores):
        if count:
            low, high = wilson(hits, count)
            share = hits / count
            away = [[100 * max(share - low, 0.0)], [100 * max(high - share, 0.0)]]
            axes.errorbar(100 * mean, 100 * share, away, fmt="o", color="C0", capsize=3)
            axes.annotate(f" {count}", (100 * mean, 100 * share), va="top")
    axes.set(xlabel="stated probability [%]", ylabel="there [%]", xlim=(48, 102), ylim=(-2, 102))
    axes.legend(loc="lower right")
    figure.savefig(file)
    plt.close(figure)
