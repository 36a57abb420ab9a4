"""A mesh: geometry, assembly and material, and the place of the wave generator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hd_diag.arrays import Complexes, Floats
from hd_diag.model.geometry import Geometry
from hd_diag.model.kernel.mesh_data import MeshData, numbers


@dataclass(frozen=True)
class Mesh:
    """A geometry with what assembly and material add to it.

    Parameters
    ----------
    geometry : Geometry
    tooth_compliance : float
        K1 + K2 of a tooth pair [m/N].
    eccentricity : complex
        E, displacement of the wave generator's centre fixed in the housing, x + iy [m].
    runout : complex
        Part of the displacement that turns with the wave generator, at theta_W = 0 [m].
    arc_offset : float
        s_0, shift of the teeth along the neutral curve [m].
    tilt : complex
        gamma e^(i chi), tilt of the wave generator's axis by gamma in the direction chi of the housing [rad]:
        in the section z its centre is at E + gamma z e^(i chi).

    Raises
    ------
    ValueError
        If a value is impossible; for eccentricity and runout the message gives the largest possible sum.
    """

    geometry: Geometry
    tooth_compliance: float = 1.0e-6
    eccentricity: complex = 0.0
    runout: complex = 0.0
    arc_offset: float = 0.0
    tilt: complex = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.tooth_compliance < math.inf:
            raise ValueError(
                f"tooth_compliance must be positive and finite, not {self.tooth_compliance:g} m/N"
            )
        if not math.isfinite(self.arc_offset):
            raise ValueError(f"arc_offset must be finite, not {self.arc_offset:g} m")
        _check_displacement(self)

    def displacement(self, wave_generator_angle: Floats) -> Complexes:
        """Wave generator's centre in the middle section at theta_W [rad], x + iy in the housing [m]."""
        turning: Complexes = np.exp(1j * wave_generator_angle)
        return self.eccentricity + self.runout * turning

    @property
    def lean(self) -> float:
        """Displacement of the outermost section by the tilt [m]."""
        return float(abs(self.tilt) * np.abs(self.geometry.section_places).max())

    @property
    def is_centred(self) -> bool:
        """Whether both lobes are alike: nothing displaces the wave generator."""
        return not (self.eccentricity or self.runout or self.tilt)

    @cached_property
    def data(self) -> MeshData:
        """Numbers of the mesh in the form that the kernels take."""
        own = float(self.tooth_compliance), float(self.arc_offset)
        return MeshData(*numbers(self.geometry), *own, complex(self.tilt))


def contiguous(values: float | Floats) -> Floats:
    """Contiguous and writeable array; numba would compile kernels again for any other."""
    found = np.ascontiguousarray(values, dtype=np.float64)
    return found if found.flags.writeable else found.copy()


def moments(
    mesh: Mesh, wave_generator_angle: Floats, torque: float | Floats = 0.0
) -> tuple[Floats, Complexes, Floats]:
    """Wave generator angle [rad], displacement of its centre [m] and torque [N m] of every moment."""
    turn = contiguous(wave_generator_angle)
    return turn, mesh.displacement(turn), contiguous(np.broadcast_to(torque, turn.shape))


def largest_displacement(geometry: Geometry) -> tuple[float, str]:
    """Least displacement of the wave generator at which a part strikes [m], and the name of that part."""
    tip_radius = geometry.circular_spline_tip_radius
    slot_end = geometry.circular_spline_datum + geometry.slot_end
    long = max(curve.semi_major for curve in geometry.section_curves)
    short = max(curve.semi_minor for curve in geometry.section_curves)
    return min(
        (tip_radius - long - geometry.flexspline_root, "root at the long axis"),
        (slot_end - long - geometry.flexspline_tip, "tip at the long axis"),
        (tip_radius - short - geometry.flexspline_tip, "tip at the short axis"),
    )


def _check_displacement(mesh: Mesh) -> None:
    if mesh.tilt and mesh.geometry.sections == 1:
        raise ValueError(
            f"tilt ({abs(mesh.tilt):g} rad) displaces the sections beside the middle one: give face_width "
            "and sections"
        )
    largest, place = largest_displacement(mesh.geometry)
    eccentricity, runout, lean = abs(mesh.eccentricity), abs(mesh.runout), mesh.lean
    if not eccentricity + runout + lean < largest:
        tilt = f" and what the tilt adds at the ends ({lean * 1e6:.6g} µm)" if mesh.tilt else ""
        raise ValueError(
            f"eccentricity ({eccentricity * 1e6:.6g} µm) and runout ({runout * 1e6:.6g} µm){tilt} must add "
            f"up to less than {largest * 1e6:.6g} µm, at which the flexspline's {place} strikes the circular "
            "spline"
        )
