"""Fault codes: each is raised, reported and cleared; the numbers behind them."""

import numpy as np
import pytest
from live import MS, RATIO, START, config, states
from numpy.testing import assert_allclose

from hd_diag.drive import MeshState, mesh_state, transmission_error
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.publications import Status
from hd_diag.replay.map_builder import map_of

NAMES = ("joint_1_motor", "joint_1")
SECOND = 1000 * MS
# Limits that the joint keeps even where the tests overload it.
QUIET = {f"joint_1__limits__peak_tooth_load__{level}": 1e3 for level in ("warn", "error")}
QUIET["array_rate"] = 0.0
WRITING = {"log_state": "writing x", "latency_p99_us": "81.5"}


class Life:
    """A joint that turns at 1 kHz, and its reports."""

    def __init__(self, **given: object) -> None:
        self.monitor = Monitor(config(**QUIET | given))
        self.now, self.angle = START, 0.0

    def take(self, stamps: np.ndarray, *columns: object) -> None:
        """Feed samples: input angles, output angles and torques, each a scalar or one value per sample."""
        angle, output, torque = (np.broadcast_to(column, stamps.shape) for column in columns)
        effort = np.stack((0.0 * torque, torque), axis=1)
        made = states(NAMES, stamps, np.stack((angle, output), axis=1), effort)
        self.monitor.mixed_states(stamps, (made,))

    def run(self, samples=50, torque=(1.0,), step=0.01, wobble=0.0, broken=0) -> None:
        """Feed samples with a constant step of angle [rad] and cycled torques; the first `broken` are nan."""
        number = np.arange(samples)
        stamps, angle = self.now + MS * (1 + number), self.angle + step * (1 + number)
        output = angle / RATIO + wobble * (-1.0) ** number
        self.take(stamps, np.where(number < broken, np.nan, angle), output, np.resize(torque, samples))
        self.now, self.angle = int(stamps[-1]), float(angle[-1])

    def report(self, after: int = MS, **facts: str) -> Status:
        self.now += after
        return self.monitor.tick(self.now, self.now, WRITING | facts).statuses[0]

    def missed(self, stamps: np.ndarray) -> int:
        self.take(stamps, 0.0, 0.0, 0.0)
        return int(self.report().values["samples_missed"])


@pytest.fixture
def life() -> Life:
    return Life()


def code(status: Status) -> tuple[str, int]:
    return status.values["fault_code"], status.level


# Every fault code: limits that a healthy joint exceeds or how it runs, and its silence [s].
CAUSES = [
    ("STALE", {}, {"silent": 1.0}, 1, "no valid sample for 1.0 s: its input arrives no more"),
    ("STALE", {}, {"silent": 3.0}, 2, "no valid sample for 3.0 s: its input arrives no more"),
    ("INPUT_INVALID", {}, {"broken": 5}, 1, "5 samples rejected: input angle of joint_1_motor is nan"),
    ("INPUT_INVALID", {}, {"broken": 30}, 2, "30 samples rejected: input angle of joint_1_motor is nan"),
    ("INPUT_INVALID OUT_OF_RANGE", {}, {"torque": 123.2, "broken": 30}, 2, "30 samples rejected"),
    ("OUT_OF_RANGE", {}, {"torque": -123.2}, 1, "torque is 2.20 times the rated torque"),
    ("OUT_OF_RANGE", {}, {"torque": 224.0}, 2, "torque is 4.00 times the rated torque"),
    ("RESIDUAL", {}, {"wobble": 2e-4}, 1, "residual 41."),
    ("RESIDUAL", {}, {"wobble": 6e-4}, 2, "residual 123."),
    ("INTERFERENCE", {"overlap__warn": -1.0}, {}, 1, "the lobes overlap by"),
    ("INTERFERENCE", {"overlap__warn": -1.0, "overlap__error": -1.0}, {}, 2, "the lobes overlap by"),
    ("LOAD_CONCENTRATION", {"peak_tooth_load__warn": 0.0}, {}, 1, "peak tooth load "),
    (
        "LOAD_CONCENTRATION",
        {"load_concentration__warn": 1.0, "load_concentration__error": 1.0},
        {},
        2,
        "peak ",
    ),
    ("LOAD_CONCENTRATION", {"load_concentration__warn": 1.0, "peak_tooth_load__warn": 0.0}, {}, 1, "peak "),
]


@pytest.mark.parametrize("is_log_failed", [False, True])
@pytest.mark.parametrize(("codes", "limits", "how", "level", "message"), CAUSES)
def test_a_fault_is_raised_and_cleared(life: Life, codes, limits, how, level, message, is_log_failed) -> None:
    """The worst fault is reported, before warnings and errors of the log."""
    log = {"log_state": "failed: disk full", "log_warning": "old.mcap cannot be deleted"}
    life.monitor.configure(config(**QUIET | {f"joint_1__limits__{name}": x for name, x in limits.items()}))
    life.run(**{name: value for name, value in how.items() if name != "silent"})
    after = MS + int(how.get("silent", 0.0) * SECOND)
    status = life.report(after, **(log if is_log_failed else {}))
    assert code(status) == (codes.split()[0], level)
    assert status.values["fault_codes"] == codes + " LOG_FAILED" * is_log_failed
    assert status.message.startswith(message)
    told = "; log failed: disk full; log: old.mcap cannot be deleted"
    assert status.message.endswith(told) == is_log_failed
    life.monitor.configure(config(**QUIET))
    life.run()
    status = life.report()
    assert (code(status), status.message, status.name) == (("OK", 0), "OK", "hd_diag: joint_1")


def test_a_joint_that_never_spoke_is_stale_from_the_first_report_on(life: Life) -> None:
    reports = [life.report(after=after) for after in (MS, SECOND, SECOND + SECOND // 2)]
    assert [code(report) for report in reports] == [("OK", 0), ("STALE", 1), ("STALE", 2)]


def test_a_joint_whose_input_stopped_is_stale_though_its_output_goes_on(life: Life) -> None:
    life.run()
    stamps = life.now + MS * np.arange(1, 1001)
    life.monitor.mixed_states(stamps, (states(("joint_1",), stamps, np.zeros(1000), np.ones(1000)),))
    assert code(life.report(after=SECOND)) == ("STALE", 1)


MOTORS = {"joint_1__input__topic": "motors", "joint_1__input__name": "m1"}
NOWHERE = "no message has position of motors; m1 does not arrive; the names that do are joint_1_mot"
ABSENT = [
    ({"joint_1_mot": 0.0}, {}, "joint_1_motor does not arrive; the nearest name that does is joint_1_mot"),
    ({"tail": 0.0, "a\nb": 0.0}, {}, "joint_1_motor does not arrive; the names that do are tail, a\\nb"),
    ({"joint_1_motor": np.nan}, {}, "what comes is rejected: input angle of joint_1_motor is nan"),
    ({}, {}, "joint_1_motor does not arrive; the names that do are none"),
    ({"joint_1_mot": 0.0}, MOTORS, NOWHERE),
]


@pytest.mark.parametrize(("position", "given", "why"), ABSENT, ids=[why for *_, why in ABSENT])
def test_a_stale_joint_says_what_arrives_in_its_place(position, given: dict[str, str], why: str) -> None:
    """The arrival may lie in the last report's time or in the two before it."""
    life = Life(**{f"joint_1__limits__rejected__{level}": 1.0 for level in ("warn", "error")}, **given)
    life.report()
    life.now += SECOND
    made = states([*position], [life.now], [list(position.values())])
    life.monitor.mixed_states(np.array([life.now]), (made,))
    for _ in range(1 if np.nan in position.values() else 3):
        status = life.report()
        assert code(status) == ("STALE", 1)
        assert status.message.partition(" s: ")[2] == why


def test_a_velocity_without_its_output_is_told(life: Life) -> None:
    life = Life(joint_1__input="velocity")
    life.report()
    life.now += SECOND
    made = states(["joint_1"], [life.now], None, None, [[1.0]])
    made = made._replace(signals=made.velocity, keys=("joint_1.input",))
    life.monitor.mixed_states(np.array([life.now]), (made,))
    said = "its velocity arrives, but no angle of the output to begin its integral from"
    assert life.report().message.endswith(said)


EFFORTS = [([0.0], "is zero throughout"), ([np.nan], "is not a number throughout"), ([12.0], "")]
EFFORTS += [([5e-324, -5e-324], "is never beyond 4.94e-324 N m"), ([999.0], "is 999 N m throughout")]


@pytest.mark.parametrize(("effort", "said"), [*EFFORTS, ([0.0, 0.2], "")])
def test_a_torque_that_nothing_measured_is_told(effort: list[float], said: str) -> None:
    """The report waits until the joint turns: at rest a torque may be zero."""
    life = Life(joint_1__limits__torque__warn=100.0, joint_1__limits__torque__error=100.0)
    life.run(8, effort, step=0.4)
    assert life.report().values["torque_not_measured"] == ""
    life.run(16, effort, step=0.4, wobble=0.1)
    status = life.report()
    assert status.values["torque_not_measured"] == said
    assert "measured error is not the predicted one" in status.message
    assert (f"no torque is measured: it {said}" in status.message) == bool(said)


@pytest.mark.parametrize("value", [0.0, -1.5])
def test_values_of_a_second_publisher_are_told_while_they_come(value: float) -> None:
    life = Life()
    stamps, angle = START + MS * np.arange(300), 20.0 + 0.01 * np.arange(300)
    own, other = (stamps, angle, 0.01 * angle, 0.1 * angle), (stamps[::20] + MS // 2, value, value, 0.0)
    behind = 1 + np.arange(0, 300, 20)
    life.take(*(np.insert(column, behind, each) for column, each in zip(own, other, strict=True)))
    life.now = int(stamps[-1])
    status = life.report()
    assert "INPUT_INVALID" in status.values["fault_codes"].split()
    assert (status.level > 1) == (value != 0.0), "these two angles do not belong together: RESIDUAL too"
    place = value % (2.0 * np.pi)  # the output stays within a turn
    assert f"15 rows with input {value:g} rad and output {place:g} rad" in status.message
    life.angle = 23.0
    life.run()
    assert "second publisher" not in life.report().message


def test_numbers_are_those_of_the_drive(life: Life) -> None:
    joint = life.monitor.config.joints[0]
    drive, table = joint.drive, map_of(joint)
    before = life.report().values
    assert (before["prediction"], before["prediction_error_bound_arcsec"]) == ("exact", "0")
    life.monitor.use_map("joint_1", table)
    life.run(torque=30.0, step=0.02)
    values = life.report().values
    state = mesh_state(drive, np.array([1.0]), np.array([-30.0]))
    turn = transmission_error(drive, np.linspace(0.0, 2.0 * np.pi, 4000), np.full(4000, 30.0))
    assert values["loaded_pairs"] == str(state.loaded_pairs[0])
    expected = {
        "minimum_backlash_um": state.minimum_backlash[0] * 1e6,
        "peak_tooth_load_N": state.peak_load[0],
        "load_concentration": state.load_concentration[0],
        "lost_motion_arcmin": state.lost_motion[0] / ARCSEC / 60.0,
        "input_angle_rad": 1.0,
        "torque_Nm": 30.0,
        "sample_rate_hz": 1000.0,
        "prediction_error_bound_arcsec": table.error_bound / ARCSEC,
    }
    for key, value in expected.items():
        assert_allclose(float(values[key]), value, rtol=1e-5, err_msg=key)
    assert_allclose(float(values["predicted_te_pp_arcsec"]), np.ptp(turn) / ARCSEC, rtol=0.05)
    told = (values["samples"], values["latency_p99_us"], values["log_state"], values["prediction"])
    assert told == ("50", "81.5", "writing x", "map")


def turned(eccentricity: float, torque: float) -> MeshState:
    """The example drive over a turn, for an eccentricity [m] and a torque [N m]."""
    drive = config(joint_1__eccentricity__magnitude=eccentricity).joints[0].drive
    return mesh_state(drive, np.linspace(0.0, 2.0 * np.pi, 400), np.full(400, torque))


def test_overlap_is_judged_by_what_it_does_to_the_teeth() -> None:
    """1.5 times the load without eccentricity is a warning; a preload like the rated torque's, an error."""
    even = turned(0.0, 56.0).peak_load.max()
    for size, level in ((10e-6, 0), (18e-6, 0), (24e-6, 1), (38e-6, 1), (42e-6, 2)):
        life = Life(joint_1__eccentricity__magnitude=size, joint_1__limits__peak_tooth_load__warn=100.0)
        life.run()
        status = life.report()
        idle, rated = turned(size, 0.0), turned(size, 56.0).peak_load.max()
        keys = ("overlap_um", "idle_tooth_load_N", "rated_tooth_load_N", "tooth_load_margin_lost_percent")
        lost = 100.0 * (rated - even) / (100.0 - even)
        expected = (idle.overlap.max() * 1e6, idle.peak_load.max(), rated, lost)
        assert_allclose([float(status.values[key]) for key in keys], expected, rtol=0.02)
        assert status.values["interference"] == ("true" if idle.overlap.max() > 0.0 else "false")
        assert code(status) == (("INTERFERENCE", level) if level else ("OK", 0))
        assert level == 0 or 1.5 * even < rated
        assert level < 2 or idle.peak_load.max() > even
        for words in ("without torque", "at the rated torque", "% of the margin to 100 N is lost"):
            assert level == 0 or words in status.message


def test_residual_is_without_its_mean(life: Life) -> None:
    drive = life.monitor.config.joints[0].drive
    offset, wave = 0.01, 3e-5
    number = np.arange(200)
    angle = 0.01 * number
    error = transmission_error(drive, angle, np.ones(200)) + offset + wave * np.cos(np.pi * number / 50)
    life.take(START + MS * number, angle, angle / RATIO + error, 1.0)
    values = life.report().values
    assert_allclose(float(values["residual_rms_arcsec"]) * ARCSEC, wave / np.sqrt(2.0), rtol=1e-4)
    assert_allclose(float(values["residual_mean_arcsec"]) * ARCSEC, offset, rtol=1e-4)


def test_counts_go_on_and_shares_begin_anew(life: Life) -> None:
    """A rejected sample does not also count as missed; the stamps show samples that never came."""
    before = list(life.report().values)
    life.run()
    life.run(broken=5)
    for gone, missed in ((0, "0"), (3, "3"), (2, "5"), (0, "5")):
        life.now += gone * MS
        life.run()
        values = life.report(after=0).values
        assert (list(values), values["samples_missed"]) == (before, missed)
    assert (values["samples"], values["samples_rejected"], values["fault_code"]) == ("295", "5", "OK")
    assert values["last_rejection"] == "input angle of joint_1_motor is nan"


@pytest.mark.parametrize("lost", [range(0), range(300, 350)], ids=["none", "fifty"])
def test_a_sender_that_is_held_up_and_catches_up_has_lost_nothing(life: Life, lost: range) -> None:
    """Most steps are then far shorter than the period, and jitter hides single losses."""
    random = np.random.default_rng(3)
    held = np.maximum.accumulate(np.arange(1000) * MS + np.where(random.random(1000) < 0.15, 6 * MS, 0))
    stamps = START + held + np.arange(1000) * 20_000
    assert np.median(np.diff(stamps)) < MS / 2
    assert 0.8 * len(lost) <= life.missed(np.delete(stamps, list(lost))) <= len(lost)


@pytest.mark.parametrize("before", [0, 1000], ids=["from the start", "afterwards"])
def test_a_sender_that_sends_in_bursts_has_lost_nothing(life: Life, before: int) -> None:
    """A hundred samples within 2 ms, every 100 ms: the step within a burst is not the period."""
    number = np.arange(1000)
    assert not before or life.missed(START + np.arange(before) * MS) == 0
    late = START + (before + 100 + number // 100 * 100) * MS + number % 100 * 20_000
    assert life.missed(late) <= 100  # those of the first delay
    assert life.missed(np.delete(late + 1000 * MS, slice(300, 500))) <= 330  # 200 more are lost


def test_what_is_made_up_for_after_a_report_was_not_lost(life: Life) -> None:
    """A delay of 40 periods at the end of a report's interval, after which all samples come at once."""
    assert life.missed(START + np.append(np.arange(961), 1000) * MS) == 39
    burst = START + 1000 * MS + np.arange(1, 40) * MS // 100
    assert life.missed(np.append(burst, START + np.arange(1001, 2000) * MS)) == 0
    assert life.missed(START + np.append(np.arange(2000, 2500), np.arange(2503, 3000)) * MS) == 3


def test_a_pause_or_a_clock_that_was_set_ahead_is_no_loss(life: Life) -> None:
    """A step of an hour once counted as 3.6 million missed samples."""
    hour, before = 3_600_000 * MS, START + np.arange(1000) * MS
    assert life.missed(np.append(before, before + hour)) == 0
    assert life.missed(START + hour + np.append(np.arange(1000, 1500), np.arange(1503, 2000)) * MS) == 3


@pytest.mark.parametrize(("kept", "jitter"), [(0.6, 0.0), (0.45, 0.02), (0.3, 0.0), (0.15, 0.02)])
def test_samples_lost_by_a_slow_reader_are_no_other_period(life: Life, kept: float, jitter: float) -> None:
    """A full queue drops its oldest samples: most are lost, the rest have steps of whole periods."""
    noise = np.random.default_rng(4).normal(0.0, jitter * MS, 6000).astype(np.int64)
    stamps = START + MS * np.arange(6000) + noise
    let_through = np.unique((1000 + np.arange(4000 * kept) / kept).astype(int))
    tolerance = 0.005 * 4000 if jitter else 0
    assert life.missed(stamps[:1000]) == 0
    known = life.missed(stamps[let_through])
    assert abs(known - (let_through[-1] - 999 - let_through.size)) <= tolerance
    assert abs(life.missed(stamps[5000:]) - (4000 - let_through.size)) <= tolerance


@pytest.mark.parametrize("factor", [2, 3, 2.5])
def test_another_period_is_no_loss(life: Life, factor: float) -> None:
    """Samples may count as missed only in the one report that has both periods."""
    step, count = round(factor * MS), 1000
    assert life.missed(START + MS * np.arange(count)) == 0
    end = START + MS * (count - 1)
    first = life.missed(end + step * np.arange(1, count))
    assert first <= 2
    assert life.missed(end + step * np.arange(count, 2 * count)) == first
