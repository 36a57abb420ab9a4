"""Values that the model must give, each with its source.

PAPER: H. Dong, T. Chen, D. Wang, B. Dong, "Kinematic Model of Harmonic Drive in Robot Joints with Input
Eccentricity Error", ROMANSY 22, CISM 584, pp. 134-140, 2019, doi 10.1007/978-3-319-78963-7_18.
CATALOGUE: HFUS-25 catalogue, ratio 100 (K1 and K3 also in Schaeffler TPI 275).
CALCULATION: independent calculation, flanks as 1,600-point polylines, no closed form; error below 0.02 um.

Unless stated otherwise: wave-generator angle 0 (long axis on tooth 0), arc offset 0, eccentricity (0, e),
which is tangential to tooth 0, counter-clockwise. SI units.
"""

from typing import NamedTuple

# PAPER, section 4
RATED_TORQUE = 56.0  # [N m]
ECCENTRICITY = 0.023e-3  # [m] at which interference first appears

# CALCULATION: circumferential backlash D = r b of the + flank [m], printed to 1e-9 m (tooth 180: 1e-7 m)
BACKLASH_TEETH = (0, 5, 10, 15, 20, 100, 105, 120, 180, 190, 195)
BACKLASH = {
    0.0: (
        *(17.207e-6, 8.461e-6, 2.963e-6, 0.944e-6, 4.761e-6),
        *(17.207e-6, 8.461e-6, 4.761e-6, 162.1e-6, 55.819e-6, 31.393e-6),
    ),
    ECCENTRICITY: (
        *(-5.816e-6, -15.071e-6, -20.939e-6, -23.604e-6, -21.527e-6),
        *(40.227e-6, 32.012e-6, 31.704e-6, 151.4e-6, 35.973e-6, 9.455e-6),
    ),
}


class LoadCase(NamedTuple):
    """Torsion [rad], loaded flanks (+, -) and, where given, the largest force [N] under a torque [N m]."""

    eccentricity: float
    torque: float
    torsion: float
    loaded: tuple[int, int]
    largest_force: float | None = None


# CALCULATION: torsion printed to four figures
LOAD_CASES = (
    LoadCase(0.0, 1.0, 1.178e-4, (20, 0)),
    LoadCase(0.0, 14.0, 5.526e-4, (46, 0)),
    LoadCase(0.0, 56.0, 1.399e-3, (70, 0), 39.8),
    LoadCase(0.0, 100.0, 2.117e-3, (82, 0)),
    LoadCase(ECCENTRICITY, 1.0, 2.10e-5, (29, 29)),
    LoadCase(ECCENTRICITY, 14.0, 3.013e-4, (32, 23)),
    LoadCase(ECCENTRICITY, 56.0, 1.301e-3, (64, 0), 60.1),
)

# CATALOGUE: limits of the torque ranges [N m] and torsional stiffness in them [N m/rad]
T1, T2 = 14.0, 48.0
K1, K2, K3 = 3.1e4, 5.0e4, 5.7e4

# CALCULATION: secant stiffness [N m/rad] between two torques [N m] at e = 0
SECANT_STIFFNESS = {(1.0, T1): 3.0e4, (T1, T2): 4.8e4, (RATED_TORQUE, 100.0): 6.1e4}

# Interference ---
# The paper holds tooth 0 on the axis at the initial moment (eq. 1): the neutral curve is displaced by e along
# y, the flexspline by -e along the curve. A tooth's backlash is the lesser of its two flanks. The least over
# the engagement region of tooth 0 counts (not the other lobe, where e points the other way).
# CALCULATION: the interference first appears at ECCENTRICITY if the datum is DATUM_OF_INTERFERENCE, which
# rounds to 29.868 mm. It is sensitive: 0.122 um of datum shift it by 1 um. With 29.868 mm it appears at
# ECCENTRICITY_AT_ROUNDED_DATUM.
DATUM_OF_INTERFERENCE = 29.86833e-3  # [m]
ECCENTRICITY_AT_ROUNDED_DATUM = 20.32e-6  # [m]


# One tooth over a turn (PAPER: backlash grows, load falls) ---
# CALCULATION: tooth 0, eccentricity along x. Least backlash of either flank and largest force at 56 N m while
# the lobe passes tooth 0 (wave-generator angle from -0.7 to 0 rad). The other lobe differs by a few percent,
# because the tooth has moved on by one pitch (47.4 N and -9.08 um at +ECCENTRICITY).


class Turn(NamedTuple):
    """Eccentricity (x, 0) [m], least backlash [m] and largest force [N] of tooth 0."""

    eccentricity: float
    least_backlash: float
    largest_force: float


TURNS = (
    Turn(0.0, 0.94e-6, 39.8),
    Turn(-ECCENTRICITY, 9.59e-6, 31.0),
    Turn(ECCENTRICITY, -8.37e-6, 46.9),
)

# Transmission error over a turn of the wave generator ---
# CALCULATION, 512 angles of half a turn (a static eccentricity repeats every half turn, one tooth pitch
# of the flexspline): amplitude of order 2 and peak to peak [arcsec] at e = ECCENTRICITY by torque [N m].
ORDER_2_ARCSEC = {10.0: 24.18, 56.0: 12.55}
PEAK_TO_PEAK_ARCSEC = {10.0: 50.92, 56.0: 25.19}
RIPPLE_ARCSEC = {10.0: 0.1, 56.0: 0.2}  # upper limits of the peak to peak at e = 0 (tooth passing)

# Cams ---
# CALCULATION (support functions by quadrature): harmonics c_k [m] of the neutral curve of radius 30 mm (the
# ellipse's is 29.999959 mm). All have the ellipse's greatest displacement, 0.258441 mm.
ELLIPSE_RADIUS = 29.999959e-3
ELLIPSE_HARMONICS = (0.258997587e-3, -5.59009e-7, 2.41309e-9, -1.302e-11)
DISPLACEMENT = 0.258441e-3
COSINE_HARMONICS = (0.25842e-3, -1.2520e-6, 1.617e-8)
FOUR_FORCES_HARMONICS = {  # keys: angle of the forces [degrees]
    25.0: (0.26464e-3, -4.273e-6, -2.574e-6, -7.9e-7),
    30.0: (0.27326e-3, -1.2496e-5, -3.750e-6, -4.7e-7),
}

# Sections ---
# CALCULATION, five sections at Gauss-Legendre points of 11 mm, R_b = 30 mm. The semi-axes follow the
# displacement with the perimeter kept. Wave-generator angle 0; eccentricity and tilt across the long axis.
SECTION_TORQUES = (1.0, 14.0, 56.0, 100.0)  # [N m]
FACE_WIDTH = 11e-3  # [m]


class SectionCase(NamedTuple):
    """Cup length [m] (0: a ring), eccentricity [m], tilt [rad]; torsions [rad], least backlashes [m].

    The torsions are at `SECTION_TORQUES`. The backlashes are those of + flanks, from the cup's bottom to its
    open end. Where given, ``order_2`` is the amplitude per wave-generator turn at those torques [arcsec].
    """

    cup_length: float
    eccentricity: float
    tilt: float
    torsion: tuple[float, ...]
    backlash: tuple[float, ...]
    order_2: tuple[float, ...] = ()


def _case(length: float, e: float, tilt: float, *values: tuple[float, ...]) -> SectionCase:
    torsion, backlash, *order_2 = values
    scaled = [tuple(1e-4 * one for one in torsion), tuple(1e-6 * one for one in backlash)]
    return SectionCase(length, e, tilt, *scaled, *order_2)


SECTION_CASES = (
    _case(0.0, 0.0, 0.0, (1.1794, 5.5257, 13.986, 21.166), (0.95, 0.95, 0.95, 0.95, 0.95)),
    _case(
        *(0.0, 0.0, 1e-3, (0.7532, 5.4711, 13.973, 21.163), (-4.38, -2.22, 0.95, -2.22, -4.38)),
        (4.66, 0.60, 0.22, 0.15),
    ),
    _case(
        0.0,
        10e-6,
        1e-3,
        (0.3260, 4.7975, 13.809, 21.072),
        (-4.41, -6.58, -9.75, -12.91, -15.07),
        (7.31, 7.79, 2.40, 1.64),
    ),
    _case(0.04, 0.0, 0.0, (0.9253, 5.4725, 13.941, 21.148), (-4.56, -2.09, 0.95, 3.32, 4.68)),
    _case(0.04, 10e-6, 0.0, (0.3198, 4.8334, 13.780, 21.057), (-15.80, -13.08, -9.75, -7.15, -5.64)),
    _case(
        0.04,
        10e-6,
        1e-3,
        (0.3129, 4.6125, 13.770, 21.051),
        (-10.21, -9.82, -9.75, -10.24, -10.78),
        (5.64, 9.12, 2.26, 1.57),
    ),
    _case(0.025, 0.0, 0.0, (0.7511, 5.3730, 13.867, 21.108), (-8.53, -4.24, 0.95, 4.53, 6.34)),
)
ECCENTRIC_ORDER_2 = (7.38, 6.70, 2.17, 1.50)  # [arcsec], for 10 um without tilt and coning


class PlaneGear(NamedTuple):
    """A gear of one section fitted to its page: page torsion at eight torques [arcsec], force at rest [N].

    The force comes from another code's fit of datum and compliances.
    """

    torsion: tuple[float, ...]
    idle: float


PLANE_GEARS = {
    "CSG-17-100": PlaneGear((8.0, 20.1, 40.2, 80.4, 140, 200, 277, 355), 1.3),
    "CSG-25-100": PlaneGear((9.3, 23.3, 46.6, 93.2, 163, 233, 320, 407), 2.7),
    "CSG-20-160": PlaneGear((9.0, 22.6, 45.1, 90.2, 165, 239, 328, 417), 0.8),
    "CSG-14-50": PlaneGear((12.1, 30.3, 60.7, 121, 229, 336, 461, 586), 2.2),
    "CSG-32-120": PlaneGear((8.9, 22.3, 44.6, 89.3, 163, 237, 330, 423), 3.3),
}
