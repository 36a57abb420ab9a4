"""Backlash of every tooth pair on both flanks, in closed form: see :mod:`hd_diag.model.kernel.contact`."""

from __future__ import annotations

from dataclasses import dataclass

from hd_diag.arrays import Floats, Integers
from hd_diag.model import kernel
from hd_diag.model.mesh import Mesh, contiguous


@dataclass(frozen=True)
class Contact:
    """Where and when the flanks of tooth pairs meet. Arrays of shape (moments, 2, teeth), flanks (+, -).

    Attributes
    ----------
    teeth : ndarray of int, shape (moments, teeth)
        Which tooth of the flexspline each column is.
    slots : ndarray of int, shape (moments, teeth)
        The slot that it meets.
    rotation : ndarray
        b, rotation of the cup that closes the gap, in the flank's own direction [rad]; nan: cannot touch.
    radius : ndarray
        r, distance of the contact from the axis [m].
    pressure_angle : ndarray
        alpha [rad].
    position : ndarray
        Polar angle of the contact in the housing [rad].
    """

    teeth: Integers
    slots: Integers
    rotation: Floats
    radius: Floats
    pressure_angle: Floats
    position: Floats


def contacts(mesh: Mesh, wave_generator_angle: Floats) -> Contact:
    """Contacts of the tooth pairs near both lobes, at any number of moments.

    Parameters
    ----------
    mesh : Mesh
    wave_generator_angle : ndarray, shape (moments,)
        theta_W [rad].

    Returns
    -------
    Contact
        Columns are the teeth that can reach the slots at any angle; all others cannot touch.
    """
    turn = contiguous(wave_generator_angle)
    farthest = abs(mesh.eccentricity) + abs(mesh.runout)
    indices, values = kernel.entry.contacts(mesh.data, turn, mesh.displacement(turn), farthest)
    return Contact(*indices, *values)
