"""Rows of the fleet's table: bags and joints, fields kept of a diagnosis, rows as time series."""

import hashlib
import math
import os
from pathlib import Path
from typing import Any

import fleet_tasks
import numpy as np
import pytest
from benches import EFFECTS, bench, of, solved
from numpy.testing import assert_allclose
from test_verdict import SKIP, diagnosis

from hd_diag.config.configuration import resolve
from hd_diag.diagnosis.findings import Finding
from hd_diag.fleet.rows import Row, amplitude_std, judged
from hd_diag.fleet.run import find_bags, survey, tasks
from hd_diag.fleet.series import Series, classes, series_of

ENCODER, HYSTERESIS, BEARING = (
    EFFECTS[name] for name in ("input_encoder_eccentricity", "hysteresis", "bearing_passage")
)


def test_a_finding_about_the_signals_is_no_cause() -> None:
    """Causes, amplitudes and their deviations have the same number."""
    found = diagnosis(findings=(Finding("clock_set_back", "the clock was set back", 1.0, "-", False), SKIP))
    told = judged(found, "joint_1")
    lengths = [len(told[f"cause_amplitude{end}"]) for end in ("s_rad", "_stds_rad")]
    assert (told["causes"], lengths, len(told["findings"])) == (["tooth_skip"], [1, 1], 2)


def test_the_deviation_of_an_amplitude_is_that_of_drawn_coefficients() -> None:
    """Causes without nonlinear values, with nonlinear values, and with columns that wander."""
    made = bench(of(ENCODER, amplitude=1e-3, direction=0.5, second_amplitude=0.0, second_direction=0.0))
    chosen = tuple((effect, tuple(made.data.grid(effect)[-1])) for effect in (ENCODER, HYSTERESIS, BEARING))
    rng = np.random.default_rng(0)
    found = solved(made, *chosen).causes
    assert {cause.covariance.shape[0] > cause.coefficients.size for cause in found} == {False, True}
    for cause in found:
        own = slice(cause.coefficients.size)
        columns = made.columns(cause.effect, cause.nonlinear)[:, own]
        big = 1e3 * cause.coefficients  # far from zero, where the first order holds
        drawn = rng.multivariate_normal(big, cause.covariance[own, own], 1000)
        expected = np.std(np.std(columns @ drawn.T, axis=0))
        assert amplitude_std(made, cause) == pytest.approx(expected, rel=0.15), cause.effect.name


# Bags and joints ---


def test_bags_in_folders_at_any_depth_each_once(tmp_path: Path) -> None:
    """A folder with metadata is one bag, whatever it contains; circular links are not followed."""
    names = "b/2.mcap b/10.db3 a/metadata.yaml a/a_0.mcap a/deep/x.mcap notes.txt z.mcap"
    for path in map(tmp_path.joinpath, names.split()):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    (tmp_path / "b" / "loop").symlink_to(tmp_path)
    (tmp_path / "again.mcap").symlink_to(tmp_path / "b" / "2.mcap")
    found = find_bags([tmp_path, tmp_path / "z.mcap", tmp_path / "none.mcap"])
    expected = "again.mcap z.mcap a b/10.db3 none.mcap"
    assert [str(path.relative_to(tmp_path)) for path in found] == expected.split()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may list every folder")
def test_a_folder_that_cannot_be_listed_is_reported(tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0)
    assert find_bags([tmp_path]) == [closed]
    assert "Permission denied" in survey(str(closed)).error


def test_a_survey_and_the_tasks_of_the_joints_that_a_bag_holds(tmp_path: Path) -> None:
    """One of two angles is enough for a task, which reports why the joint is not judged."""
    names = ("joint_2", "joint_3", "joint_3_motor")
    path = fleet_tasks.small_bag(tmp_path / "a.mcap", 3, names)
    seen = survey(str(path))
    assert (seen.error, seen.messages, seen.problems, seen.names) == ("", 12, (), set(names))
    assert seen.start == fleet_tasks.BEGIN + 3 * fleet_tasks.DAY
    assert seen.digest == hashlib.sha256(hashlib.sha256(path.read_bytes()).digest()).hexdigest()
    config = resolve({"joints": ["joint_1", "joint_2", "joint_3"]})
    assert [task.joint.name for task in tasks(seen, config, config.joints)] == ["joint_2", "joint_3"]


def test_the_key_of_a_result_is_what_it_depends_on(tmp_path: Path) -> None:
    first = survey(str(fleet_tasks.small_bag(tmp_path / "a.mcap")))
    renamed = survey(str((tmp_path / "a.mcap").rename(tmp_path / "b.mcap")))
    other = survey(str(fleet_tasks.small_bag(tmp_path / "c.mcap", 1)))

    def key(seen=first, **values) -> str:
        config = resolve({f"joint_1.{name.replace('__', '.')}": value for name, value in values.items()})
        return tasks(seen, config, config.joints)[0].key

    assert key(renamed) == key(limits__residual_rms__error=1e-3) == key()
    turned = key(output_joint="joint_1_motor", input_joint="joint_1")
    assert len({key(), key(other), key(torque=1.0), key(eccentricity__magnitude=1e-6), turned}) == 5


# Series ---


def row(day: int, joint: str = "joint_1", robot: str | None = None, **given: Any) -> Row:
    start = fleet_tasks.BEGIN + day * fleet_tasks.DAY
    own = {"bag": f"{day}.mcap", "robot": robot, "start": start, "joint": joint}
    own |= {"tested": ["hysteresis"], "tested_least_rad": [1e-6]}
    return fleet_tasks.row(residual=1e-6 * (1 + day), **(own | given))


def named(name: str, *alike: str, size: float | None = 3e-6) -> dict[str, Any]:
    amplitude = {"cause_amplitudes_rad": [size], "cause_amplitude_stds_rad": [None if size is None else 1e-7]}
    cause = {"causes": [name], "cause_classes": [[name, *alike]]}
    return cause | amplitude | {"tested": [], "tested_least_rad": []}


def by_quantity(rows: list[Row], **limits: float) -> dict[str, Series]:
    return {s.quantity: s for s in series_of(rows, {("joint_1", k): v for k, v in limits.items()})}


def test_values_in_order_of_time_with_their_deviations_by_robot_and_joint() -> None:
    found = by_quantity([row(day) for day in (2, 0, 1)])
    assert set(found) == {"eccentricity", "transmission_error", "residual_nominal", "residual_refit"}
    residual = found["residual_refit"]
    assert_allclose(np.diff(residual.time), 86_400.0)
    assert_allclose(residual.value, [1e-6, 2e-6, 3e-6])
    assert_allclose(residual.std / residual.value, 0.04 / 2 / 1.96, rtol=1e-4)
    assert_allclose(found["eccentricity"].std, 1e-7)
    assert math.isnan(residual.limit)
    rows = [row(0), row(0, "joint_2"), row(1, robot="a"), row(1, robot="b")]
    apart = [(s.robot, s.joint) for s in series_of(rows, {}) if s.quantity == "eccentricity"]
    assert apart == [("", "joint_1"), ("", "joint_2"), ("a", "joint_1"), ("b", "joint_1")]


def test_what_could_not_be_judged_is_no_value() -> None:
    rows = [row(0), row(1, trustworthy=False), {"bag": "x", "start": 5, "joint": None, "error": "broken"}]
    rows += [{"bag": "y", "start": None, "joint": "joint_1", "error": "empty"}]
    rows += [row(2, rms_nominal_rad=None), row(0, **named("tooth_skip", size=None))]
    found = by_quantity(rows)
    assert [found[q].value.size for q in ("eccentricity", "residual_nominal")] == [2, 3]
    assert "tooth_skip" not in found


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
    many = [[["a", "b"]], [["c"]], [["d", "c"], ["b", "e"]]]
    assert classes(many) == [frozenset("abe"), frozenset("cd")]
