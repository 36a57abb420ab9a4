"""The package in a notebook: a drive, its state at one moment, a record and its diagnosis, in a few lines.

``import hd_diag`` offers all of it and loads nothing until a name is used. The page "In Python" has examples.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hd_diag import drive as core
from hd_diag.arrays import Floats
from hd_diag.config import configuration
from hd_diag.config.configuration import ConfigError, JointConfig
from hd_diag.config.parameters import flatten
from hd_diag.diagnosis import diagnosis as offline
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.fit.fit_parameters import warm_up
from hd_diag.diagnosis.record import Record, RecordError
from hd_diag.diagnosis.screening import screened
from hd_diag.diagnosis.verdict import as_json
from hd_diag.drive import Drive, MeshState
from hd_diag.gears.catalogue import named
from hd_diag.gears.page import Page
from hd_diag.records.joint_record import read_bags
from hd_diag.records.tables import Table, read_tables
from hd_diag.records.text_table import is_table

_OF_PAGE = ("size", *Page._fields[:-1])


def load(file: str | Path) -> dict[str, JointConfig]:
    """Joints of a parameter file by their names; each has its ``drive``.

    Raises
    ------
    ConfigError
        If a parameter is invalid; the message names it, its value and what was expected.
    """
    return {joint.name: joint for joint in configuration.load(file).joints}


def gear(name: str | Mapping[str, Any] | None = None, /, **values: Any) -> Drive:
    """A drive from its catalogue page, as ``hd-diag gear`` makes it.

    Parameters
    ----------
    name : str or mapping, optional
        A gear of the table, as CSG-25-100, or the values.
    **values
        Values of the page: `size` [0.1 inch] or `pitch_diameter` [m], `ratio` [-], `rated_torque`, `t1`, `t2`
        [N m], `k1`, `k2`, `k3` [N m/rad], `lost_motion` [rad]. Values of the joint have their names in a
        parameter file: ``eccentricity={"magnitude": 5e-6, "direction": 0.0}``. All override the table's.

    Raises
    ------
    ConfigError
        For a name that is not in the table, and for values that no drive can have.
    """
    given: dict[str, Any] = {}
    if isinstance(name, str):
        try:
            given = dict(named(name)[1].given)
        except ValueError as error:
            raise ConfigError(str(error)) from error
        given["ratio"] += values.get("output") == "circular_spline"  # the page's is for a fixed one
    elif name is not None:
        given = dict(name)
    own = flatten({**given, **values})
    flat = {f"joint_1.{'gear.' * (key in _OF_PAGE)}{key}": value for key, value in own}
    return configuration.resolve(flat).joints[0].drive


def mesh_state(drive: Drive, angle: npt.ArrayLike, torque: npt.ArrayLike) -> MeshState:
    """Backlash and load of every tooth, as ``hd-diag mesh`` gives them.

    Parameters
    ----------
    drive : Drive
    angle : float or array (moments,)
        Input angle as reported [rad].
    torque : float or array (moments,)
        Torque that turns the cup counter-clockwise [N m]. ``drive.frame.cup_torque(torque)`` gives it from a
        torque that the drive exerts on the link.
    """
    return core.mesh_state(_checked(drive), *_moments(angle, torque))


def transmission_error(drive: Drive, angle: npt.ArrayLike, torque: npt.ArrayLike) -> Floats:
    """Output angle less input angle over ratio (moments,) [rad].

    Arguments are reported input angles [rad] and torques that the drive exerts on the link [N m]; both are
    floats or arrays.
    """
    return core.transmission_error(_checked(drive), *_moments(angle, torque))


def read(
    files: str | Path | Sequence[str | Path],
    joint: JointConfig | str,
    columns: Mapping[str, str] | None = None,
    rate: float = 0.0,
) -> Record:
    """A joint's record from bags, or from CSV files where `columns` are given.

    Parameters
    ----------
    files : path or sequence of paths
        Each begins a new run.
    joint : JointConfig or str
        Joint of :func:`load`, which says where its signals are. A name alone is that of the joint in the
        joint states; the motor's angle then has the name with ``_motor``.
    columns : mapping, optional
        Columns by what they hold (time, input, output, torque, temperature), each with its unit in brackets
        where it is not SI: ``{"input": "motor[deg]"}``.
    rate : float
        Sampling rate of CSV files without a column of time [Hz].

    Raises
    ------
    BagError, RecordError
        If nothing can be judged; the message says why.
    TypeError
        If `joint` is all joints of a file instead of one.
    """
    if isinstance(joint, str):
        joint = configuration.resolve({"joints": [joint]}).joints[0]
    if isinstance(joint, Mapping):
        raise TypeError('read takes one joint, as load(file)["elbow"] or "elbow", not all of a file')
    paths = [files] if isinstance(files, (str, Path)) else files
    if columns is None:
        for table in filter(is_table, map(Path, paths)):
            raise RecordError(
                f'{table}: a table needs columns, as {{"time": "t", "input": "m[deg]", "output": "l[deg]"}}; '
                f"hd-diag topics {shlex.quote(str(table))} proposes some"
            )
        return read_bags(paths, joint)
    return read_tables(paths, Table(columns, rate=rate), joint)


def diagnose(record: Record, drive: Drive, seed: int = 0) -> Diagnosis:
    """Errors of a drive's model in a record, and their causes; :func:`verdict` puts them into a sentence.

    The same seed gives the same numbers. It takes some seconds, and a minute the first time on a machine.
    """
    if not isinstance(record, Record):
        raise TypeError(f"diagnose takes a record of hd_diag.read, not {type(record).__name__}")
    looked = screened(record, _checked(drive))
    warm_up()
    return offline.diagnose(looked, drive, np.random.default_rng(seed))


def verdict(diagnosis: Diagnosis, joint: str = "joint_1") -> dict[str, Any]:
    """Content of ``hd-diag diagnose --json``, in SI: ``verdict`` is the sentence, ``causes`` the list."""
    return as_json(diagnosis, joint)


def _checked(drive: Any) -> Drive:
    if not isinstance(drive, Drive):
        kind = type(drive).__name__
        raise TypeError(f'expected a drive, as load(file)["elbow"].drive or gear(name), not {kind}')
    return drive


def _moments(angle: npt.ArrayLike, torque: npt.ArrayLike) -> tuple[Floats, Floats]:
    found, load = (np.atleast_1d(np.asarray(one, np.float64)) for one in (angle, torque))
    if found.shape != load.shape and 1 not in (found.size, load.size):
        raise ValueError(f"angle {found.shape} [rad] and torque {load.shape} [N m] differ in shape")
    found, load = np.broadcast_arrays(found, load)
    return found, load
