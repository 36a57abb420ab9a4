"""Waves without a name: constant ones, and those that torque scales with its sign, as cogging does."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from benches import Part, bench, swinging
from joint_records import ARCSEC, columns, prepared

from hd_diag.diagnosis.evidence.solution import Solution
from hd_diag.diagnosis.evidence.unexplained import Unexplained, unexplained
from hd_diag.diagnosis.evidence.unmodelled_terms import UNMODELLED_TERMS
from hd_diag.diagnosis.record import Record
from hd_diag.effects.signals import Signals

ORDER = 3.37
SIZE = 3.0 * ARCSEC


def wave(order: float = ORDER, size: float = SIZE, frame: str = "input") -> Part:
    def part(signals: Signals) -> np.ndarray:
        angle = signals.wave_generator_angle if frame == "input" else 2.0 * np.pi * signals.time
        return size * np.cos(order * angle + 1.0)

    return part


def loaded(order: float = ORDER, size: float = 2.0 * SIZE) -> Part:
    def part(signals: Signals) -> np.ndarray:
        return wave(order, size)(signals) * signals.torque / np.abs(signals.torque).max()

    return part


def found(*parts: Part, record: Record | None = None) -> list[Unexplained]:
    return unexplained(Solution(bench(*parts, record=record)))


@pytest.mark.parametrize(("order", "frame"), [(ORDER, "input"), (2.1, "time")])
def test_a_wave_of_even_size(order: float, frame: str) -> None:
    line = found(wave(order, SIZE, frame))[0]
    assert (line.frame, line.description) == (frame, "")
    assert line.order == pytest.approx(order, abs=0.02)
    assert line.amplitude == pytest.approx(SIZE, rel=0.15)
    assert line.torque_law == "independent of torque"
    assert line.direction_law == "the same in both directions"


def test_a_wave_in_proportion_to_the_torque_is_found() -> None:
    line = found(loaded())[0]
    assert line.frame == "input"
    assert line.order == pytest.approx(ORDER, abs=0.02)
    torque = swinging().torque
    expected = 2.0 * SIZE * np.sqrt(np.mean((torque / np.abs(torque).max()) ** 2))
    assert line.amplitude == pytest.approx(expected, rel=0.15)
    small, large = np.array(line.torque_law.removeprefix("grows with torque: ").split()[:3:2], dtype=float)
    assert 0.0 < 2.0 * small < large < 2.0 * SIZE / ARCSEC
    assert line.direction_law == "the same in both directions"


def test_a_torque_of_one_sign_is_looked_at_evenly() -> None:
    line = found(loaded(), record=prepared(columns()))[0]
    assert line.order == pytest.approx(ORDER, abs=0.02)
    assert line.torque_law.startswith("grows with torque")


def test_two_even_waves_the_stronger_first() -> None:
    waves = found(wave(ORDER, SIZE), wave(5.9, 2.0 * SIZE))
    assert [line.order for line in waves] == pytest.approx([5.9, ORDER], abs=0.02)
    assert [line.where for line in waves] == ["", ""]
    # Noise, and a wave too small to matter.
    assert found() == found(wave(ORDER, 0.2 * ARCSEC)) == []


def test_an_unmodelled_term_is_described_by_its_words() -> None:
    term = next(one for one in UNMODELLED_TERMS if one.name == "creep")

    def part(signals: Signals) -> np.ndarray:
        return 20.0 * ARCSEC * term.columns(signals, ())[:, 0]

    made = bench(part)
    line = unexplained(Solution(made, given=((term, ()),)))[0]
    assert (line.order, line.frame, line.description) == (0.0, "input", term.cause)
    expected = np.sqrt(2.0) * np.std(part(made.signals))
    assert line.amplitude == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("where", "rows"),
    [
        ("under positive torque", lambda s: s.torque > 0.0),
        ("under negative torque", lambda s: s.torque < 0.0),
        ("forward", lambda s: s.forward_speed > 0.0),
        ("backward", lambda s: s.forward_speed < 0.0),
        ("forward at ", lambda s: 2.0 * (s.forward_speed > np.quantile(np.abs(s.forward_speed), 0.7))),
    ],
)
def test_a_wave_in_a_part_of_the_record_is_found_there(where: str, rows: Callable[[Signals], Any]) -> None:
    line = found(lambda signals: wave()(signals) * rows(signals))[0]
    assert line.order == pytest.approx(ORDER, abs=0.02)
    if where.endswith(" "):
        assert line.where.startswith(where)
        assert line.where.endswith("turns/s of the input")
    else:
        assert line.where == where
        assert line.amplitude == pytest.approx(SIZE / np.sqrt(2.0), rel=0.2)
