"""The configuration that a verb was given, and the joints chosen from it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hd_diag.cli.lines import tell
from hd_diag.cli.options import check_files
from hd_diag.cli.targets import Problem
from hd_diag.config.configuration import Config, JointConfig, load, resolve

if TYPE_CHECKING:
    from hd_diag.effects import Catalogue


def configured(config_file: str | None, catalogue: Catalogue | None = None, teeth: bool = True) -> Config:
    """The configuration of a file, or the example drive's; `catalogue` has the effects of its model files.

    Without `teeth` a ratio alone suffices, for any gear.
    """
    if not config_file:
        return resolve({}, catalogue=catalogue, teeth=teeth)
    config = load(config_file, catalogue, teeth)
    check_files(inputs=[Path(joint.model_file) for joint in config.joints if joint.model_file])
    return config


def tell_assumed(config_file: str | None, config: Config) -> None:
    """Say which drive a record was compared with if no file was given."""
    if not config_file:
        (joint,) = config.joints
        drive = f"ratio {joint.drive.frame.ratio:g}, rated torque {joint.drive.rated_torque:g} N m"
        tell(
            f"hd-diag: {joint.name}: without --config this is taken for the example drive, {drive}; "
            "hd-diag gear writes a file for yours",
            err=True,
        )


def chosen_joint(config: Config, name: str | None) -> JointConfig:
    """The joint of this name, or the first."""
    return chosen_joints(config, () if name is None else (name,))[0]


def chosen_joints(config: Config, names: tuple[str, ...]) -> list[JointConfig]:
    """The joints of these names, or all."""
    known = {joint.name: joint for joint in config.joints}
    for name in names:
        if name not in known:
            raise Problem(f"no joint {name!r} in the configuration; it has {', '.join(known)}")
    return [known[name] for name in names] or list(config.joints)
