"""A simulated joint in real time: a process that publishes ``joint_states`` as a robot's driver does."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Sequence

import click
import numpy as np
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import JointState

from hd_diag.cli.options import shown
from hd_diag.config.configuration import JointConfig, load
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.ros.stop_signals import note_signals
from hd_diag.simulation import Motion, Noise, Samples, SimulatedJoint, simulate
from hd_diag.simulation.bag import encode_samples

_TURN = 2.0 * math.pi
_DEPTH = 2000  # messages kept for a reader that falls behind
_WAIT = 30.0  # for the first subscriber [s]
_CHUNK = 100  # messages encoded at a time
_LONGEST_SLEEP = 0.05  # between looks at signals [s]


def _publish(
    publisher: Publisher, joint: JointConfig, samples: Samples, rate: float, stopped: Sequence[int]
) -> int:
    """Publish samples at a rate [Hz], stamped with the time of sending, until a signal; return how many."""
    start, begin, sent = time.time_ns(), time.monotonic(), 0
    count = samples.stamp.size
    stamp = start + np.rint(np.arange(count) * (1e9 / rate)).astype(np.int64)
    names, ratio = [joint.input_joint, joint.output_joint], joint.drive.kinematics.ratio
    for first in range(0, count, _CHUNK):
        part = slice(first, first + _CHUNK)
        chunk = Samples(stamp[part], *(column[part] for column in samples[1:]))
        for row in encode_samples(names, [ratio], [chunk]):
            while (early := begin + sent / rate - time.monotonic()) > 0.0 and not stopped:
                time.sleep(min(early, _LONGEST_SLEEP))
            if stopped:
                return sent
            publisher.publish(row.tobytes())
            sent += 1
    return sent


def _wait_for_subscriber(publisher: Publisher, stopped: Sequence[int]) -> bool:
    """Wait for a subscriber; True if there is one or a signal has come."""
    end = time.monotonic() + _WAIT
    while not publisher.get_subscription_count() and not stopped and time.monotonic() < end:
        time.sleep(0.01)
    return bool(publisher.get_subscription_count() or stopped)


@click.command()
@click.option("--config", required=True, help="Parameter file; its first joint is run.")
@shown("--seconds", 60.0, "How long to run [s].")
@shown("--rate", 500.0, "Messages per second [Hz].")
@shown("--speed", 2.1, "Of the input [rev/s].")
@shown("--torque", 14.0, "That the drive exerts on the link [N m].")
@shown("--noise", 1.0, "Of the output angle, white [arcsec rms].")
@shown("--seed", 0, "Of the noise.")
def main(
    config: str, seconds: float, rate: float, speed: float, torque: float, noise: float, seed: int
) -> None:
    """Publish joint_states in real time as a robot's driver does, and print what was published as JSON.

    The motion, SIGINT or SIGTERM ends it. Exit code: 0 done, 1 nobody listens, 2 values that cannot be.
    """
    stopped = note_signals()
    try:
        joint = load(config).joints[0]
        motion = Motion(
            duration=seconds,
            sample_rate=rate,
            speeds=(_TURN * speed,),
            torques=(torque,),
            both_directions=False,
            ramp_share=min(0.1, 0.5 / seconds) if seconds else 0.1,
            rest_share=0.0,
        )
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        profile = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        publisher = Node("simulated_joint").create_publisher(JointState, "joint_states", profile)
        # Computed before the wait: meanwhile the processes discover each other.
        truth = SimulatedJoint(joint.drive, Noise(white=noise * ARCSEC))
        samples = simulate(truth, motion, np.random.default_rng(seed))
        click.echo("simulated_joint: ready")
        if not _wait_for_subscriber(publisher, stopped):
            click.echo(f"simulated_joint: nobody subscribed to joint_states within {_WAIT:g} s", err=True)
            sys.exit(1)
        sent = _publish(publisher, joint, samples, rate, stopped)
        publisher.wait_for_all_acked(Duration(seconds=2))
        click.echo(json.dumps({"published": sent}))
    except ValueError as error:
        click.echo(f"simulated_joint: {error}", err=True)
        sys.exit(2)
    finally:
        try_shutdown()


if __name__ == "__main__":
    main()
