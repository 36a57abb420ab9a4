"""Shared by all tests: an isolated ROS, repeatable hypothesis runs, a copy of the source tree."""

import filecmp
import gc
import os
import shutil
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import browser as headless
import drives
import hypothesis
import pytest

import hd_diag
from hd_diag.diagnosis.accuracy import accuracy
from hd_diag.model.mesh import Mesh

ROOT = Path(__file__).resolve().parent.parent
NOT_SOURCE = shutil.ignore_patterns(
    ".git", ".venv", "build", "install", "log", "*.egg-info", "__pycache__", ".*_cache"
)

hypothesis.settings.register_profile("hd_diag", derandomize=True, deadline=None)
hypothesis.settings.load_profile("hd_diag")


def claim_domain() -> tuple[socket.socket, int]:
    """Claim a ROS domain that no other test process on this machine has.

    Two runs on one domain would drive each other's nodes. An abstract socket with that name marks the domain
    as taken; the system frees it with the process. Domain 0 remains for the user's nodes.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    for domain in range(1, 102):
        try:
            claim.bind(f"\0hd_diag-test-domain-{domain}")
        except OSError:
            continue
        return claim, domain
    raise pytest.UsageError("all 101 ROS domains are taken by other test runs")


def stale_modules() -> list[str]:
    """Modules that differ between this tree and the hd_diag under test, if that is an installed one."""
    tree, tested = ROOT / "hd_diag", Path(hd_diag.__file__).parent
    names = {path.relative_to(base) for base in (tree, tested) for path in base.rglob("*.py")}
    same = filecmp.cmpfiles(tree, tested, map(str, names), shallow=False)[0]
    return sorted({str(name) for name in names} - set(same))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slowest", metavar="FILE", help="write the ten slowest tests as a table")


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    if (file := config.getoption("slowest")) is None:
        return
    seconds: Counter[str] = Counter()
    for report in terminalreporter.getreports("passed") + terminalreporter.getreports(""):
        seconds[report.nodeid] += report.duration
    rows = [f"| `{name.removeprefix('test/')}` | {each:.1f} |" for name, each in seconds.most_common(10)]
    took = time.monotonic() - config.began
    told = f"{len(seconds)} tests in {took:.0f} s on {os.cpu_count()} cores. The slowest, waiting included:"
    Path(file).write_text("\n".join([told, "", "| test | s |", "| --- | ---: |", *rows, ""]))


def pytest_configure(config: pytest.Config) -> None:
    if stale := stale_modules():
        raise pytest.UsageError(
            f"the installed hd_diag is not this tree's ({', '.join(stale)}): run `make install`"
        )
    config.began, config.ros_domain = time.monotonic(), claim_domain()
    os.environ["ROS_DOMAIN_ID"] = str(config.ros_domain[1])
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    # The ROS wheels do not announce their path; a sourced ROS does.
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)


# They share diagnosed records (report_samples) or the browser, so one process computes them once.
DIAGNOSED = ("diagnose", "report", "report_browser", "fleet_page")
# First to start, so that all processes end together. Live nodes mostly wait, and two at once would leave a
# core idle: the longest start first, others after computing tests, `replay_live` late because of its name.
LONGEST = ("nodes", "diagnosed", "docs", "demo", "cli_fleet", "watch_live", "node", "monitor_model")


def kept_together(file: Path) -> str:
    """Name of the group that one process runs: the file's own name, or that of several files."""
    name = file.stem.removeprefix("test_")
    return "diagnosed" if name in DIAGNOSED else "nodes" if name.startswith("node_") else name


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    begin = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: begin.get(kept_together(item.path), len(begin)))


def pytest_collection_finish() -> None:
    """Exempt collected objects from garbage collection; each, as in a replay, took half a second."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Keep a file in one process, so that module fixtures are built once. Live nodes run in turn."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return kept_together(Path(nodeid.partition("::")[0]))

    return ByFile(config, log)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """One Chromium for the pages of a process: starting and ending it takes three seconds."""
    with headless.chromium() as driver:
        yield driver


@pytest.fixture(scope="module")
def accuracy_once() -> Iterator[None]:
    """Compute a record's accuracy once: hundreds of answers need it, and each takes a tenth of a second."""
    known: dict[Any, Any] = {}

    def once(record: Any, kinematics: Any, torque: float, orders: list[float], noise: Any) -> Any:
        key = id(record), kinematics, torque, tuple(orders), noise
        known[key] = (
            known[key] if key in known else (accuracy(record, kinematics, torque, orders, noise), record)
        )
        return known[key][0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hd_diag.diagnosis.judgement.accuracy", once)
        yield


@pytest.fixture(scope="session", autouse=True)
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Run in a folder from which a test's subprocess imports the installed package, not the tree.

    The log files of all nodes stay out of the home folder.
    """
    os.environ["ROS_LOG_DIR"] = str(tmp_path_factory.mktemp("ros_log"))
    here = os.getcwd()
    os.chdir(tmp_path_factory.mktemp("elsewhere"))
    yield
    os.chdir(here)


@pytest.fixture(scope="module")
def ros() -> Iterator[None]:
    """ROS in this process for the tests of a module."""
    import rclpy

    rclpy.init()
    yield
    rclpy.try_shutdown()


def source_files() -> list[str]:
    """Files of the source tree according to git; empty without a usable git."""
    if not (ROOT / ".git").exists() or not shutil.which("git"):
        return []
    command = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, capture_output=True, text=True)
    return [name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


@pytest.fixture(scope="module")
def source_copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy of the source tree like a clean checkout."""
    copy = tmp_path_factory.mktemp("source") / "hd_diag"
    names = source_files()
    if not names:
        return Path(shutil.copytree(ROOT, copy, ignore=NOT_SOURCE))
    for name in names:
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, copy / name)
    return copy


@pytest.fixture(scope="session")
def paper_mesh() -> Mesh:
    """The paper's drive without assembly errors."""
    return drives.mesh()


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Use this folder for temporary files."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    return tmp_path / "scratch"
