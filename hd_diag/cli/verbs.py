"""The command line: one verb a task. Exit codes: 0 done, 1 a finding to fail on, 2 bad usage or input."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NoReturn

import click
import numpy as np

import hd_diag
from hd_diag.arrays import Floats
from hd_diag.cli.bags import recover, replay
from hd_diag.cli.diagnose import diagnose
from hd_diag.cli.figures import figures
from hd_diag.cli.fleet import fleet
from hd_diag.cli.options import (
    CONFIG,
    INTERRUPTED,
    JOINT,
    JSON,
    SIGNALLED,
    Problem,
    chosen_joint,
    configured,
    problems,
    write_json,
)
from hd_diag.cli.report import report
from hd_diag.cli.simulate import simulate
from hd_diag.cli.tolerance import tolerance
from hd_diag.cli.watch import watch
from hd_diag.config.configuration import JointConfig, load
from hd_diag.formatting import json_ready
from hd_diag.ros.stop_signals import note_signals
from hd_diag.streams.columns import LARGEST_ANGLE, LARGEST_TORQUE


class _OneLine(click.Group):
    """Commands whose faults of usage are told in one line, too."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        try:
            code = super().main(*args, **kwargs | {"standalone_mode": False})
        except click.ClickException as error:
            click.echo(f"hd-diag: {' '.join(error.format_message().split())}", err=True)
            sys.exit(error.exit_code)
        except click.Abort:
            _interrupted()
        except SystemError as error:
            if not _is_interruption(error):
                raise
            _interrupted()
        sys.exit(code if isinstance(code, int) else 0)


def _is_interruption(error: BaseException | None) -> bool:
    """Whether it began as a KeyboardInterrupt: numba's compiled code makes SystemErrors of one."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _interrupted() -> NoReturn:
    click.echo("hd-diag: interrupted", err=True)
    sys.exit(INTERRUPTED)


@click.group(
    cls=_OneLine,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(hd_diag.__version__, prog_name="hd-diag")
@click.pass_context
def cli(context: click.Context) -> None:
    """Harmonic drives in robot joints: what the teeth do, live and in bags.

    Lengths, angles and torques are SI: m, rad, N m. Configurations are ROS parameter files, as the node takes
    them. Exit codes: 0 done, 1 a finding that you asked to fail on, 2 bad usage or input, 130 after Ctrl-C.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


cli.add_command(simulate)
cli.add_command(replay)
cli.add_command(recover)
cli.add_command(diagnose)
cli.add_command(report)
cli.add_command(figures)
cli.add_command(tolerance)
cli.add_command(fleet)
cli.add_command(watch)


@cli.command(epilog="Example: hd-diag check config/example_drive.yaml")
@click.argument("config_file", metavar="CONFIG", type=click.Path(dir_okay=False))
@JSON
@problems
def check(config_file: str, json_file: str | None) -> None:
    """Validate a configuration without ROS and say what it describes.

    Every value is checked alone and the geometry as a whole; an unknown key is an error that names the
    nearest known one.
    """
    config = load(config_file)
    if json_file:
        write_json(json_file, {"schema": "hd_diag/check/1", "valid": True, "parameters": dict(config.flat)})
        if json_file == "-":
            return
    for joint in config.joints:
        mesh = joint.drive.mesh
        click.echo(
            f"{joint.name}: {joint.input_joint} -> {joint.output_joint}, "
            f"ratio {joint.drive.kinematics.ratio:g}, "
            f"{mesh.geometry.flexspline_teeth}/{mesh.geometry.circular_spline_teeth} teeth, "
            f"rated {joint.drive.rated_torque:g} N m, eccentricity {abs(mesh.eccentricity) * 1e6:g} um"
        )
    click.echo(f"{config_file}: valid")


@cli.command(
    short_help="One moment: backlash and load of every tooth, torsion, error.",
    epilog="Example: hd-diag mesh --config arm.yaml --joint elbow --torque 14",
)
@CONFIG
@JOINT
@click.option("--input-angle", type=float, default=0.0, show_default=True, help="Reported input angle [rad].")
@click.option("--torque", type=float, default=0.0, show_default=True, help="Torque M [N m].")
@JSON
@problems
def mesh(
    config_file: str | None, joint: str | None, input_angle: float, torque: float, json_file: str | None
) -> None:
    """One moment: backlash and load of every tooth, torsion, transmission error.

    Torsion and loads are those of a torque M that turns the cup counter-clockwise (M > 0 bears on + flanks).
    The transmission error is the drive's when it exerts M on the link, whose reaction on the cup is -M for an
    output at the flexspline; "as_driven" holds torsion and loads of that state, which the node publishes.
    """
    given = ("input-angle", input_angle, LARGEST_ANGLE), ("torque", torque, LARGEST_TORQUE)
    for name, value, largest in given:
        if not abs(value) <= largest:
            raise click.BadParameter(f"--{name} must be a number of at most {largest:g}, not {value:g}")
    chosen = chosen_joint(configured(config_file), joint)
    result = moment(chosen, input_angle, torque)
    if json_file:
        write_json(json_file, result)
    if json_file != "-":
        _show_moment(result)


def moment(joint: JointConfig, input_angle: float, torque: float) -> dict[str, Any]:
    """What `hd-diag mesh --json` writes.

    Parameters
    ----------
    joint : JointConfig
    input_angle : float
        As reported [rad].
    torque : float
        M [N m].

    Returns
    -------
    dict
        Schema ``hd_diag/mesh/1``.
    """
    from hd_diag.drive import mesh_state, transmission_error

    drive = joint.drive
    angle, load = np.array([input_angle]), np.array([torque])
    state = mesh_state(drive, angle, load)
    driven = mesh_state(drive, angle, drive.frame.cup_torque(load))
    content = {
        "schema": "hd_diag/mesh/1",
        "joint": joint.name,
        "input_angle": input_angle,
        "torque": torque,
        "torsion": state.torsion[0],
        "transmission_error": transmission_error(drive, angle, load)[0],
        "lost_motion": state.lost_motion[0],
        "interference": bool(state.interference[0]),
        "overlap": state.overlap[0],
        "loaded_pairs": int(state.loaded_pairs[0]),
        "peak_tooth_load": state.peak_load[0],
        "load_concentration": state.load_concentration[0],
        "backlash": _flanks(state.backlash[0]),
        "load": _flanks(state.load[0]),
        "pressure_angle": _flanks(state.pressure_angle[0]),
        "as_driven": {"torsion": driven.torsion[0], "load": _flanks(driven.load[0])},
        "units": {
            "angle": "rad",
            "torque": "N m",
            "backlash": "m, circumferential, at zero torsion",
            "load": "N, normal to the flank",
        },
    }
    return dict(json_ready(content))


def _flanks(values: Floats) -> dict[str, list[float]]:
    return {sign: row.tolist() for sign, row in zip("+-", values, strict=True)}


def _show_moment(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from hd_diag.model.torsion_map import ARCSEC

    def scaled(value: float | None, scale: float) -> str:
        return "-" if value is None else f"{value * scale:.3f}"

    console = Console()
    console.print(
        f"[bold]{result['joint']}[/bold] at input angle {result['input_angle']:g} rad, "
        f"torque {result['torque']:g} N m\n"
        f"transmission error {scaled(result['transmission_error'], 1 / ARCSEC)} arcsec, "
        f"torsion {scaled(result['torsion'], 1 / ARCSEC)} arcsec, "
        f"lost motion {scaled(result['lost_motion'], 1 / ARCSEC / 60)} arcmin\n"
        f"{result['loaded_pairs']} loaded flanks, largest force {scaled(result['peak_tooth_load'], 1)} N, "
        f"{scaled(result['load_concentration'], 1)} times the mean; "
        f"interference: {'yes' if result['interference'] else 'no'} "
        f"(overlap {scaled(result['overlap'], 1e6)} um)"
    )
    table = Table("tooth", "backlash + [um]", "backlash - [um]", "load + [N]", "load - [N]")
    for tooth in range(len(result["backlash"]["+"])):
        cells = [result[what][sign][tooth] for what in ("backlash", "load") for sign in "+-"]
        if cells[0] is not None or cells[1] is not None:
            scales = (1e6, 1e6, 1.0, 1.0)
            table.add_row(str(tooth), *(scaled(c, s) for c, s in zip(cells, scales, strict=True)))
    console.print(table)
    console.print("Teeth that are not listed cannot touch.")


@cli.command(
    context_settings={"ignore_unknown_options": True},
    short_help="Run the node: joint states in; error, teeth, diagnostics out.",
    epilog="Example: hd-diag node --config arm.yaml -- --ros-args -r joint_states:=/js",
)
@CONFIG
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
@problems
def node(config_file: str | None, ros_arguments: tuple[str, ...]) -> None:
    """Run the node: joint states in, diagnostics, tooth arrays and transmission error out.

    Needs ROS 2 Jazzy. Arguments after -- go to ROS. Ends with code 0 on SIGINT and SIGTERM.
    """
    if config_file:
        load(config_file)
    stopped = note_signals()
    try:
        from hd_diag.ros.node import main as run
    except ImportError as error:
        raise Problem(f"the node needs ROS 2 Jazzy (rclpy), which is not to be imported: {error}") from error
    parameter_file = ["--ros-args", "--params-file", config_file, "--"] if config_file else []
    sys.exit(run(["hd_diag_node", *parameter_file, *ros_arguments], stopped))


@cli.command(
    short_help="The node beside a simulated joint, its log, replay and verdict.",
    epilog="Example: hd-diag demo --out demo",
)
@click.option(
    "--out",
    "folder",
    type=click.Path(file_okay=False),
    help="Folder for log, replay and report. [default: a new one among the temporary files]",
)
@click.option(
    "--seconds",
    type=click.FloatRange(5.0, 600.0),
    default=24.0,
    show_default=True,
    help="How long node and joint run [s].",
)
@JSON
@problems
def demo(folder: str | None, seconds: float, json_file: str | None) -> None:
    """The main job end to end: the real node beside a simulated joint, over DDS, its log, replay and verdict.

    Starts both as processes of their own, changes the eccentricity while they run, shows what the diagnostics
    say, replays the log, diagnoses it and writes the report. Needs ROS 2 Jazzy. Exit codes: 0 all held, 1
    something did not, 130 after Ctrl-C.
    """
    try:
        from hd_diag.demo.run import run
    except ImportError as error:
        raise Problem(f"the demo needs ROS 2 Jazzy (rclpy), which is not to be imported: {error}") from error
    summary = run(Path(folder) if folder else None, seconds)
    if json_file:
        write_json(json_file, summary)
    if summary["signal"] is not None:
        sys.exit(SIGNALLED + summary["signal"])
    sys.exit(0 if summary["complete"] else 1)


def main() -> None:
    """Entry point of the ``hd-diag`` command."""
    try:
        cli()
    except BrokenPipeError:
        sys.exit(0)


if __name__ == "__main__":
    main()
