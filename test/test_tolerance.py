"""Assembly tolerances: laws of the limits and the yield, and limits confirmed by brute force."""

import dataclasses
import math
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import drives
import numpy as np
import pytest
from numpy.testing import assert_allclose
from reference import polyline, published

from hd_diag.config.configuration import resolve
from hd_diag.drive import Drive, mesh_state
from hd_diag.model.contact import contacts
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion import torsion, torsion_and_gradient
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.model.transmission_error import Kinematics
from hd_diag.process_pool import ProcessPool
from hd_diag.tolerance import assembly
from hd_diag.tolerance.assembly import FACTORS, Assembly, Population, Share, Spread, draw, judged, yields
from hd_diag.tolerance.evaluation import (
    CRITERIA,
    NAMES,
    cup_torques,
    evaluate,
    of_moments,
    reference_stiffness,
)
from hd_diag.tolerance.limit import (
    STEPS,
    DisplacementLimit,
    across_long_axis,
    allowed,
    check_largest,
    first_excess,
    frontier,
    input_angle,
    largest_eccentricity,
)
from hd_diag.tolerance.study import limits_and_spreads

ROOT = Path(__file__).resolve().parent.parent
RATED = published.RATED_TORQUE
CUP = -RATED  # output at the flexspline
LARGEST = 40e-6
NOMINAL = resolve({})
LIMITS, SPREADS = limits_and_spreads(NOMINAL.flat, "joint_1")
NONE = {name: Spread(spread.distribution, 0.0) for name, spread in SPREADS.items()}


def drive(mesh: Mesh | None = None, **changes: Any) -> Drive:
    return dataclasses.replace(Drive(mesh or drives.mesh(), Kinematics(100.0), RATED), **changes)


@cache
def excess(criterion: str, limit: float, of: Drive | None = None, torque: float = CUP) -> DisplacementLimit:
    return first_excess(of or drive(), torque, criterion, limit, LARGEST)


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search for an excess in few steps; its solution does not depend on their number."""
    monkeypatch.setattr("hd_diag.tolerance.limit.STEPS", 12)


# Moments ---


def test_an_environment_compiles_the_kernels_of_model_and_tolerances() -> None:
    """After the script's warm-up the first study or diagnosis compiles nothing."""
    parts = re.findall(r"-c '(.*warm_up.*)'", (ROOT / "scripts" / "environment.sh").read_text())
    kernels = (
        "tolerance.loads, tolerance.lobes, entry.torsion, entry.torsion_and_gradient,"
        "entry.torsion_of_flanks, *slow,"
        "align, messages.write, messages.read, monitor.compare, orders.follow"
    )
    compiled = f"print([len(k.signatures) for k in ({kernels})])"
    imports = (
        "from hd_diag.model.kernel import entry; from hd_diag.tolerance import kernel as tolerance;"
        "from hd_diag.messages import kernel as messages; from hd_diag.monitor import kernel as monitor;"
        "from hd_diag.monitor import kernel_orders as orders;"
        "from hd_diag.effects import recursions as r;"
        "from hd_diag.effects.contact_table import contact_table;"
        "from hd_diag.streams.kernel import align; slow = [r._compiled(f) for f in (r._slip, r._relax)]"
    )
    use = (
        "import drives, numpy as np; from hd_diag.tolerance.evaluation import evaluate;"
        "evaluate(drives.mesh(), np.zeros(2), np.zeros(2, complex), np.array([56.0]));"
        "from hd_diag.config.configuration import resolve; own = resolve({}).joints[0].drive;"
        "fit_parameters.along(own, own, np.ones(2), np.ones(2)); contact_table(own, 20.0);"
        "r.slip(0.5, np.ones(3)); r.relax(np.ones(2) + 0j, np.ones(1) + 0j, np.ones((3, 2)) + 0j)"
    )
    here = f"sys.path.insert(0, {str(ROOT / 'test')!r})"
    program = f"import sys; {here}; {'; '.join(parts)}; {imports}; {compiled}; {use}; {compiled}"
    command = [sys.executable, "-c", program]
    ran = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    assert ran.stdout.splitlines() == ["[1, 1, 1, 1, 1, 1, 1, 1, 1, 2, 1, 1]"] * 2


def test_moments_are_those_of_the_mesh() -> None:
    """Overlap at the mean radius of all contacts instead of one lobe's; the two differ by 0.02 %."""
    own = drive(drives.mesh(eccentricity=(9e-6, 4e-6), runout=(1e-6, 0.0)))
    turn = np.linspace(0.0, 6.0, 40)
    state = mesh_state(own, -turn, np.full(40, CUP))
    found = evaluate(own.mesh, turn, own.mesh.displacement(turn), np.array([CUP]))
    assert_allclose(found.torsion[:, 0], state.torsion, rtol=0, atol=1e-15)
    assert_allclose(found.peak_load[:, 0], state.peak_load, rtol=1e-12)
    assert_allclose(found.load_concentration[:, 0], state.load_concentration, rtol=1e-12)
    assert_allclose(found.overlap, state.overlap, rtol=3e-4)
    _, gradient = torsion_and_gradient(own.mesh, turn, np.full(40, CUP))
    loss = of_moments(found, 2e-6, np.array([5e4]))[NAMES.index("stiffness_loss"), :, 0]
    assert_allclose(loss, 1 - (1 / (gradient[:, 4] + 2e-6)) / 5e4, rtol=1e-9)


def test_slots_turned_together_turn_the_cup_and_one_is_that_of_the_brute_force() -> None:
    """The reference shifts the wall equally at every radius, here the slot turns: 0.5 % of 3 um."""
    random = np.random.default_rng(0)
    center = random.uniform(0, 30e-6, 20) * np.exp(1j * random.uniform(0, 7, 20))
    moments = drives.mesh(), random.uniform(-9.0, 9.0, 20), center, np.array([CUP])
    plain, turned = (evaluate(*moments, np.full(202, angle)) for angle in (0.0, 1e-5))
    assert_allclose(turned.torsion - plain.torsion, 1e-5, rtol=1e-9)
    assert_allclose(turned.peak_load, plain.peak_load, rtol=1e-9)
    assert_allclose(turned.overlap, plain.overlap, atol=1e-15)
    shift, wall_radius = np.zeros(202), 30.6e-3
    shift[16] = 3e-6
    found = evaluate(drives.mesh(), np.zeros(1), np.zeros(1, complex), np.array([56.0]), shift / wall_radius)
    reference = polyline.mesh(0.0, slot_shift=shift)
    assert_allclose(found.torsion[0, 0], polyline.torsion(reference, 56.0), rtol=1e-4)
    assert_allclose(found.interference[0], -np.nanmin(reference.backlash), atol=0.05e-6)


# Limits ---


@pytest.mark.parametrize("criterion", [c.name for c in CRITERIA if not c.jumps])
def test_a_limit_is_crossed_where_it_says(criterion: str) -> None:
    """The mesh of the found eccentricity confirms it at the worst direction and input angle."""
    found = excess(criterion, LIMITS[criterion])
    assert found.reached
    assert found.without < found.limit
    assert found.scanned.shape == (2, STEPS + 1)
    for step, is_exceeded in ((-1e-9, False), (1e-9, True)):
        at = found.eccentricity + step
        assert (value(criterion, found, at) > found.limit) == is_exceeded


def value(criterion: str, found: DisplacementLimit, eccentricity: float) -> float:
    """Value of a criterion at the direction and input angle found, computed independently of the search."""
    towards = eccentricity * np.exp(1j * found.worst.direction)
    own = drive(dataclasses.replace(drives.mesh(), eccentricity=towards))
    angle = np.array([input_angle(own, found.worst.wave_generator_angle)])
    turn = own.frame.wave_generator_angle(angle)
    assert_allclose(turn, found.worst.wave_generator_angle, atol=1e-12)
    state = mesh_state(own, angle, np.array([CUP]))
    if criterion == "interference":
        across = (towards * np.exp(-1j * turn[0])).imag
        contact = contacts(dataclasses.replace(own.mesh, arc_offset=-across), turn)
        return -float(np.nanmin((contact.radius * contact.rotation)[:, :, : contact.teeth.shape[1] // 2]))
    if criterion == "transmission_error":
        around = np.linspace(0, 2 * np.pi, 202 * 40)
        return float(np.ptp(torsion(own.mesh, around, np.full(around.size, CUP))))
    name = {"peak_tooth_load": "peak_load"}.get(criterion, criterion)
    return float(getattr(state, name)[0])


@pytest.mark.parametrize(
    "without",
    [
        pytest.param((), marks=pytest.mark.slow),
        ("load_concentration", "transmission_error"),
        ("load_concentration", "transmission_error", "overlap"),
        NAMES,
    ],
)
def test_what_is_allowed_is_the_first_limit_of_all(without: tuple[str, ...]) -> None:
    """The result equals that of solving for every limit; limits out of reach do not count."""
    limits = LIMITS | dict.fromkeys(without, 1e9)
    reached = [(excess(name, LIMITS[name]).eccentricity, name) for name in NAMES if name not in without]
    assert allowed(drive(), CUP, limits, LARGEST) == (min(reached) if reached else None)


@pytest.mark.parametrize(
    ("criterion", "beside"),
    [
        *((name, 0.0) for name in ("interference", "overlap", "peak_tooth_load")),
        ("stiffness_loss", 0.3e-6),
        pytest.param("load_concentration", 0.3e-6, marks=pytest.mark.slow),
    ],
)
def test_no_direction_and_angle_is_worse(criterion: str, beside: float) -> None:
    """At the limit eccentricity 20,000 random moments stay within the limit.

    Where a pair comes into load, worst moments are rare: random ones exceed the limit within ``beside`` [m].
    """
    found = excess(criterion, LIMITS[criterion])
    random = np.random.default_rng(4)
    turn, direction = random.uniform(0, 2 * np.pi, (2, 20_000))
    reference, torque = reference_stiffness(drive(), np.array([CUP])), np.array([CUP])

    def worst(eccentricity: float) -> float:
        moments = evaluate(drives.mesh(), turn, eccentricity * np.exp(1j * direction), torque)
        return float(of_moments(moments, 0.0, reference)[NAMES.index(criterion)].max())

    if beside:
        assert worst(found.eccentricity - beside) < found.limit < worst(found.eccentricity + beside)
    else:
        assert worst(found.eccentricity) <= found.limit * (1 + 1e-6)


@pytest.mark.parametrize(
    "criterion",
    ["overlap", *(pytest.param(name, marks=pytest.mark.slow) for name in ("interference", "stiffness_loss"))],
)
def test_of_images_of_the_worst_the_first_is_given(coarse: None, criterion: str) -> None:
    """Half a turn swaps the lobes, except for criteria of one lobe; without torque a mesh mirrors.

    A drive smaller by a part in 1e12 rounds differently but must have the same worst moment.
    """
    relative = []
    for datum in drives.PAPER.circular_spline_datum * np.array([1.0, 1.0 + 1e-12]):
        own = drive(drives.mesh(dataclasses.replace(drives.PAPER, circular_spline_datum=float(datum))))
        worst = first_excess(own, CUP, criterion, np.inf, 20e-6).worst
        relative.append(np.mod(worst.direction - worst.wave_generator_angle, 2.0 * np.pi))
    assert max(relative) < (0.5 * np.pi if criterion == "overlap" else np.pi) + 1e-3
    assert_allclose(relative, relative[0], atol=1e-3)


def test_mirrored_torque_has_the_same_limit(coarse: None) -> None:
    asked = "peak_tooth_load", LIMITS["peak_tooth_load"], LARGEST
    mirrored, plain = (first_excess(drive(), torque, *asked).eccentricity for torque in (-CUP, CUP))
    assert_allclose(mirrored, plain, rtol=1e-5)


def test_a_runout_takes_its_part(coarse: None) -> None:
    """Overlap depends on the displacement across the long axis, so runout and eccentricity add up."""
    own = drive(drives.mesh(runout=(0.0, 3e-6)))
    asked = CUP, "overlap", LIMITS["overlap"], LARGEST
    found, without = (first_excess(each, *asked).eccentricity for each in (own, drive()))
    assert_allclose(found, without - 3e-6, atol=0.05e-6)


# Tilts ---


@cache
def cup(cup_length: float, sections: int = 2) -> Drive:
    width = {"face_width": published.FACE_WIDTH, "cup_length": cup_length, "sections": sections}
    return drive(Mesh(drives.geometry(**width)))


def test_a_tilt_of_each_moment_takes_the_place_of_the_mesh_s() -> None:
    own, turn = cup(0.04).mesh, np.array([0.2, 0.9])
    tilts, center = np.array([1e-3j, 0.4e-3 + 0j]), np.array([4e-6 + 0j, 3e-6j])
    together = evaluate(own, turn, center, np.array([CUP]), tilt=tilts)
    for k, tilt in enumerate(tilts):
        leaning = dataclasses.replace(own, tilt=complex(tilt))
        alone = evaluate(leaning, turn[k : k + 1], center[k : k + 1], np.array([CUP]))
        for name, values in vars(alone).items():
            assert_allclose(getattr(together, name)[k], values[0], rtol=1e-12, err_msg=name)


def test_no_direction_and_angle_of_a_tilt_is_worse(coarse: None) -> None:
    found = first_excess(cup(0.04), CUP, "interference", 9e-6, LARGEST, 1.0)
    turn, direction = np.random.default_rng(5).uniform(0, 2 * np.pi, (2, 5000))
    still = np.zeros(turn.size, dtype=complex)

    def worst(tilt: float) -> float:
        leaning = tilt * np.exp(1j * direction)
        return float(evaluate(cup(0.04).mesh, turn, still, np.array([CUP]), tilt=leaning).interference.max())

    # 5000 random moments come within 2 % of the worst one.
    assert worst(0.98 * found.tilt) < 9e-6 < worst(1.02 * found.tilt)
    assert worst(found.tilt) <= 9e-6 * (1 + 1e-6)


def test_the_chart_s_ends_are_the_single_limits(coarse: None) -> None:
    limits = {"overlap": 6e-6}
    ring = {s: frontier(cup(0.0), CUP, limits, LARGEST, s)["overlap"] for s in (-0.5, 0.0, 0.5, 1.0)}
    assert_allclose(ring[-0.5], np.multiply(ring[0.5], (1, -1)), rtol=1e-9)
    step = LARGEST / 24  # of the chart; a coarse grid finds the worst at most 5 % too late
    arm = cup(0.0).mesh.geometry.section_places.max()
    for share, name, scale in ((0.0, "eccentricity", 1.0), (1.0, "tilt", arm)):
        exact = getattr(first_excess(cup(0.0), CUP, "overlap", 6e-6, LARGEST, share), name) * scale
        assert_allclose(max(ring[share][0], ring[share][1] * arm), exact, rtol=0.05, atol=0.1 * step)
    asked = CUP, {"interference": 9e-6}, LARGEST
    left, right = (frontier(cup(0.04), *asked, share)["interference"] for share in (-0.5, 0.5))
    assert abs(left[0] - right[0]) > 1e-6


def test_the_drive_s_own_tilt_does_not_count(coarse: None) -> None:
    own = cup(0.04)
    leaning = dataclasses.replace(own, mesh=dataclasses.replace(own.mesh, tilt=0.8e-3))
    asked = CUP, "overlap", 12e-6, LARGEST
    assert first_excess(leaning, *asked).eccentricity == first_excess(own, *asked).eccentricity


def test_input_angle_of_the_other_output() -> None:
    own = Drive(drives.mesh(), Kinematics(-101.0, "circular_spline", 0.2), RATED)
    turn = own.frame.wave_generator_angle(np.array([input_angle(own, 1.3)]))
    assert_allclose(turn, 1.3, rtol=1e-14)


def test_limits_that_are_exceeded_from_the_start_or_never() -> None:
    at_once, never = excess("peak_tooth_load", 30.0), excess("peak_tooth_load", 1000.0)
    assert (at_once.reached, at_once.eccentricity) == (True, 0.0)
    assert at_once.without > 30.0
    assert not never.reached
    assert math.isnan(never.eccentricity)
    assert never.worst.value == pytest.approx(never.scanned[1, -1], rel=1e-2)
    off = drive(drives.mesh(dataclasses.replace(drives.PAPER, circular_spline_datum=29.9e-3)))
    assert math.isnan(across_long_axis(off, LARGEST)[0])
    assert excess("interference", 0.0, off).worst.value < 0.0


def test_questions_that_cannot_be() -> None:
    for torque in (0.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="finite and not zero"):
            cup_torques(drive(), np.array([torque]))
    with pytest.raises(ValueError, match="cannot bear"):
        reference_stiffness(Drive(drives.mesh(drives.shallow()), Kinematics(15.0), RATED), np.array([9.0]))
    check_largest(drive(), largest_eccentricity(drive()))
    with pytest.raises(ValueError, match="must be positive, not 0 µm"):
        check_largest(drive(), 0.0)
    with pytest.raises(ValueError, match="strikes the circular spline"):
        check_largest(drive(), 1e-3)


# Assemblies ---


def population(**sizes: tuple[str, float]) -> Population:
    spreads = NONE | {name: Spread(*spread) for name, spread in sizes.items()}
    return Population(drive(), spreads, np.array([CUP]), angles=24)


def values(of: Population, tolerances: Any, samples: int = 24, jobs: int = 1, *done: Any) -> Any:
    numbers = np.random.default_rng(5).random((samples, len(FACTORS)))
    with ProcessPool(jobs) as pool:
        return judged(pool, of, numbers, np.asarray(tolerances, dtype=float), *done)


def test_assemblies_are_meshes_with_their_eccentricity_and_runout() -> None:
    """Without tolerances every assembly is the perfect drive."""
    peak, turn = NAMES.index("peak_tooth_load"), 2 * np.pi * np.arange(24) / 24
    found = values(population(), [0.0], samples=3)
    assert np.ptp(found, axis=0).max() == 0.0
    state = mesh_state(drive(), -turn, np.full(24, CUP))
    assert_allclose(found[0, peak, 0], state.peak_load.max(), rtol=1e-12)
    assert_allclose(found[0, NAMES.index("transmission_error"), 0], np.ptp(state.torsion), rtol=1e-9)
    for factor, expected in ((1.001, 1.0), (0.999, 0.0)):
        limits = np.full(len(NAMES), 1e9)
        limits[peak] = found[0, peak, 0] * factor
        together, each = yields(found, limits)
        assert together.share[0] == each[peak].share[0] == expected
        assert together.low[0] <= expected <= together.high[0]
    of = population(eccentricity=("fixed", 8e-6), runout=("fixed", 2e-6))
    worst = assembly.worst(of, draw(of, np.full(len(FACTORS), 0.25)), np.array([8e-6]))
    own = drive(dataclasses.replace(drives.mesh(), eccentricity=8e-6j, runout=2e-6j))
    state = mesh_state(own, -turn, np.full(24, CUP))
    assert_allclose(worst[peak, 0], state.peak_load.max(), rtol=1e-12)
    assert_allclose(worst[NAMES.index("overlap"), 0], state.overlap.max(), rtol=1e-4)


def test_yield_falls_as_the_tolerance_grows() -> None:
    """An assembly that fails a criterion also fails it at every greater tolerance."""
    of = population(eccentricity=("rayleigh", 4e-6), tooth_compliance=("normal", 0.05))
    found = values(of, np.linspace(0.0, 40e-6, 9), samples=40)
    limits = np.array([1.0, 20e-6, 55.0, 1e9, 1.0, 10 * ARCSEC])
    together, each = yields(found, limits)
    for share in (together, *each):
        assert np.all(np.diff(share.share) <= 0.0)
        assert np.all((share.low <= share.share) & (share.share <= share.high))
    assert together.share[0] == 1.0
    assert together.share[-1] < 0.5


def test_tolerance_is_what_assemblies_keep_within() -> None:
    of = population(eccentricity=("rayleigh", 3.5e-6))
    assert_allclose(of.tolerance, 3.5e-6 * math.sqrt(-2 * math.log(1 - 0.9973)), rtol=1e-12)
    numbers = np.random.default_rng(0).random((1000, len(FACTORS)))
    magnitude = np.abs([draw(of, row).eccentricity for row in numbers])
    assert_allclose(np.mean(magnitude > 1.0), 0.0027, atol=0.005)
    assert_allclose(magnitude.mean() * of.tolerance, 3.5e-6 * math.sqrt(math.pi / 2), rtol=0.05)


@pytest.mark.parametrize(
    ("name", "variance"), [("fixed", 0), ("uniform", 1 / 3), ("normal", 1), ("triangular", 1 / 6)]
)
def test_deviations_have_the_moments_of_their_distribution(name: str, variance: float) -> None:
    of = population(circular_spline_datum=(name, 1e-6))
    numbers = np.full((300, len(FACTORS)), 0.5)
    numbers[:, FACTORS.index("circular_spline_datum")] = (np.arange(300) + 0.5) / 300
    datum = np.array([draw(of, row).drive.mesh.geometry.circular_spline_datum for row in numbers])
    drawn = (datum - drives.PAPER.circular_spline_datum) / 1e-6
    assert_allclose((drawn.mean(), drawn.std()), (name == "fixed", math.sqrt(variance)), atol=1e-2)


def test_every_factor_changes_what_it_is_named_after() -> None:
    sizes = {"runout": ("uniform", 2e-6), "pitch": ("uniform", 1e-6), "cup_compliance": ("fixed", 1e-6)}
    of = population(eccentricity=("fixed", 5e-6), tooth_compliance=("triangular", 0.1), **sizes)

    def assembled(**numbers: float) -> Assembly:
        return draw(of, np.array([numbers.get(name, 0.25) for name in FACTORS]))

    plain = assembled()
    assert_allclose(plain.eccentricity, 1j, atol=1e-12)  # number 0.25 is a quarter of a turn
    assert_allclose(plain.drive.mesh.runout, 0.5e-6j, atol=1e-15)
    assert plain.drive.cup_compliance == 1e-6
    assert plain.drive.mesh.eccentricity == 0.0
    assert assembled(tooth_compliance=0.5).drive.mesh.tooth_compliance == pytest.approx(1e-6)
    assert plain.drive.mesh.tooth_compliance < 1e-6
    other = assembled(pitch=0.7).slot_angle
    assert np.abs(plain.slot_angle - other).max() > 1e-6 / 31e-3
    assert np.abs(plain.slot_angle).max() <= 1e-6 / 30.6e-3
    assert_allclose(assembled().slot_angle, plain.slot_angle, rtol=0)


def test_an_assembly_must_hold_at_every_torque() -> None:
    one = population(eccentricity=("fixed", 8e-6))
    both = dataclasses.replace(one, cup_torque=np.array([-10.0, CUP]))
    alone = values(one, [8e-6], samples=2)
    together = values(both, [8e-6], samples=2)
    peak, width = NAMES.index("peak_tooth_load"), NAMES.index("transmission_error")
    assert_allclose(together[:, peak], alone[:, peak], rtol=1e-12)
    assert np.all(together[:, width] > 1.3 * alone[:, width])  # wider at the small torque


@pytest.mark.parametrize(
    ("name", "size", "largest"),
    [("circular_spline_datum", 9e-4, 10e-6), ("runout", 1e-4, 10e-6), ("eccentricity", 1e-3, 1e-3)],
)
def test_the_farthest_draw_must_be_possible(name: str, size: float, largest: float) -> None:
    assembly.check(population(**{name: ("normal", 1e-6)}), 10e-6)
    with pytest.raises(ValueError, match=r"circular_spline|runout|strikes the circular spline"):
        assembly.check(population(**{name: ("normal", size)}), largest)


def test_the_same_numbers_on_one_core_and_two() -> None:
    of = Population(drive(), SPREADS, np.array([CUP]), angles=12)
    done: list[bool] = []
    one, two = (values(of, [0.0, 9e-6], 10, jobs, lambda: done.append(True)) for jobs in (1, 2))
    np.testing.assert_array_equal(one, two)
    assert len(done) == 2 * assembly.chunks(10)


def test_tolerance_at_a_target() -> None:
    share = Share(np.array([1.0, 0.8, 0.6, 0.4]), *np.zeros((2, 4)))
    expected = {0.9: 1.5, 0.8: 2.0, 0.5: 3.5, 0.1: 4.0, 1.0: 1.0, 1.01: math.nan}
    found = [assembly.tolerance_at(share, np.arange(1.0, 5.0), target) for target in expected]
    assert_allclose(found, [*expected.values()])
