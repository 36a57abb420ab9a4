"""Signs and frames between what the robot reports and the mesh."""

import math

import drives
import numpy as np
import pytest
from numpy.testing import assert_allclose

from hd_diag.model.torsion import torsion
from hd_diag.model.transmission_error import Kinematics, Output

GEOMETRY = drives.geometry()
ANGLES = np.linspace(-12.0, 9.0, 40)
FLEXSPLINE = [(100.0, "flexspline"), (-100.0, "flexspline")]
CIRCULAR_SPLINE = [(101.0, "circular_spline"), (-101.0, "circular_spline")]


@pytest.mark.parametrize(("ratio", "output"), FLEXSPLINE + CIRCULAR_SPLINE)
def test_ratios_that_the_teeth_give(ratio: float, output: Output) -> None:
    Kinematics(ratio, output).check(GEOMETRY)
    Kinematics(ratio * (1 + 1e-10), output, phase=-3.0).check(GEOMETRY)


REFUSED = [
    (
        Kinematics(101.0),
        "ratio 101 does not fit 200 and 202 teeth with the output at the flexspline: .* 100",
    ),
    (Kinematics(100.0, "circular_spline"), "output at the circular spline: its magnitude must be 101"),
    (Kinematics(100.001), "ratio 100.001 does not fit"),
    (Kinematics(0.0), "ratio 0 does not fit"),
    (Kinematics(math.nan), "ratio nan does not fit"),
    (Kinematics(math.inf), "ratio inf does not fit"),
    (Kinematics(100.0, "cup"), "output must be 'flexspline' or 'circular_spline', not 'cup'"),  # type: ignore[arg-type]
    (Kinematics(100.0, phase=math.nan), "wave_generator_phase must be finite, not nan rad"),
]


@pytest.mark.parametrize(("kinematics", "message"), REFUSED)
def test_refuses_with_the_reason(kinematics: Kinematics, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kinematics.check(GEOMETRY)


@pytest.mark.parametrize(("ratio", "output"), FLEXSPLINE + CIRCULAR_SPLINE)
def test_the_output_turns_by_the_ratio(ratio: float, output: Output) -> None:
    """The output is reported as it turns; a negative ratio says that the input is reported backwards."""
    turned, later = (
        Kinematics(ratio, output, phase).frame(GEOMETRY).wave_generator_angle(ANGLES) for phase in (0.0, 0.7)
    )
    assert_allclose(later - turned, 0.7, atol=1e-14)  # the phase is the long axis at input zero
    if output == "flexspline":  # rolling in the fixed circular spline, it turns by -theta_W (Z_G - Z_R) / Z_R
        assert_allclose(-turned * 2 / 200, ANGLES / ratio, rtol=1e-14)
    else:  # it follows the wave generator, which seen from it turns by the difference
        assert_allclose(turned, ANGLES * np.sign(ratio) - ANGLES / ratio, rtol=1e-13)
        assert_allclose(turned * 2 / 200, ANGLES / ratio, rtol=1e-13)


@pytest.mark.parametrize(("ratio", "output"), FLEXSPLINE + CIRCULAR_SPLINE)
@pytest.mark.parametrize("torque", [-20.0, 3.0, 56.0])
def test_the_output_lags_when_it_drives(ratio: float, output: Output, torque: float) -> None:
    rigid, soft = (Kinematics(ratio, output).frame(GEOMETRY, compliance) for compliance in (0.0, 1e-6))
    angle = soft.wave_generator_angle(ANGLES)
    load = np.full(angle.size, torque)
    beta = torsion(drives.mesh(), angle, soft.cup_torque(load))
    error = soft.transmission_error(beta, load)
    assert np.all(error * torque < 0)
    assert_allclose(error, rigid.transmission_error(beta, load) - 1e-6 * torque, rtol=1e-12)
