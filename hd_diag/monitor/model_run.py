"""Runs an extended model along a joint's stream of samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.extended_model import ExtendedModel, State
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.streams.alignment import Aligned


class ModelRun:
    """A model and its state, which starts again with every stretch of samples."""

    def __init__(self, model: ExtendedModel) -> None:
        self._model = model
        self._state = model.start()
        self._first = 0
        self._stretch: int | None = None

    def __call__(
        self, samples: Aligned, temperature: float, table: TorsionMap | None
    ) -> tuple[Floats, Floats]:
        """Transmission error [rad] and speed of the input [rad/s] of the next samples, shape (m,) each.

        Row by row, because array arithmetic may round differently with the other lengths of a replay.
        """
        error, speed = np.empty(samples.stamp.size), np.empty(samples.stamp.size)
        heat = np.array([temperature])
        for row, stretch in enumerate(samples.stretch.tolist()):
            if stretch != self._stretch:
                self._stretch, self._first = stretch, int(samples.stamp[row])
                self._state = self._model.start()
            at = slice(row, row + 1)
            time = (samples.stamp[at] - self._first).astype(np.float64) * 1e-9
            given = samples.input_angle[at], samples.speed[at], samples.torque[at]
            error[at], self._state = self._model.step(self._state, time, *given, heat, table)
            speed[row] = self._state.speed
        return error, speed

    @property
    def carried(self) -> Any:
        """State for another log to continue from, as JSON."""
        return [self._stretch, self._first, _plain(self._state)]

    def carry_on(self, carried: Any) -> None:
        """Continue from `carried`; raises an Exception of any kind if it does not fit this model."""
        stretch, first, plain = carried
        state = State(*_state(plain))
        nothing = np.zeros(1)
        self._model.step(state, nothing + state.time, nothing, nothing, nothing, nothing)
        self._stretch, self._first, self._state = stretch, int(first), state


def _plain(value: Any) -> Any:
    """Numbers, arrays and tuples of them in the form of JSON."""
    if isinstance(value, np.ndarray):
        return {"array": [_plain(item) for item in value.tolist()]}
    if isinstance(value, complex):
        return {"complex": [value.real, value.imag]}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _state(value: Any) -> Any:
    """The reverse of `_plain`."""
    if isinstance(value, dict) and "array" in value:
        return np.array([_state(item) for item in value["array"]])
    if isinstance(value, dict):
        return complex(*value["complex"])
    return tuple(map(_state, value)) if isinstance(value, list) else value
