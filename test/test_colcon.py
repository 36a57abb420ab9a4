"""The tree builds, tests and runs with colcon, as under a sourced ROS 2 Jazzy."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest


def run(command: list[str], folder: Path, environment: dict[str, str]) -> str:
    streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(command, cwd=folder, env=environment, timeout=600, **streams)
    assert done.returncode == 0, done.stdout
    return str(done.stdout)


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment with this Python's colcon first, and colcon's own log outside the home folder."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    own = {"PATH": path, "COLCON_HOME": str(tmp_path_factory.mktemp("colcon_home")), "PYTEST_ADDOPTS": ""}
    return {**os.environ, **own}


@pytest.fixture(scope="module")
def workspace(source_copy: Path, environment: dict[str, str]) -> Path:
    """Built colcon workspace around a copy of the tree."""
    folder = source_copy.parent
    run(["colcon", "build", "--event-handlers", "console_direct+"], folder, environment)
    return folder


def test_build_installs_both_executables_and_share(workspace: Path) -> None:
    installed = workspace / "install/hd_diag"
    for executable in ("hd_diag_node", "hd-diag"):
        assert os.access(installed / "lib/hd_diag" / executable, os.X_OK)
    assert (installed / "share/ament_index/resource_index/packages/hd_diag").is_file()
    assert (installed / "share/hd_diag/launch/hd_diag.launch.py").is_file()


def test_command_runs_from_the_installed_tree(workspace: Path, environment: dict[str, str]) -> None:
    # The command runs in an empty folder, where the source tree cannot help.
    elsewhere = workspace / "elsewhere"
    elsewhere.mkdir()
    place = "python -c 'import hd_diag; print(hd_diag.__file__)'"
    script = f". ../install/setup.sh && {place} && ../install/hd_diag/lib/hd_diag/hd-diag --help"
    sourced = {**environment, "COLCON_CURRENT_PREFIX": str(workspace / "install")}
    output = run(["sh", "-c", script], elsewhere, sourced)
    assert output.startswith(str(workspace / "install/hd_diag"))
    assert "Usage:" in output


@pytest.mark.slow
def test_colcon_test_runs_the_tests(workspace: Path, environment: dict[str, str]) -> None:
    # A quick selection: without one, this test would start itself.
    command = ["colcon", "test", "--event-handlers", "console_direct+", "--return-code-on-test-failure"]
    output = run([*command, "--pytest-args", "test/test_formatting.py"], workspace, environment)
    assert " passed" in output
    assert " failed" not in output
