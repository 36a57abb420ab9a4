"""Results for a drive, and the signs and frames between the robot's reports and the mesh."""

import dataclasses
import math

import drives
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from reference import published

from hd_diag.drive import Drive, MeshState, mesh_state, transmission_error
from hd_diag.model.torsion import torsion
from hd_diag.model.torsion_map import ARCSEC, TorsionMap, build
from hd_diag.model.transmission_error import Kinematics, Output

RATED = published.RATED_TORQUE
ALIGNED = Drive(drives.mesh(), Kinematics(100.0), RATED)
ASTRAY = Drive(drives.mesh(eccentricity=(0.0, published.ECCENTRICITY)), Kinematics(100.0), RATED, 3e-6)
ANGLES = np.linspace(-3.0, 11.0, 40)
GEOMETRY = ALIGNED.mesh.geometry
SIGNED = [(ratio, "flexspline") for ratio in (100.0, -100.0)]
SIGNED += [(ratio, "circular_spline") for ratio in (101.0, -101.0)]

REFUSED = [
    ({"rated_torque": 0.0}, "rated_torque must be positive, not 0.0 N m"),
    ({"rated_torque": math.inf}, "rated_torque must be positive, not inf N m"),
    ({"rated_torque": math.nan}, "rated_torque must be positive, not nan N m"),
    ({"cup_compliance": -1e-6}, r"cup_compliance must not be negative, not -1e-06 rad/\(N m\)"),
    ({"cup_compliance": math.nan}, "cup_compliance must not be negative, not nan"),
]
RATIOS_REFUSED = [
    (
        Kinematics(101.0),
        "ratio 101 does not fit 200 and 202 teeth with the output at the flexspline: .* 100; "
        "output: circular_spline has this ratio",
    ),
    (Kinematics(100.0, "circular_spline"), "its magnitude must be 101; output: flexspline has this ratio"),
    (Kinematics(161.0, "circular_spline"), "must be 101; a gear of 320 and 322 teeth has this ratio"),
    (Kinematics(0.5, of_teeth=False), "ratio must be finite and above 1, not 0.5"),
    (Kinematics(100.001), "ratio 100.001 does not fit"),
    (Kinematics(0.0), "ratio 0 does not fit"),
    (Kinematics(math.nan), "ratio nan does not fit"),
    (Kinematics(math.inf), "ratio inf does not fit"),
    (Kinematics(100.0, "cup"), "output must be 'flexspline' or 'circular_spline', not 'cup'"),  # type: ignore[arg-type]
    (Kinematics(100.0, phase=math.nan), "wave_generator_phase must be finite, not nan rad"),
]


def state(drive: Drive, torque: float, angle: float = 0.0) -> MeshState:
    return mesh_state(drive, np.array([angle]), np.array([torque]))


@pytest.mark.parametrize(
    ("changes", "message"), [*REFUSED, *(({"kinematics": one}, said) for one, said in RATIOS_REFUSED)]
)
def test_names_what_cannot_be(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(ALIGNED, **changes)


def test_summaries_of_the_load() -> None:
    found = mesh_state(ASTRAY, ANGLES, np.linspace(-60, 60, ANGLES.size))
    for row in range(ANGLES.size):
        loads = found.load[row][found.load[row] > 0]
        assert found.loaded_pairs[row] == loads.size
        assert found.peak_load[row] == loads.max()
        assert_allclose(found.load_concentration[row], loads.max() / loads.mean(), rtol=1e-13)
        assert found.minimum_backlash[row] == np.nanmin(found.backlash[row])
    idle = state(ALIGNED, 0.0)  # no pair carries load in a gap at zero torque
    assert (idle.loaded_pairs[0], idle.peak_load[0], idle.load_concentration[0]) == (0, 0, 1)


def test_lost_motion_and_overlap_by_the_first_flanks() -> None:
    found = mesh_state(ALIGNED, ANGLES, np.zeros(ANGLES.size))
    assert not found.interference.any()
    assert_allclose(-found.overlap, found.lost_motion * 30.9e-3, rtol=0.01)  # contacts near the pitch radius
    assert np.all(found.lost_motion > 0)
    found = state(ASTRAY, 0.0)
    assert found.interference[0]
    assert found.lost_motion[0] == 0
    first_flanks = np.nanmin(found.backlash[0], axis=1)
    assert_allclose(found.overlap[0], -first_flanks.sum(), rtol=0.01)
    assert found.overlap[0] > 20e-6


def test_lobes_press_against_each_other() -> None:
    """With a displacement across the long axis, one lobe turns counter-clockwise and the other clockwise."""
    plus, minus = state(ASTRAY, 0.0).load[0]
    first_lobe = np.roll(np.abs(np.arange(-100, 100)) < 50, -100)
    assert min(plus[first_lobe].sum(), minus[~first_lobe].sum()) > 100
    assert plus[~first_lobe].sum() == minus[first_lobe].sum() == 0


@pytest.mark.parametrize(("ratio", "output"), SIGNED)
def test_the_output_turns_by_the_ratio(ratio: float, output: Output) -> None:
    """The output is reported with its true sign; with a negative ratio, the input is reported backwards."""
    frames = (Kinematics(ratio, output, phase).frame(GEOMETRY) for phase in (0.0, 0.7))
    turned, later = (frame.wave_generator_angle(ANGLES) for frame in frames)
    assert_allclose(later - turned, 0.7, atol=1e-14)  # the phase is the long axis at input zero
    if output == "flexspline":  # it rolls in the fixed circular spline by -theta_W (Z_G - Z_R) / Z_R
        assert_allclose(-turned * 2 / 200, ANGLES / ratio, rtol=1e-14)
    else:  # relative to the wave generator, it turns by the difference
        assert_allclose(turned, ANGLES * np.sign(ratio) - ANGLES / ratio, rtol=1e-13)
        assert_allclose(turned * 2 / 200, ANGLES / ratio, rtol=1e-13)


@pytest.mark.parametrize(("ratio", "output"), SIGNED)
def test_the_output_lags_by_torsion_and_cup_when_it_drives(ratio: float, output: Output) -> None:
    torque = np.linspace(-50, 60, ANGLES.size)
    kinematics = Kinematics(ratio * (1 + 1e-10), output, -3.0)
    soft, rigid = (Drive(ASTRAY.mesh, kinematics, RATED, cup) for cup in (3e-6, 0.0))
    found = transmission_error(soft, ANGLES, torque)
    assert np.all(found * torque < 0)
    assert_allclose(found, transmission_error(rigid, ANGLES, torque) - 3e-6 * torque, rtol=1e-12)
    way = (-np.sign(ratio) if output == "flexspline" else np.sign(ratio) * 200 / 202) * ANGLES - 3.0
    sign = -1.0 if output == "flexspline" else 1.0
    assert_allclose(found, -sign * torsion(ASTRAY.mesh, way, sign * torque) - 3e-6 * torque, rtol=1e-12)


@pytest.fixture(scope="module")
def table() -> TorsionMap:
    return build(ASTRAY.mesh, 40.0)


def test_a_map_keeps_its_bound_and_beyond_it_is_exact(table: TorsionMap) -> None:
    torque = np.linspace(-2.0, 2.0, ANGLES.size) * table.torque_limit
    exact = transmission_error(ASTRAY, ANGLES, torque)
    found = transmission_error(ASTRAY, ANGLES, torque, table)
    beyond = np.abs(torque) > table.torque_limit
    assert_array_equal(found[beyond], exact[beyond])
    assert 0.0 < np.abs(found - exact).max() <= table.error_bound + 1e-15
    assert table.error_bound < 0.04 * ARCSEC
