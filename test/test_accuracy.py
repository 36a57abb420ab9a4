"""Peak-to-peak error as a catalogue states it, for records whose error is a closed form."""

from typing import Any

import numpy as np
import pytest
from joint_records import ARCSEC, RATIO, prepared

from hd_diag.diagnosis.accuracy import Accuracy, accuracy
from hd_diag.diagnosis.record import Record
from hd_diag.model.transmission_error import Kinematics

RATED = 56.0  # [N m]
NOISE = 3.0  # [arcsec]


def record(error: Any, seed: int = 0, turns: float = 1.2, noise: float = NOISE, rows: int = 6000) -> Record:
    """Four back-and-forth moves over some turns of the output under torque, with an error [arcsec].

    `error` is a function of the input angle [rad] and the torque over the rated one. Torsion of 300 arcsec
    and friction of 20 arcsec are added.
    """
    time = np.arange(rows) / 100.0
    angle = np.pi * turns * RATIO * (1.0 - np.cos(8.0 * np.pi * time / time[-1]))
    load = 0.5 * np.sin(2.0 * np.pi * time / 7.3) + 0.1 * np.sin(angle / RATIO)
    rng = np.random.default_rng(seed)
    friction = 20.0 * np.tanh(np.gradient(angle, time) / 2.0)
    whole = error(angle, load) + 300.0 * load - friction + noise * rng.standard_normal(rows)
    output = angle / RATIO - ARCSEC * whole
    return prepared({"time": time, "input": angle, "output": output, "torque": RATED * load})


def found(given: Record, orders: tuple[float, ...] = (), noise: float = NOISE) -> Accuracy:
    square = (noise * ARCSEC) ** 2
    one = accuracy(given, Kinematics(RATIO), RATED, orders, (square, 0.05 * square))
    return Accuracy(one.value / ARCSEC, one.std / ARCSEC, one.turns)


def lobes(angle: np.ndarray, load: np.ndarray) -> np.ndarray:
    return 30.0 * np.cos(2.0 * angle + 1.0)


def torsion(load: np.ndarray) -> np.ndarray:
    """A knee, and a loop between -1 and 1 that builds up over a tenth of the rated torque."""
    state, loop = 0.0, []
    for change in np.diff(load, prepend=load[0]):
        state += 10.0 * (change - abs(change) * state)
        loop.append(state)
    return np.clip(load / 0.2, -1.0, 1.0) + np.array(loop)


SHAPES: dict[str, tuple[Any, float]] = {
    "one wave": (lobes, 60.0),
    # Maximum 30 + 20, minimum -50: over a turn, waves of other speeds meet in all phases.
    "with a wave of the output": (lambda x, load: lobes(x, load) + 20.0 * np.cos(x / RATIO + 2.0), 100.0),
    # cos 2x + cos 4x ranges from -9/8 (cos 2x = -1/4) to 2 (x = 0). A wave of its rms would have range 2.83.
    "peaked": (lambda x, load: 20.0 * (np.cos(2.0 * x) + np.cos(4.0 * x)), 62.5),
    # The ripple varies with the torsion and vanishes without torque.
    "under load": (lambda x, load: lobes(x, load) * (1.0 + load), 60.0),
    # The error of an eccentric gear changes sign with the torque.
    "by the flank": (lambda x, load: lobes(x, load) * np.tanh(load / 0.05), 60.0),
    # Torsion of any shape is not an error of the gear.
    "beside torsion": (lambda x, load: lobes(x, load) + 50.0 * torsion(load), 60.0),
    "none": (lambda x, load: 0.0 * x, 0.0),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_the_error_from_peak_to_peak(shape: str) -> None:
    error, true = SHAPES[shape]
    each = [found(record(error, seed)) for seed in range(4)]
    mean, std = np.mean([one.value for one in each]), np.median([one.std for one in each])
    assert mean == pytest.approx(true, abs=max(0.05 * true, 2.0))
    assert std < 4.0
    assert {one.turns for one in each} == {1.0}


def test_a_wave_that_was_found_counts_by_its_own_peaks() -> None:
    def both(angle: np.ndarray, load: np.ndarray) -> np.ndarray:
        return lobes(angle, load) + 20.0 * np.cos(3.372 * angle)

    assert found(record(both), (3.372,)).value == pytest.approx(100.0, abs=3.0)
    assert found(record(both)).value == pytest.approx(np.hypot(60.0, 40.0), abs=3.0)


def test_a_wave_that_was_found_twice_counts_once() -> None:
    """Two estimates of one order that differ by less than the record resolves must not remove the wave."""
    made = record(lambda x, load: lobes(x, load) + 6.0 * np.cos(0.225 * x))
    assert found(made, (0.225,)).value == pytest.approx(72.0, abs=1.0)
    assert found(made, (0.2249, 0.2251)).value == pytest.approx(72.0, abs=1.0)


def test_a_drift_is_no_error_of_the_gear() -> None:
    """A drift makes waves of the output's turn uncertain, and the standard deviation shows this."""

    def drifting(angle: np.ndarray, load: np.ndarray) -> np.ndarray:
        return lobes(angle, load) + 50.0 * np.sin(np.linspace(0.0, 9.0, load.size))

    one = found(record(drifting))
    assert abs(one.value - 60.0) < 2.0 * one.std < 30.0


@pytest.mark.parametrize("phase", np.arange(0.0, 3.0, 0.5))
def test_a_wave_that_torsion_by_gravity_explains_counts_at_no_phase(phase: float) -> None:
    """The torque depends on position only, so torsion and one wave of the output's turn are the same."""
    time = np.arange(6000) / 100.0
    angle = np.pi * 1.2 * RATIO * (1.0 - np.cos(8.0 * np.pi * time / time[-1]))
    load, noise = 0.4 * np.sin(angle / RATIO + phase), np.random.default_rng(0).standard_normal((2, 6000))
    output = angle / RATIO - ARCSEC * (lobes(angle, load) + 300.0 * load + NOISE * noise[0])
    torque = RATED * (load + 0.005 * noise[1])
    one = found(prepared({"time": time, "input": angle, "output": output, "torque": torque}))
    assert one.value == pytest.approx(60.0, abs=3.0)
    assert one.std < 4.0


def test_what_the_record_does_not_cover_is_told() -> None:
    """A third of a turn shows its own part of the shape; a slow wave looks like torsion and offsets there."""
    part = found(record(lobes, turns=0.3))
    assert part.turns == pytest.approx(0.3, abs=0.03)
    assert part.value == pytest.approx(60.0, abs=3.0)


def test_a_whole_turn_may_be_gone_through_in_a_few_rows() -> None:
    """The turn is covered by all rows together, but hardly by the subset from which the shape is drawn."""
    rows, quick = 20_000, 150
    turns = np.concatenate((np.linspace(0.0, 0.2, rows - quick), np.linspace(0.2, 1.0, quick)))
    angle = 2.0 * np.pi * RATIO * turns
    time, load = np.arange(rows) / 100.0, 0.5 * np.sin(np.arange(rows) / 700.0)
    noise = NOISE * np.random.default_rng(1).standard_normal(rows)
    output = angle / RATIO - ARCSEC * (lobes(angle, load) + 300.0 * load + noise)
    one = found(prepared({"time": time, "input": angle, "output": output, "torque": RATED * load}))
    assert one.turns == 1.0
    assert abs(one.value - 60.0) < 10.0


def test_beside_much_noise_it_is_off_by_its_deviation() -> None:
    each = [found(record(lobes, seed, noise=30.0, rows=1000), noise=30.0) for seed in range(20)]
    off = np.array([one.value - 60.0 for one in each])
    std = np.median([one.std for one in each])
    assert 0.4 * std < np.sqrt(np.mean(off**2)) < 1.2 * std < 12.0
    assert abs(off.mean()) < 3.0
