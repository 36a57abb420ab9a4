"""Parameters of a joint that its file does not give: from a catalogue page, or scaled with the drive.

The defaults of the table are those of the example drive. With a page in the section ``gear`` the parameters
of the drive come from the page (:mod:`hd_diag.gears`). Limits and tolerances always scale with the drive.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import fields, replace
from functools import lru_cache

from hd_diag.config.configured_drive import drive_from, geometry_parameters
from hd_diag.config.parameters import JOINT_PARAMETERS, LIMITS, Value
from hd_diag.drive import Drive
from hd_diag.formatting import rounded
from hd_diag.gears import catalogue, page_fit
from hd_diag.gears.characteristics import MeshOverTurn, slot_phases
from hd_diag.gears.page import T1_SHARE, T2_SHARE, TENTH_OF_AN_INCH, Page
from hd_diag.gears.page_fit import Width
from hd_diag.gears.similarity import LEAST_TEETH, SECTIONS, similar
from hd_diag.model.cams import CAMS
from hd_diag.model.mesh import Mesh

DEFAULTS: Mapping[str, Value] = {p.name: p.default for p in JOINT_PARAMETERS}
EXAMPLE = drive_from(DEFAULTS)
_EXAMPLE_SIZE = 25.0
_UNITS = {p.name.removeprefix("gear."): p.unit for p in JOINT_PARAMETERS if p.name.startswith("gear.")}
_CHECKED = {"k1", "k2", "k3", "t1", "t2"}  # scale with the size

# Force on a flank over torque. With more load, more pairs share it: between drives of sizes 8 to 65 and
# ratios 50 to 160 the largest force goes with the torque to this power, within 10 %.
_SHARING = 2.0 / 3.0

# Torsional compliance of the example drive at its rated torque, all of it in the teeth [rad/(N m)].
_COMPLIANCE = 1.75e-5

# Amplitude of order 2 [rad] per eccentricity over the pitch circle's radius, at the torque where it is
# largest: 0.18 to 0.21 between the same drives. Then the share of it that may be the model's own error.
_ERROR_OF_ECCENTRICITY = 0.19
_MODEL_SHARE = 0.25


def joint_values(given: Mapping[str, Value], teeth: bool = True) -> tuple[dict[str, Value], dict[str, Value]]:
    """All parameters of a joint from those given, by their names within it; and those that were given.

    If a page is given, values equal to the page's own follow the page and do not count as given, because a
    file written from a page may hold all of them. `teeth` as for `drive_from`. Raises ValueError naming what
    is impossible.
    """
    page = page_of(given)
    _check_shape(given)
    values = dict(DEFAULTS)
    if page:
        usual = usual_width(page)
        values |= resolved(page, tuple((n, given[n]) for n in usual if given.get(n, usual[n]) != usual[n]))
        values |= usual
    elif given.get("face_width"):
        values["sections"] = SECTIONS
    drive = drive_from({**values, **given}, teeth)
    values |= scaled(drive)
    # Raise limits by the overlap at rest, from the page's curve or a cup's coning: an assembly adds to it.
    if page or (drive.mesh.geometry.cup_length and drive.mesh.geometry.sections > 1):
        values |= {name: rounded(values[name] + rest) for name, rest in _at_rest(drive.mesh).items()}
    for name in LIMITS:  # if only an error limit is given, its warning limit must not be above it
        warn, error = f"limits.{name}.warn", f"limits.{name}.error"
        values[warn] = min(values[warn], {**values, **given}[error])
    kept = {name: value for name, value in given.items() if not page or values[name] != value}
    return {**values, **given}, kept


def _check_shape(given: Mapping[str, Value]) -> None:
    """Refuse numbers of other cams if no shape is given, because the default ellipse would ignore them."""
    own = [f"neutral_curve.{field.name}" for field in fields(CAMS[DEFAULTS["neutral_curve.shape"]])]
    for name in given if "neutral_curve.shape" not in given else ():
        if name.startswith("neutral_curve.") and name not in own:
            raise ValueError(f"{name}: needs neutral_curve.shape, one of {', '.join(CAMS)}")


def page_of(given: Mapping[str, Value]) -> Page | None:
    """The page in the section ``gear``, None without one; raises ValueError naming what it lacks."""
    values = {**DEFAULTS, **given}
    if not any(values[f"gear.{name}"] for name in ("size", *Page._fields[:-1])):
        return None
    size, diameter = values["gear.size"], values["gear.pitch_diameter"]
    found = {name: values[f"gear.{name}"] for name in Page._fields[:-1]}
    for name in ("ratio", "rated_torque"):
        found[name] = found[name] or given.get(name, 0.0)
    found["t1"] = found["t1"] or T1_SHARE * found["rated_torque"]
    found["t2"] = found["t2"] or T2_SHARE * found["rated_torque"]
    found["pitch_diameter"] = diameter or size * TENTH_OF_AN_INCH
    for name, value in found.items():
        if value == 0.0 and name != "lost_motion":
            wanted = "size or gear.pitch_diameter" if name == "pitch_diameter" else name
            needed = f"a drive from its catalogue page needs it [{_UNITS[name]}]"
            raise ValueError(f"gear.{wanted}: missing; {needed}")
    if not found["t1"] < found["t2"]:
        raise ValueError(f"gear.t1 ({found['t1']:g} N m) must be below gear.t2 ({found['t2']:g} N m)")
    if 2.0 * abs(found["ratio"]) >= LEAST_TEETH:  # others are refused later for their teeth
        _check_units(found, {name for name in found if values[f"gear.{name}"]})
    return Page(**found, output=str(values["output"]))


def _check_units(page: Mapping[str, float], given: Set[str]) -> None:
    """Refuse a stiffness or torque that no gear of the size has."""
    for name in sorted(_CHECKED & given):
        size = page["pitch_diameter"] / TENTH_OF_AN_INCH
        try:
            catalogue.check(name, page[name], _UNITS[name], size, page["ratio"])
        except ValueError as error:
            raise ValueError(f"gear.{name}: {error}") from error


def usual_width(page: Page) -> dict[str, Value]:
    """Usual width of the teeth, length of the cup, and number of sections, which pages do not give."""
    geometry = similar(EXAMPLE.mesh.geometry, _scale(page), EXAMPLE.mesh.geometry.flexspline_teeth)
    return {name: getattr(geometry, name) for name in ("face_width", "cup_length", "sections")}


def _scale(page: Page) -> float:
    return page.pitch_diameter / (_EXAMPLE_SIZE * TENTH_OF_AN_INCH)


@lru_cache(maxsize=256)
def resolved(page: Page, width: Width = ()) -> dict[str, Value]:
    """Parameters of a page's drive; raises ValueError with the reason if there is none.

    `width` holds known values of the width, see :func:`hd_diag.gears.page_fit.of_page`.
    """
    flexspline = page.output == "flexspline"
    slots = 2.0 * abs(page.ratio) + (2.0 if flexspline else 0.0)
    if slots % 2.0:
        raise ValueError(
            f"gear.ratio: {page.ratio:g} is not a whole number, as two more teeth on the circular spline give"
        )
    try:
        _, mesh, cup = page_fit.of_page(EXAMPLE.mesh, _scale(page), int(slots) - 2, page, width)
    except ValueError as error:
        raise ValueError(f"gear: {error}") from error
    own: dict[str, Value] = {"ratio": page.ratio, "rated_torque": page.rated_torque}
    compliances = {"tooth_compliance": mesh.tooth_compliance, "cup_compliance": cup}
    return {**own, **geometry_parameters(mesh.geometry), **compliances}


def scaled(drive: Drive) -> dict[str, Value]:
    """Limits and tolerances for a drive: the example drive's, scaled with size and torque."""
    factors = _factors(drive)
    own = {p.name: (DEFAULTS[p.name], factors[p.scale]) for p in JOINT_PARAMETERS if p.scale}
    return {name: value if k == 1.0 else rounded(value * k) for name, (value, k) in own.items()}


@lru_cache(maxsize=256)
def _at_rest(mesh: Mesh) -> Mapping[str, float]:
    """Overlap of teeth and lobes as built, without torque [m], by the names of their limits."""
    perfect = replace(mesh, eccentricity=0.0, runout=0.0, tilt=0.0)
    teeth = MeshOverTurn(perfect, slot_phases(mesh.geometry))
    overlap, interference = max(teeth.overlap(), 0.0), max(-teeth.least_backlash(), 0.0)
    limits = ("limits.overlap.warn", "limits.overlap.error", "tolerance.limits.overlap")
    return {**dict.fromkeys(limits, overlap), "tolerance.limits.interference": interference}


def _factors(drive: Drive) -> dict[str, float]:
    """Factors of a drive over the example drive, by the names of the table's column ``scale``."""

    def numbers(each: Drive) -> tuple[float, ...]:
        geometry = each.mesh.geometry
        return (
            geometry.module,
            geometry.curve.radius,
            each.mesh.tooth_compliance,
            each.rated_torque,
            float(geometry.flexspline_teeth),
            each.accuracy,
        )

    module, radius, compliance, torque, teeth, accuracy = (
        own / example for own, example in zip(numbers(drive), numbers(EXAMPLE), strict=True)
    )
    load = torque * compliance / (teeth * radius * module)
    of_teeth = compliance / (teeth * radius**2) * load ** (_SHARING - 1.0)  # more load: more pairs share
    force = module / compliance * load**_SHARING
    return {
        "module": module,
        "radius": radius,
        "force": force,
        "preload": force * compliance,
        "accuracy": accuracy,
        "error": max(accuracy, _model_error(drive) / DEFAULTS["limits.residual_order.warn"]),
        "compliance": of_teeth + drive.cup_compliance / _COMPLIANCE,
    }


def _model_error(drive: Drive) -> float:
    """Amplitude of the model's possible error at the configured eccentricity [rad]."""
    share = abs(drive.mesh.eccentricity) / drive.mesh.geometry.curve.radius
    return _MODEL_SHARE * _ERROR_OF_ECCENTRICITY * share
