"""State of each joint: one rule for green, amber, red and not judged; since when; what is missing."""

from typing import Any

import numpy as np
import pytest
from fleet_tasks import ACCURACY, ALLOWED, BEGIN, WEEK, judged, row

from hd_diag.fleet.series import series_of
from hd_diag.fleet.standing import health
from hd_diag.fleet.summary import as_json, attention_lines, headline, notes
from hd_diag.fleet.trend import trends

REFUSED = {"refused": 1_000, "last_refusal": "its stamp repeats the last"}
CUT = {"problems": ["a.mcap: is cut off or damaged at byte 228680 of 261683"]}
NOT_TOLD = {"error_rad": None, "error_std_rad": None}
GREY = {"judgement": "misfit", "light": "not_judged"}
GREY |= {"advice": "Cannot be judged: the model does not describe this record."}
NEAR = "transmission error 89.0 ± 0.9 arcsec, too near to its limit of 90.0 arcsec to judge"
INSPECT = {"light": "red", "advice": "Inspect: hysteresis (99.0 % sure)."}


def weeks(*given: dict[str, Any], **more: Any) -> list[dict[str, Any]]:
    return [row(**{"start": BEGIN + week * WEEK, **more, **each}) for week, each in enumerate(given)]


@pytest.mark.parametrize(
    ("given", "state", "reason"),
    [
        ({}, "green", None),
        ({"arcsec": 89.0}, "amber", NEAR),
        ({"arcsec": 91.0}, "amber", "too near"),
        ({"arcsec": 92.0}, "red", "transmission error 92.0 ± 0.9 arcsec, beyond its limit of 90.0 arcsec"),
        ({"microns": 9.9}, "amber", "eccentricity 9.90 ± 0.10 µm, too near"),
        ({"microns": 11.0, "arcsec": 89.0}, "red", "eccentricity 11.00 ± 0.10 µm, beyond"),
        ({"error_std_rad": 0.5 * ACCURACY}, "amber", "too near"),
        ({"microns": 20.0, **GREY}, "not_judged", "Cannot be judged: the model does not describe"),
        ({"arcsec": 92.0, **GREY}, "red", "transmission error 92.0"),
        ({"causes": ["hysteresis"], **INSPECT}, "red", "Inspect: hysteresis"),
        ({"arcsec": 89.0, **INSPECT, **CUT}, "red", "Inspect: hysteresis (99.0 % sure); the bag is cut off"),
        ({"light": "amber", "advice": "Watch: a hint"}, "amber", "Watch: a hint"),
        ({"microns": 20.0, "trustworthy": False}, "green", None),
        ({"samples": 9_000, **REFUSED}, "amber", "1000 of 10000 samples are left out, the last because: its"),
        ({"samples": 90_000, **REFUSED}, "green", None),
        (CUT, "amber", "the bag is cut off or damaged at byte 228680 of 261683"),
        ({"arcsec": 120.0, **CUT}, "red", "beyond"),
        ({"bag_duration_s": 121.0}, "amber", "only 60 of the bag's 121 s hold this joint"),
        ({"bag_duration_s": 119.0}, "green", None),
        ({**NOT_TOLD, "microns": 12.0}, "red", "eccentricity"),
        ({"error": "too short"}, "not_judged", "too short"),
        ({"arcsec": 10.0, "ripple_orders": [2.0]}, "not_judged", "one angle alone"),
    ],
)
def test_the_rule(given: dict[str, Any], state: str, reason: str | None) -> None:
    if "ripple_orders" in given:
        lists = {"ripple_reverses": [False], "ripple_amplitudes_Nm": [0.1], "ripple_stds_Nm": [0.01]}
        given = {**given, **lists, "ripple_found": [True]}
    sizes = [{"cause_amplitudes_rad": [1e-5], "cause_amplitude_stds_rad": [np.nan]}] * ("causes" in given)
    found = judged([row(**{**given, **(sizes[0] if sizes else {})})])
    assert found.rows[0]["state"] == found.standings[0].colour.state == state
    assert found.colours[0].reasons == () if reason is None else reason in "; ".join(found.colours[0].reasons)


def test_what_could_not_be_judged_is_never_green() -> None:
    """The last recording counts, however good the earlier ones were."""
    found = judged(weeks({}, {}, {"error": "too short: 12 usable samples", "error_rad": None}))
    (one,) = found.standings
    assert (one.colour.state, one.count, one.before) == ("not_judged", 1, "green")
    assert [found.fails(least) for least in ("amber", "red")] == [True, False]


def test_since_when() -> None:
    """The start of the last unbroken state; a recording without a judgement does not break it."""
    bad = {"arcsec": 120.0}
    (one,) = judged(weeks(bad, {}, bad, GREY | {"arcsec": 40.0}, bad)).standings
    assert (one.colour.state, one.count, one.before) == ("red", 2, "green")
    assert one.since == pytest.approx((BEGIN + 2 * WEEK) * 1e-9)
    assert [state for _, state in one.history] == ["red", "green", "red", "not_judged", "red"]


def test_joints_are_ordered_worst_first() -> None:
    errors = {1: 30.0, 2: 120.0, 10: 50.0, 4: 89.0, 5: 150.0}
    rows = [row(arcsec, joint=f"joint_{number}") for number, arcsec in errors.items()]
    names = [one.joint for one in judged([*rows, row(joint="joint_3", **NOT_TOLD, **GREY)]).standings]
    assert names == ["joint_5", "joint_2", "joint_3", "joint_4", "joint_10", "joint_1"]


def test_a_limit_of_the_user_goes_before_the_gears() -> None:
    rows = [row(60.0)]
    limits = {("joint_1", "transmission_error"): 0.5 * ACCURACY, ("joint_1", "residual_refit"): 1e-7}
    found = health(rows, trends(series_of(rows, limits), np.random.default_rng(0)), limits)
    assert found.rows[0]["state"] == "red"
    assert [reason.split()[0] for reason in found.colours[0].reasons] == ["transmission", "residual"]
    assert all(one.limit != ALLOWED for one in found.colours[0].limited)


def test_a_bag_cut_off_or_without_a_joint_matters_until_the_next_recording() -> None:
    assert judged(weeks({}, CUT)).fails("amber")
    assert not judged(weeks(CUT, {})).fails("amber")
    assert headline(judged(weeks({}, CUT))).endswith("Of the bags: 1 cut off.")
    broken = {"bag": "b.mcap", "robot": None, "error": "holds no topic"}
    late, early = {**broken, "start": BEGIN + WEEK}, {**broken, "start": BEGIN - WEEK}
    assert judged([row(), broken]).fails("amber")
    assert judged([row(), late]).fails("amber")
    assert not judged([row(), early]).fails("amber")
    assert "1 without a joint that could be judged" in headline(judged([row(), late]))
    assert headline(judged([row(), early])) == (
        "Of 1 joint: 1 green. Changes over time: cannot tell yet: needs 11 bags, has 1."
    )


def test_refused_samples_are_told() -> None:
    some, many = {"samples": 90_000, **REFUSED}, {"samples": 9_000, **REFUSED}
    assert [one["refused"] for one in as_json("t", judged(weeks({}, some)))["refused"]] == [1_000]
    found = judged(weeks({}, many))
    assert headline(found).endswith("Of the bags: 1 with samples left out.")
    assert any("1000 of 10000 samples" in line for line in attention_lines(found.rows[-1], found.colours[-1]))


def test_recordings_of_one_joint_at_the_same_time_are_of_several_robots() -> None:
    other = {"start": BEGIN + 30 * 10**9, "bag": "b.mcap", "bag_sha256": "b"}
    assert "of several robots" in notes(judged([row(), row(**other)]))[0]
    assert notes(judged([row(), row(**{**other, "bag_sha256": row()["bag_sha256"]})])) == []
    assert notes(judged([row(), row(**{**other, "robot": "arm_2"})])) == []
    assert notes(judged([row(), row(**{**other, "start": BEGIN + 61 * 10**9})])) == []
