"""Series from rows: which values belong to which, and what a cause that was not seen counts as."""

import math
from typing import Any

import fleet_tasks
import numpy as np
from numpy.testing import assert_allclose

from hd_diag.fleet.rows import Row
from hd_diag.fleet.series import Series, classes, series_of


def row(day: int, joint: str = "joint_1", robot: str | None = None, **given: Any) -> Row:
    start = fleet_tasks.BEGIN + day * fleet_tasks.DAY
    own = {"bag": f"{day}.mcap", "robot": robot, "start": start, "joint": joint}
    return {**fleet_tasks.row(1e-6 * (1 + day)), **own, **given}


def named(name: str, *alike: str, size: float | None = 3e-6) -> dict[str, Any]:
    return {
        "causes": [name],
        "cause_classes": [[name, *alike]],
        "cause_amplitudes_rad": [size],
        "cause_amplitude_stds_rad": [None if size is None else 1e-7],
        "tested": [],
        "tested_least_rad": [],
    }


def by_quantity(rows: list[Row], **limits: float) -> dict[str, Series]:
    return {s.quantity: s for s in series_of(rows, {("joint_1", k): v for k, v in limits.items()})}


def test_values_in_order_of_time_with_their_deviations() -> None:
    found = by_quantity([row(day) for day in (2, 0, 1)])
    assert set(found) == {"eccentricity", "transmission_error", "residual_nominal", "residual_refit"}
    residual = found["residual_refit"]
    assert_allclose(np.diff(residual.time), 86_400.0)
    assert_allclose(residual.value, [1e-6, 2e-6, 3e-6])
    assert_allclose(residual.std / residual.value, 0.04 / 2 / 1.96, rtol=1e-4)
    assert_allclose(found["eccentricity"].std, 1e-7)
    assert math.isnan(residual.limit)


def test_joints_and_robots_are_kept_apart() -> None:
    rows = [row(0), row(0, "joint_2"), row(1, robot="a"), row(1, robot="b")]
    found = [(s.robot, s.joint) for s in series_of(rows, {}) if s.quantity == "eccentricity"]
    assert found == [("", "joint_1"), ("", "joint_2"), ("a", "joint_1"), ("b", "joint_1")]


def test_what_could_not_be_judged_is_no_value() -> None:
    rows = [row(0), row(1, trustworthy=False), {"bag": "x", "start": 5, "joint": None, "error": "broken"}]
    rows += [{"bag": "y", "start": None, "joint": "joint_1", "error": "empty"}]
    rows += [row(2, rms_nominal_rad=None)]
    found = by_quantity(rows)
    assert [found[q].value.size for q in ("eccentricity", "residual_nominal")] == [1, 2]


def test_a_cause_that_was_not_found_is_below_what_would_have_been() -> None:
    rows = [row(0), row(1, **named("hysteresis")), row(2, tested=[], tested_least_rad=[])]
    found = by_quantity(rows)["hysteresis"]
    assert_allclose(found.value, [0.0, 3e-6])
    assert_allclose(found.std, [0.5e-6, 1e-7])


def test_causes_that_a_record_cannot_tell_apart_are_one() -> None:
    rows = [row(0, **named("output_runout", "output_encoder_eccentricity"))]
    rows += [row(1, **named("output_encoder_eccentricity", size=4e-6))]
    found = by_quantity(rows, output_runout=1e-5)
    both = found["output_encoder_eccentricity or output_runout"]
    assert_allclose(both.value, [3e-6, 4e-6])
    assert both.limit == 1e-5


def test_a_finding_without_amplitude_is_no_series() -> None:
    assert "tooth_skip" not in by_quantity([row(0, **named("tooth_skip", size=None))])


def test_classes_join_where_they_touch() -> None:
    assert classes([[["a", "b"]], [["c"]], [["d", "c"], ["b", "e"]]]) == [frozenset("abe"), frozenset("cd")]
