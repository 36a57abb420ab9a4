"""Inputs of the effects: a record's motion and load, and the base model's prediction along it."""

from __future__ import annotations

import itertools
from collections.abc import Hashable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.effects.contact_weights import ContactWeights, Rows

MISSING_STEPS = 20.0
"""Gap between rows, in usual time steps, from which rows were left out. A few lost samples are no gap."""


@dataclass(frozen=True, eq=False)
class Signals:
    """A record, or a part of one, with the base model's prediction.

    Parameters
    ----------
    time : ndarray, shape (n,)
        [s], rising within a run.
    wave_generator_angle : ndarray, shape (n,)
        theta_W, continuous over the turns [rad].
    output_angle : ndarray, shape (n,)
        Nominal theta_o = theta_in / ratio [rad].
    speed : ndarray, shape (n,)
        d theta_in / dt of the reported input [rad/s].
    torque : ndarray, shape (n,)
        On the link [N m]: as reported, or as the mesh bears it if causes change it.
    temperature : ndarray, shape (n,), or None
        [degC]; None: not measured.
    run : ndarray of int64, shape (n,)
        Number of the run; state, derivatives and filters restart where it changes.
    predicted : ndarray, shape (n,)
        Transmission error of the base model [rad].
    predicted_torque_slope : ndarray, shape (n,)
        Its derivative by the torque [rad/(N m)].
    predicted_rate : ndarray, shape (n,)
        Its derivative by time [rad/s].
    contact : ContactWeights
        Sensitivity of the transmission error to errors of the teeth.
    tooth_ripple : ndarray, shape (n,), or None
        Part of the ripple that errors of the teeth add [rad]; None: no such errors are known.
    recording : ndarray of int64, shape (n,), or None
        Number of the recording, each with its own encoder zero; None: there is one recording.
    """

    time: Floats
    wave_generator_angle: Floats
    output_angle: Floats
    speed: Floats
    torque: Floats
    temperature: Floats | None
    run: Integers
    predicted: Floats
    predicted_torque_slope: Floats
    predicted_rate: Floats
    contact: ContactWeights
    tooth_ripple: Floats | None = None
    recording: Integers | None = None

    @cached_property
    def kept(self) -> dict[Hashable, Any]:
        """Cache for what effects compute from these samples, by keys of their own."""
        return {}

    @property
    def size(self) -> int:
        """Number of samples n."""
        return int(self.time.size)

    @property
    def ratio(self) -> float:
        """Reported input angle over reported output angle, signed [-]."""
        return self.contact.drive.kinematics.ratio

    @property
    def rated_torque(self) -> float:
        """[N m]."""
        return self.contact.drive.rated_torque

    @property
    def ripple(self) -> Floats:
        """Ripple of the gear: the base model's, and what errors of the teeth add [rad], shape (n,)."""
        own = self.contact.ripple
        return own if self.tooth_ripple is None else own + self.tooth_ripple

    @property
    def input_angle(self) -> Floats:
        """theta_in as reported [rad], shape (n,)."""
        return self.output_angle * self.ratio

    @property
    def forward_speed(self) -> Floats:
        """Speed of the input, positive where the output angle grows [rad/s], shape (n,)."""
        return np.asarray(self.speed * np.sign(self.ratio))

    @property
    def wave_generator_speed(self) -> Floats:
        """D theta_W / dt [rad/s], shape (n,)."""
        return self.speed * self.contact.drive.frame.turning

    @property
    def flexspline_angle(self) -> Floats:
        """theta_F, the wave generator seen from the flexspline [rad], shape (n,)."""
        return self.contact.flexspline_angle

    def seen_from(self, member: float) -> Floats:
        """The wave generator seen from the circular spline (0) or the flexspline (1) [rad], shape (n,)."""
        return self.flexspline_angle if member else self.wave_generator_angle

    def bearing(self, torque: Floats) -> Signals:
        """These signals with another torque (n,) [N m] in the mesh; the prediction is unchanged."""
        contact = ContactWeights(self.contact.table, self.wave_generator_angle, torque)
        return replace(self, torque=torque, contact=contact)

    def part(self, rows: Rows) -> Signals:
        """Selected samples, in their order."""
        columns = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "contact"}
        some: Any = {name: None if values is None else values[rows] for name, values in columns.items()}
        return Signals(**some, contact=self.contact.part(rows))

    def runs(self) -> list[slice]:
        """Slice of the samples of each run."""
        edges = [0, *(np.flatnonzero(np.diff(self.run)) + 1).tolist(), self.size]
        return [slice(start, end) for start, end in itertools.pairwise(edges) if end > start]
