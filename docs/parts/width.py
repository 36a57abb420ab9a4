"""Pictures along the width of the teeth: coning, tilt, and why a real cup has no backlash (physics.md)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hd_diag.config.defaults import EXAMPLE
from hd_diag.formatting import ARCSEC
from hd_diag.model.load_sharing import mesh_state
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion import torsion
from hd_diag.report.pictures.canvas import DASHES, INK, SERIES, drawn, save, sheet, titled

WIDTH = 11e-3  # of the teeth, as in the paper [m]
LENGTHS = {"ring": 0.0, "cup, 40 mm": 40e-3, "cup, 25 mm": 25e-3}  # from the bottom to the middle [m]
SECTIONS = 9
TILT = 1e-3  # [rad]
ECCENTRICITY = 10e-6  # [m]
TORQUE = 4.0  # [N m]
STYLES = tuple(zip(SERIES, DASHES, strict=True))


def draw(folder: Path) -> None:
    """Write the pictures."""
    for name, picture in {"coning": coning, "tilt": tilt, "no_backlash": no_backlash}.items():
        save(picture(), folder / f"{name}.svg")


def cup(length: float, eccentricity: complex = 0.0, lean: complex = 0.0) -> Mesh:
    """The example drive with a width, and its wave generator displaced and tilted."""
    wide = {"face_width": WIDTH, "cup_length": length, "sections": SECTIONS}
    geometry = replace(EXAMPLE.mesh.geometry, **wide)
    return replace(EXAMPLE.mesh, geometry=geometry, eccentricity=eccentricity, tilt=lean)


def least_backlash(mesh: Mesh) -> np.ndarray:
    """Least backlash of the + flanks in every section, with the long axis at tooth 0 [m]."""
    return np.nanmin(mesh_state(mesh, np.zeros(1), np.zeros(1)).section_backlash[0, :, 0], axis=1)


@drawn
def coning() -> Figure:
    """Radial deformation at the long axis, and the least backlash, along the width."""
    figure, (top, bottom) = sheet(4.6, 2, sharex=True)
    for (name, length), (colour, dashes) in zip(LENGTHS.items(), STYLES, strict=False):
        geometry = cup(length).geometry
        place, line = geometry.section_places * 1e3, {"color": colour, "ls": dashes, "label": name}
        lobe = [curve.semi_major - curve.radius for curve in geometry.section_curves]
        top.plot(place, np.array(lobe) * 1e6, **line)
        bottom.plot(place, least_backlash(cup(length)) * 1e6, **line)
    titled(top, "Radial deformation at the long axis [µm]")
    bottom.axhline(0.0, color=INK, lw=0.7)
    bottom.set_title("Least backlash of a section [µm]")
    bottom.set_xlabel("Place along the width [mm]; right: the open end")
    return figure


@drawn
def tilt() -> Figure:
    """Least backlash along the width of a ring and a cup, with the wave generator tilted either way."""
    figure, panels = sheet(5.2, 2, sharex=True, sharey=True)
    cases = {"straight": 0.0, "leaning towards it": TILT, "leaning against it": -TILT}
    for axes, (name, length) in zip(panels, list(LENGTHS.items())[:2], strict=True):
        for (case, lean), (colour, dashes) in zip(cases.items(), STYLES, strict=False):
            mesh = cup(length, 1j * ECCENTRICITY, 1j * lean)
            place, least = mesh.geometry.section_places * 1e3, least_backlash(mesh) * 1e6
            axes.plot(place, least, color=colour, ls=dashes, label=case)
        titled(axes, f"Least backlash of a {name}, 10 µm off centre [µm]")
    panels[-1].set_xlabel("Place along the width [mm]; right: the open end")
    return figure


@drawn
def no_backlash() -> Figure:
    """Torsion over a small torque: a ring has a gap at zero torque, a cup has none."""
    figure, (axes,) = sheet(3.4)
    torque = np.concatenate([np.linspace(-TORQUE, -1e-6, 60), np.linspace(1e-6, TORQUE, 60)])
    for (name, length), (colour, dashes) in zip(LENGTHS.items(), STYLES, strict=False):
        beta = torsion(cup(length), np.zeros(torque.size), torque) / ARCSEC
        axes.plot(torque, beta, color=colour, ls=dashes, label=name)
    titled(axes, "Torsion [arcsec]")
    axes.set_xlabel("Torque [N m]; without eccentricity and tilt")
    return figure
