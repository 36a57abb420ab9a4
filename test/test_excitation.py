"""Whether a torque excites what it should: reversals that count, and an assumed torque."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from benches import bench

from hd_diag.effects.excitation import loaded, torque_known, torque_reverses
from hd_diag.effects.signals import Signals

COUNT = 800
SWING = 0.1  # as a share of the rated torque of 56 N m


@pytest.fixture(scope="module")
def signals() -> Signals:
    return bench().signals.part(slice(0, COUNT))


def under(signals: Signals, torque: np.ndarray | float, *breaks: int) -> Signals:
    run = np.searchsorted(breaks, np.arange(COUNT), side="right").astype(np.int64)
    return dataclasses.replace(signals, torque=np.broadcast_to(torque, COUNT).astype(np.float64), run=run)


def through(*values: float) -> np.ndarray:
    return np.interp(np.linspace(0.0, len(values) - 1.0, COUNT), np.arange(len(values)), values)


NOISE = np.random.default_rng(0).normal(0.0, 0.6, COUNT)


@pytest.mark.parametrize(
    ("torque", "levels"),
    [
        (through(0.0, 30.0, -30.0, 30.0, -30.0, 30.0), 2),  # the same loop again and again
        (through(0.0, 30.0, -30.0, 10.0, -30.0, 30.0), 3),
        (through(0.0, 30.0, 15.0, 25.0, 20.0, 30.0), 2),  # the inner loop is smaller than the swing
        (through(0.0, 30.0, 10.0, 20.0, 0.0), 3),
        (through(0.0, 30.0), 0),  # never back
        (through(30.0, -30.0, 30.0), 1),
        (20.0, 0),
        (through(0.0, 30.0, -30.0, 30.0) + NOISE, 2),
        (through(0.0, 30.0, -30.0, 10.0, -30.0) + NOISE, 3),
        # Reversals at almost the same torque count as one value.
        (through(0.0, 30.0, -30.0, 31.0, -29.0, 32.0, -30.5, 30.0), 2),
        (through(0.0, 30.0, -30.0, 10.0, -20.0), 3),
    ],
)
def test_values_at_which_the_torque_turns_back(signals: Signals, torque: Any, levels: int) -> None:
    possible, reason = torque_reverses(under(signals, torque), SWING)
    assert possible == (levels >= 3)
    assert possible == (reason == "")
    told = {0: "no value", 1: "one value"}.get(levels, f"{levels} values")
    assert possible or f"at {told}, three are needed, 5.6 N m apart" in reason


def test_memory_ends_with_a_run(signals: Signals) -> None:
    """Three reversals in two runs close no inner loop."""
    torque = through(0.0, 30.0, -30.0, 10.0, -20.0)
    assert "at one value," in torque_reverses(under(signals, torque, COUNT // 2), SWING)[1]


def test_a_torque_that_never_changes_is_assumed(signals: Signals) -> None:
    for torque in (0.0, 12.5):
        possible, reason = torque_known(under(signals, torque))
        assert not possible
        assert reason.startswith("no torque is measured")
    assert torque_known(under(signals, through(12.5, 12.6))) == (True, "")
    assert not torque_known(signals.part(slice(0, 0)))[0]


def test_a_load_within_the_error_of_a_torque_s_zero_is_none(signals: Signals) -> None:
    possible, reason = loaded(under(signals, 2.0))
    assert not possible
    assert "no load is known beyond 2 N m" in reason
    assert "5.6 N m or more" in reason
    assert loaded(under(signals, -6.0)) == (True, "")
