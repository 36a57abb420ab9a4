"""The drawing of the gear: in true scale it matches the model, and RViz can read it."""

import dataclasses

import matplotlib
import numpy as np
import pytest
from browser import contrast
from joint_records import joint

from hd_diag.drive import Drive, mesh_state
from hd_diag.messages import markers
from hd_diag.messages.markers import Exaggeration, Shape, drawing, marker_array, viridis
from hd_diag.messages.schemas import jazzy, serialize
from hd_diag.model.contact import contacts

TRUE = Exaggeration(1.0, 1.0)
MARKERS = "visualization_msgs/msg/MarkerArray"
STAMP = 1_760_000_000_123_456_789
NAMES = ["circular_spline", "flexspline", "wave_generator", "long_axis", "teeth", "eccentricity", "legend"]


def drive(**changes: float | str) -> Drive:
    return joint(**changes).drive


def shapes(drive: Drive, angle: float = 0.3, torque: float = 40.0, **options: object) -> dict[str, Shape]:
    state = mesh_state(drive, np.array([angle]), drive.frame.cup_torque(np.array([torque])))
    drawn = drawing(drive, angle, state.section_load[0], torsion=float(state.torsion[0]), **options)
    return {shape.name: shape for shape in drawn}


def points(shape: Shape) -> np.ndarray:
    return shape.points[:, 0] + 1j * shape.points[:, 1]


@pytest.fixture(params=[1, 8])
def chords(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch):
    """Largest error of a clearance [m] from drawing chords, as drawn and with 8 times as many.

    Across the tooth a chord of height h misses an arc of radius rho at slope gamma by
    h^2 / (8 rho cos^3 gamma): at most 9 um for h = 66 um, where the slot's convex arc
    (rho 0.436 mm) ends at 58 degrees.
    """
    kept = (markers._tooth_outline, markers._slots)
    monkeypatch.setattr(markers, "_FLANK_POINTS", 8 * request.param + 1)
    for function in kept:
        function.cache_clear()
    yield 9e-6 / request.param**2
    for function in kept:
        function.cache_clear()


def drawn_gaps(gear: Drive, drawn: dict[str, Shape]) -> np.ndarray:
    """Circumferential gap [m] of each tooth's flanks (+, -) to its slot's walls, from the drawn lines."""
    geometry = gear.mesh.geometry
    ring = points(drawn["circular_spline"])[:-1].reshape(geometry.circular_spline_teeth, -1)
    wall = ring[0, ring.shape[1] // 2 :]  # counter-clockwise wall of slot 0, from its bottom inwards
    wall_radius, wall_angle = np.abs(wall)[::-1], np.angle(wall)[::-1]
    outline = points(drawn["flexspline"])[:-1].reshape(geometry.flexspline_teeth, -1)
    half = outline.shape[1] // 2
    gaps = np.full((2, geometry.flexspline_teeth), np.nan)
    for tooth, line in enumerate(outline):
        slot = np.exp(1j * geometry.slot_pitch * np.rint(np.angle(line.mean()) / geometry.slot_pitch))
        flanks = (line[half:][::-1] / slot, (line[:half] / slot).conj())
        for flank, edge in enumerate(flanks):
            radius = np.linspace(max(np.abs(edge[0]), wall_radius[0]), np.abs(edge[-1]), 1000)
            if radius[-1] > radius[0]:
                angle = np.interp(radius, np.abs(edge), np.angle(edge))
                gaps[flank, tooth] = (radius * (np.interp(radius, wall_radius, wall_angle) - angle)).min()
    return gaps


@pytest.mark.parametrize(
    "gear",
    [
        drive(),
        drive(eccentricity__magnitude=20e-6, eccentricity__direction=1.0, runout__magnitude=4e-6),
        drive(ratio=-100.0, wave_generator_phase=0.7, arc_offset=5e-6),
        drive(ratio=101.0, output="circular_spline", eccentricity__magnitude=15e-6),
    ],
    ids=["centred", "eccentric", "reversed", "circular spline"],
)
@pytest.mark.parametrize("angle", [0.0, 0.3, -51.7])
def test_in_true_scale_the_teeth_have_the_models_clearances(gear: Drive, angle: float, chords: float) -> None:
    drawn = shapes(gear, angle, torque=0.0, exaggeration=TRUE)
    state = mesh_state(gear, np.array([angle]), np.array([0.0]))
    contact = contacts(gear.mesh, gear.frame.wave_generator_angle(np.array([angle])))
    turned = np.array([1.0, -1.0])[:, None] * state.torsion[0]
    gaps = drawn_gaps(gear, drawn)
    model = state.backlash[0] - turned * np.nanmean(contact.radius)
    engaged = np.isfinite(model) & np.isfinite(gaps) & (model < 60e-6)
    assert engaged.sum() > 80
    np.testing.assert_allclose(gaps[engaged], model[engaged], atol=chords)


def test_loaded_flanks_touch_and_others_do_not(chords: float) -> None:
    gear = drive()
    state = mesh_state(gear, np.array([0.3]), np.array([-40.0]))
    gaps = drawn_gaps(gear, shapes(gear, 0.3, torque=40.0, exaggeration=TRUE))
    load = state.load[0]
    assert (load > 0.0).sum() > 40
    assert gaps[load > 5.0].max() < chords
    assert gaps[load == 0.0][np.isfinite(gaps[load == 0.0])].min() > -chords


def test_deformation_is_exaggerated_from_the_long_axis() -> None:
    geometry = drive().mesh.geometry
    for factor in (1.0, 8.0):
        drawn = shapes(drive(), full_scale=75.0, exaggeration=Exaggeration(factor, 300.0))
        radius = np.abs(points(drawn["wave_generator"]))
        assert radius.max() == pytest.approx(geometry.semi_major, rel=1e-12)
        depth = factor * (geometry.semi_major - geometry.semi_minor)
        assert geometry.semi_major - radius.min() == pytest.approx(depth, rel=1e-9)
        assert all(number in drawn["legend"].text for number in (f"x {factor:g},", "x 300", "75 N"))


def test_long_axis_turns_against_a_positive_input() -> None:
    for angle in (0.0, 0.4, 1.0):
        ends = points(shapes(drive(), angle)["long_axis"])
        assert np.angle(ends[0]) == pytest.approx(-angle, abs=1e-12)
        assert ends[0] + ends[1] == pytest.approx(0.0, abs=1e-12)


def test_arrow_shows_the_displacement_at_this_moment() -> None:
    gear = drive(eccentricity__magnitude=10e-6, eccentricity__direction=1.0, runout__magnitude=4e-6)
    arrow = points(shapes(gear, 0.3, exaggeration=Exaggeration(8.0, 500.0))["eccentricity"])
    expected = 500.0 * (10e-6 * np.exp(1j) + 4e-6 * np.exp(-0.3j))
    assert arrow[:2].tolist() == [0.0, pytest.approx(expected, rel=1e-12)]
    assert (points(shapes(drive())["eccentricity"]) == 0.0).all()


def test_colours_are_viridis() -> None:
    share = np.linspace(0.0, 1.0, 256)
    np.testing.assert_allclose(viridis(share), matplotlib.colormaps["viridis"](share), atol=0.011)
    assert (viridis(np.array([-1.0, 7.0])) == viridis(np.array([0.0, 1.0]))).all()


def test_every_line_is_seen_on_dark_and_light_ground_and_before_the_faces() -> None:
    drawn = shapes(drive())
    for shape in (shape for shape in drawn.values() if shape.kind != "triangle_list"):
        for ground in (48 / 255, 0.07, 1.0):  # RViz, dark Foxglove, white
            assert contrast(shape.colour[:3], (ground,) * 3) > 2.0, shape.name
        if shape.kind.startswith("line"):
            assert drawn["teeth"].points[:, 2].max() < shape.points[:, 2].min(), shape.name


def test_each_flank_has_the_colour_of_its_own_load() -> None:
    gear = drive()
    load = np.zeros((2, 200))
    load[0, 5], load[1, 9], load[0, 12] = 30.0, 60.0, 500.0
    drawn = {shape.name: shape for shape in drawing(gear, 0.3, load[None], full_scale=60.0)}
    outline = points(drawn["flexspline"])[:-1].reshape(200, -1)
    half = outline.shape[1] // 2
    vertices, colours = points(drawn["teeth"]).reshape(200, -1), drawn["teeth"].colours.reshape(200, -1, 4)
    for flank, edge in enumerate((outline[:, half:], outline[:, :half])):
        on_edge = (vertices[:, :, None] == edge[:, None, :]).any(axis=2)
        assert (on_edge.sum(axis=1) == vertices.shape[1] // 2).all()
        expected = np.broadcast_to(viridis(load[flank] / 60.0)[:, None, :], colours.shape)
        np.testing.assert_array_equal(colours[on_edge], expected[on_edge])


def test_triangles_fill_the_teeth_and_face_up() -> None:
    drawn = shapes(drive(), exaggeration=TRUE)
    a, b, c = points(drawn["teeth"]).reshape(-1, 3).T
    areas = 0.5 * ((b - a).conj() * (c - a)).imag
    assert (areas > 0.0).all()
    outline = points(drawn["flexspline"])[:-1].reshape(200, -1)
    whole = 0.5 * (outline.conj() * np.roll(outline, -1, axis=1)).imag.sum(axis=1)
    np.testing.assert_allclose(areas.reshape(200, -1).sum(axis=1), whole, rtol=0.03)


def test_load_of_another_gear_is_refused() -> None:
    with pytest.raises(ValueError, match=r"load: shape \(1, 2, 200\) is needed, got \(1, 2, 160\)"):
        drawing(drive(), 0.0, np.zeros((1, 2, 160)))


CUP = {"face_width": 11e-3, "cup_length": 0.04, "sections": 3}
TEETH, FRONT, BAND = 200, 24, 30  # vertices of a tooth's face, and of its flanks in one band


def bands(shape: Shape, values: np.ndarray) -> np.ndarray:
    """Values of the bands only, (sections, teeth, vertices, ...)."""
    return values[TEETH * FRONT :].reshape(3, TEETH, BAND, -1)


def test_a_section_is_a_band_of_its_share_of_the_width_in_its_place() -> None:
    gear = drive(**CUP, tilt__magnitude=1e-3, tilt__direction=0.4)
    drawn, geometry = shapes(gear, exaggeration=TRUE), gear.mesh.geometry
    for name in ("circular_spline", "wave_generator"):
        np.testing.assert_allclose(np.unique(drawn[name].points[:, 2]), [-5.5e-3, 5.5e-3], rtol=1e-12)
    found = bands(drawn["teeth"], drawn["teeth"].points)
    z = found[..., 2] - drawn["teeth"].points[0, 2] + 5.5e-3  # faces lie slightly below the lines
    np.testing.assert_allclose(np.ptp(z, axis=(1, 2)), 11e-3 * geometry.section_weights, rtol=1e-12)
    np.testing.assert_allclose(z.max(axis=(1, 2))[:-1], z.min(axis=(1, 2))[1:], rtol=1e-12)
    places = geometry.section_places
    assert np.all((z.min(axis=(1, 2)) <= places) & (places <= z.max(axis=(1, 2))))
    plane = drive()  # in the middle section the cup has its nominal curve
    mesh = dataclasses.replace(plane.mesh, eccentricity=gear.mesh.tilt * places[1])
    alone = dataclasses.replace(plane, mesh=mesh)
    state = mesh_state(gear, np.array([0.3]), gear.frame.cup_torque(np.array([40.0])))
    torsion = float(state.torsion[0])
    flat = drawing(alone, 0.3, np.zeros((1, 2, TEETH)), torsion=torsion, exaggeration=TRUE)
    (outline,) = (shape.points[:-1].reshape(TEETH, -1, 3) for shape in flat if shape.name == "flexspline")
    near = np.abs(found[1, :, :, None, :2] - outline[:, None, :, :2]).max(axis=-1).min(axis=-1)
    assert near.max() < 1e-12


def test_a_band_has_the_colour_of_its_section_s_load_over_its_share() -> None:
    gear = drive(**CUP)
    load = np.zeros((3, 2, TEETH))
    load[0, 0, 5], load[2, 1, 9] = 4.0, 6.0
    drawn = {shape.name: shape for shape in drawing(gear, 0.3, load, full_scale=60.0)}
    colours, share = bands(drawn["teeth"], drawn["teeth"].colours), gear.mesh.geometry.section_weights
    dark = viridis(np.zeros(1))[0]
    for section, flank, tooth in ((0, 0, 5), (2, 1, 9)):
        bright = viridis(load[section, flank, [tooth]] / share[section] / 60.0)[0]
        own = colours[section, tooth]
        assert ((own == bright).all(axis=-1) | (own == dark).all(axis=-1)).all()
        assert (own == bright).all(axis=-1).sum() == BAND // 2
    coloured = (colours != dark).any(axis=(2, 3))
    assert np.argwhere(coloured).tolist() == [[0, 5], [2, 9]]
    front = drawn["teeth"].colours[: TEETH * FRONT].reshape(TEETH, FRONT, 4)
    assert np.flatnonzero((front != dark).any(axis=(1, 2))).tolist() == [9]  # the open end's section


def test_bands_face_outwards() -> None:
    teeth = shapes(drive(**CUP), exaggeration=TRUE)["teeth"]
    found = bands(teeth, teeth.points).reshape(3, TEETH, -1, 3, 3)
    normal = np.cross(found[..., 1, :] - found[..., 0, :], found[..., 2, :] - found[..., 0, :])
    centre = found.mean(axis=(2, 3), keepdims=True)
    outward = ((found - centre).mean(axis=3) * normal).sum(axis=-1)
    assert (outward > 0.0).all()


def same(found_markers: list, drawn: dict[str, Shape]) -> None:
    assert [marker.ns for marker in found_markers] == NAMES == list(drawn)
    kinds = {"line_strip": 4, "line_list": 5, "text": 9, "triangle_list": 11}  # visualization_msgs/Marker
    for marker, shape in zip(found_markers, drawn.values(), strict=True):
        own = (marker.type, marker.action, marker.text, marker.header.frame_id, marker.pose.orientation.w)
        assert own == (kinds[shape.kind], 0, shape.text, "gear", 1.0)
        assert (marker.header.stamp.sec, marker.header.stamp.nanosec) == divmod(STAMP, 10**9)
        if shape.kind == "text":
            assert (marker.pose.position.y, marker.scale.z) == (shape.points[0, 1], shape.size)
            continue
        found = np.array([(p.x, p.y, p.z) for p in marker.points])
        assert np.isfinite(found).all()
        np.testing.assert_array_equal(found, shape.points)
        colours = np.array([(c.r, c.g, c.b, c.a) for c in marker.colors], np.float32).reshape(-1, 4)
        expected = np.empty((0, 4)) if shape.colours is None else shape.colours
        np.testing.assert_array_equal(colours, expected.astype(np.float32))
        assert marker.scale.x > 0.0


@pytest.mark.parametrize("gear", [drive(eccentricity__magnitude=20e-6), drive(**CUP)], ids=["plane", "cup"])
def test_rosbags_reads_what_was_drawn(gear: Drive) -> None:
    drawn = shapes(gear, 2.0)
    data = marker_array(list(drawn.values()), STAMP, "gear")
    message = jazzy().deserialize_cdr(data, MARKERS)
    same(message.markers, drawn)
    assert serialize(message, MARKERS) == data
