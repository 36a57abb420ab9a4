"""Which bags there are, and what is seen of one."""

import hashlib
import os
from pathlib import Path

import fleet_tasks
import pytest

from hd_diag.config.configuration import resolve
from hd_diag.fleet.rows import tasks
from hd_diag.fleet.survey import find_bags, survey


def test_bags_in_folders_at_any_depth_each_once(tmp_path: Path) -> None:
    """A folder with metadata is one bag, whatever is in it; links are not followed in circles."""
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


def test_a_survey(tmp_path: Path) -> None:
    seen = survey(str(fleet_tasks.small_bag(tmp_path / "a.mcap", 3)))
    assert (seen.error, seen.messages, seen.problems) == ("", 12, ())
    assert seen.names == {"joint_1_motor", "joint_1"}
    assert seen.start == fleet_tasks.BEGIN + 3 * fleet_tasks.DAY
    own = hashlib.sha256((tmp_path / "a.mcap").read_bytes()).digest()
    assert seen.digest == hashlib.sha256(own).hexdigest()


def test_tasks_are_the_joints_that_a_bag_holds(tmp_path: Path) -> None:
    """One of two angles is enough to be asked for, and reported with why it is not judged."""
    config = resolve({"joints": ["joint_1", "joint_2", "joint_3"]})
    path = fleet_tasks.small_bag(tmp_path / "a.mcap", names=("joint_2", "joint_3", "joint_3_motor"))
    found = tasks(survey(str(path)), config, config.joints)
    assert [task.joint.name for task in found] == ["joint_2", "joint_3"]


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
