"""A joint whose torsion is its page's, piecewise K1 to K3 without teeth, is predicted as configured."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from challenge.records import write_bag
from cli_runner import hd_diag as command
from mcap_ros2.reader import read_ros2_messages

import hd_diag
from hd_diag.config.configuration import resolve

# Pages: ratio, T1, T2 [N m], K1, K2, K3 [N m/rad].
PAGES = {
    "CSG-25-100": (100.0, 14.0, 48.0, 3.1e4, 5.0e4, 5.7e4),
    "CSG-14-50": (50.0, 2.0, 6.9, 3400.0, 4700.0, 5700.0),
    "CSG-20-160": (160.0, 7.0, 25.0, 1.6e4, 2.5e4, 2.9e4),
}
WITHIN = 0.07


def record(name: str) -> SimpleNamespace:
    """A minute at 50 Hz: the input turns, the torque swings more slowly, up to 2 T2 and through zero."""
    ratio, t1, t2, k1, k2, k3 = PAGES[name]
    time = np.arange(3000) / 50.0
    torque = 2.0 * t2 * np.sin(2.0 * np.pi * time / 30.0) * np.abs(np.sin(2.0 * np.pi * time / 60.0))
    angle = 3.0 * time + 0.4 * np.sin(time)
    ends = np.cumsum([0.0, t1 / k1, (t2 - t1) / k2, t2 / k3])
    torsion = np.sign(torque) * np.interp(np.abs(torque), [0.0, t1, t2, 2.0 * t2], ends)
    part = np.zeros(time.size, dtype=np.int64)
    output = angle / ratio - torsion
    columns = {"time": time, "input_angle": angle, "output_angle": output, "torque": torque}
    return SimpleNamespace(**columns, temperature=None, part=part)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("name", PAGES)
def test_a_joint_with_its_page_s_torsion_is_predicted_as_configured(name: str) -> None:
    made, ratio = record(name), PAGES[name][0]
    measured = made.output_angle - made.input_angle / ratio
    drive = hd_diag.gear(name)
    residual = measured - hd_diag.transmission_error(drive, made.input_angle, made.torque)
    loaded = np.abs(made.torque) >= 0.1 * PAGES[name][1]
    assert rms(residual) < WITHIN * rms(measured)
    assert np.max(np.abs(residual[loaded] / measured[loaded])) < 1.2 * WITHIN  # the mean of teeth is within


def test_a_drive_with_the_page_s_slopes_alone_is_not_the_joint() -> None:
    made = record("CSG-25-100")
    measured = made.output_angle - made.input_angle / 100.0
    low = np.abs(np.abs(made.torque) - 1.4) < 0.2
    both = hd_diag.gear("CSG-25-100"), resolve({}).joints[0].drive
    own, other = (hd_diag.transmission_error(one, made.input_angle, made.torque)[low] for one in both)
    assert rms(measured[low] - other) > 5.0 * rms(measured[low] - own)


def test_replay_shows_it(tmp_path: Path) -> None:
    made = record("CSG-25-100")
    bag, out, config = (tmp_path / name for name in ("joint.mcap", "out.mcap", "joint.yaml"))
    write_bag(made, bag, "joint_1")
    assert command("gear", "CSG-25-100", "--out", config).exit_code == 0
    assert command("replay", bag, "--config", config, "--out", out).exit_code == 0
    topics = ("/hd_diag/residual", "/hd_diag/measured_transmission_error")
    read = (read_ros2_messages(out, topics=[topic]) for topic in topics)
    residual, measured = (np.array([one.ros_msg.position[0] for one in messages]) for messages in read)
    assert residual.size > 2900
    assert rms(residual) < WITHIN * rms(measured)
