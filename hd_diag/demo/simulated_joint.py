"""A simulated joint in real time: a process that publishes ``joint_states`` as a robot's driver does."""

# mypy: disallow-untyped-calls=False

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time
from collections.abc import Sequence
from threading import Event

import click
import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import JointState

from hd_diag.bag import encode_joint_states
from hd_diag.config.configuration import JointConfig, load
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.simulation import simulation
from hd_diag.simulation.simulation import Motion, Noise, Record, SimulatedJoint

_TURN = 2.0 * math.pi
_DEPTH = 2000  # messages kept for a reader that falls behind
_WAIT = 30.0  # for the first subscriber [s]
_CHUNK = 100  # messages encoded at a time


def motion(seconds: float, rate: float, speed: float, torque: float) -> Motion:
    """One run of so many seconds at a rate [Hz], speed [rad/s] and torque [N m], with a short start."""
    return Motion(
        duration=seconds,
        sample_rate=rate,
        speeds=(speed,),
        torques=(torque,),
        both_directions=False,
        ramp_share=min(0.1, 0.5 / seconds),
        rest_share=0.0,
    )


def publish(publisher: Publisher, joint: JointConfig, record: Record, rate: float, stop: Event) -> int:
    """Publish a record in real time, from now on.

    Parameters
    ----------
    publisher : Publisher
        Of JointState.
    joint : JointConfig
        Gives the names.
    record : Record
        Its stamps are replaced by the time of sending.
    rate : float
        [Hz]
    stop : Event
        Ends it early.

    Returns
    -------
    int
        Messages published.
    """
    start, begin, sent = time.time_ns(), time.monotonic(), 0
    stamp = start + np.rint(np.arange(record.stamp.size) * (1e9 / rate)).astype(np.int64)
    for first in range(0, stamp.size, _CHUNK):
        part = slice(first, first + _CHUNK)
        for row in _encoded(joint, Record(stamp[part], *(column[part] for column in record[1:]))):
            if stop.wait(max(0.0, begin + sent / rate - time.monotonic())):
                return sent
            publisher.publish(row.tobytes())
            sent += 1
    return sent


def _encoded(joint: JointConfig, record: Record) -> npt.NDArray[np.uint8]:
    """Rows of CDR; the effort of the input, which no sensor measures, is 0."""
    names = [joint.input_joint, joint.output_joint]
    ratio = joint.drive.kinematics.ratio
    position = np.stack((record.input_angle, record.output_angle), axis=1)
    velocity = np.stack((record.input_velocity, record.input_velocity / ratio), axis=1)
    effort = np.stack((np.zeros(record.torque.size), record.torque), axis=1)
    return encode_joint_states(names, record.stamp, position, velocity, effort)


def _wait_for_subscriber(publisher: Publisher, stop: Event) -> bool:
    """Whether to go on: somebody listens, or the end is wanted."""
    end = time.monotonic() + _WAIT
    while publisher.get_subscription_count() == 0 and time.monotonic() < end:
        if stop.wait(0.01):
            return True
    return bool(publisher.get_subscription_count())


def _arguments(args: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m hd_diag.demo.simulated_joint", description=__doc__)
    parser.add_argument(
        "--config", required=True, help="parameter file with the true drive; its first joint is run"
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to run [s]")
    parser.add_argument("--rate", type=float, default=500.0, help="messages per second [Hz]")
    parser.add_argument("--speed", type=float, default=2.1, help="of the input [rev/s]")
    parser.add_argument("--torque", type=float, default=14.0, help="that the drive exerts on the link [N m]")
    parser.add_argument("--noise", type=float, default=1.0, help="of the output angle, white [arcsec rms]")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    return parser.parse_args(args)


def main(args: Sequence[str] | None = None) -> int:
    """Run a joint until its motion, SIGINT or SIGTERM ends it; print what was published as JSON.

    Parameters
    ----------
    args : sequence of str, optional
        Command line without the program; that of the process by default.

    Returns
    -------
    int
        Exit code: 0 done, 1 nobody listens, 2 values that cannot be.
    """
    stop = Event()
    for number in (
        signal.SIGINT,
        signal.SIGTERM,
    ):  # no exception: it could fall between a message and its count
        signal.signal(number, lambda *_: stop.set())
    given = _arguments(args)
    try:
        joint = load(given.config).joints[0]
        run = motion(given.seconds, given.rate, _TURN * given.speed, given.torque)
        return _run(joint, run, given, stop)
    except ValueError as error:
        click.echo(f"simulated_joint: {error}", err=True)
        return 2
    finally:
        try_shutdown()


def _run(joint: JointConfig, run: Motion, given: argparse.Namespace, stop: Event) -> int:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    profile = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
    publisher = Node("simulated_joint").create_publisher(JointState, "joint_states", profile)
    truth = SimulatedJoint(joint.drive, Noise(white=given.noise * ARCSEC))
    # Before waiting: meanwhile the processes discover each other.
    record = simulation.simulate(truth, run, np.random.default_rng(given.seed))
    click.echo("simulated_joint: ready")
    if not _wait_for_subscriber(publisher, stop):
        click.echo(f"simulated_joint: nobody subscribed to joint_states within {_WAIT:g} s", err=True)
        return 1
    sent = publish(publisher, joint, record, given.rate, stop)
    publisher.wait_for_all_acked(Duration(seconds=2))
    click.echo(json.dumps({"published": sent}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
