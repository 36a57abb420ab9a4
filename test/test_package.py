"""The package as distributed: a wheel built from a copy of the tree, package.xml, changelog and locks."""

import email
import os
import re
import shutil
import subprocess
import sys
import tempfile
import venv
import zipfile
from email.message import Message
from pathlib import Path

import pytest
from catkin_pkg.package import Package, parse_package
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from hd_diag.cli import fleet as cli_fleet

ROOT = Path(__file__).resolve().parent.parent
LOCKS = ("demo", "test", "ubuntu", "challenge")
# The complete grammar of a lock line: it allows no option, address or path.
LOCK_LINE = re.compile(
    r"|((    )?#.*|[a-z0-9-]+==[^\s;]+( ; [^\\/]+)? \\|    --hash=sha256:[0-9a-f]{64}( \\)?)"
)


@pytest.fixture(scope="module")
def wheel(source_copy: Path, tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    out = tmp_path_factory.mktemp("wheel")
    build = f"from setuptools import build_meta; build_meta.build_wheel({str(out)!r})"
    command = [sys.executable, "-c", build]
    subprocess.run(command, cwd=source_copy, check=True, capture_output=True, timeout=120)
    return zipfile.ZipFile(next(out.glob("*.whl")))


@pytest.fixture(scope="module")
def metadata(wheel: zipfile.ZipFile) -> Message:
    name = next(name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    return email.message_from_bytes(wheel.read(name))


@pytest.fixture(scope="module")
def requirements(metadata: Message) -> list[Requirement]:
    return [Requirement(text) for text in metadata.get_all("Requires-Dist")]


@pytest.fixture(scope="module")
def package_xml() -> Package:
    warnings: list[str] = []
    package = parse_package(str(ROOT / "package.xml"), warnings=warnings)
    assert warnings == []
    return package


def locked(name: str) -> list[tuple[str, str]]:
    """Name and version of every entry of a lock; a name has one entry per range of Python versions."""
    return re.findall(r"(?m)^([a-z0-9-]+)==([^\s;]+)", (ROOT / f"requirements/{name}.txt").read_text())


def test_version_and_licence_agree(metadata: Message, package_xml: Package) -> None:
    assert metadata["Name"] == package_xml.name == "hd_diag"
    assert metadata["Version"] == package_xml.version
    newest = re.findall(r"(?m)^(\S+).*\n-{3,}$", (ROOT / "CHANGELOG.rst").read_text())[0]
    assert newest in ("Forthcoming", package_xml.version)
    assert [licence.file for licence in package_xml.licenses] == ["LICENSE"]
    told = metadata.get("License-Expression", metadata["License"])
    assert told == str(package_xml.licenses[0]) == "Apache-2.0"


def test_everything_is_installed(wheel: zipfile.ZipFile, source_copy: Path) -> None:
    """Modules, templates of the page, data files and the entry of the ament index."""
    files = {path.relative_to(source_copy).as_posix() for path in source_copy.rglob("*") if path.is_file()}
    package = {name for name in files if re.match(r"hd_diag/(.*\.(py|csv|typed)$|report/templates/)", name)}
    data = {name for name in files if re.match(r"(config|launch|examples)/", name)}
    assert len(package) > 100
    assert {name.partition("/")[0] for name in data} == {"config", "launch", "examples"}
    installed = {name for name in wheel.namelist() if ".data/" not in name and ".dist-info/" not in name}
    assert installed == package
    shared = {name.partition("/data/share/")[2] for name in wheel.namelist()}
    index = "ament_index/resource_index/packages/hd_diag"
    assert {index, "hd_diag/package.xml", *(f"hd_diag/{name}" for name in data)} <= shared


def test_ranges_have_both_bounds_and_every_dependency_has_a_reason(requirements: list[Requirement]) -> None:
    reasons = (ROOT / "CONTRIBUTING.md").read_text()
    for requirement in requirements:
        operators = {specifier.operator for specifier in requirement.specifier}
        assert operators in ({">=", "<"}, {"=="}), requirement
        assert f"`{requirement.name}`" in reasons


@pytest.mark.parametrize("lock", LOCKS)
def test_locked_versions_are_in_range(requirements: list[Requirement], lock: str) -> None:
    ranges = {canonicalize_name(requirement.name): requirement.specifier for requirement in requirements}
    in_lock = [(name, version) for name, version in locked(lock) if name in ranges]
    runtime = {canonicalize_name(r.name) for r in requirements if r.marker is None}
    assert runtime <= {name for name, _ in in_lock}
    assert [(name, version) for name, version in in_lock if version not in ranges[name]] == []


def test_the_demo_leaves_out_what_the_fleet_alone_needs(requirements: list[Requirement]) -> None:
    """They take 170 MB and are an extra: `make test` installs it, and `hd-diag fleet` names it."""
    alone = {r.name for r in requirements if r.marker and r.marker.evaluate({"extra": "fleet"})}
    assert alone == {"pyarrow", "ruptures"} == set(cli_fleet._NEEDED)
    assert alone <= {name for name, _ in locked("test")}
    assert not alone & {name for name, _ in locked("demo")}
    assert {*locked("demo")} <= {*locked("test")}  # with the same versions


@pytest.mark.parametrize("lock", [*LOCKS, "test-source"])
def test_a_lock_names_no_place_and_has_a_hash_for_every_entry(lock: str) -> None:
    text = (ROOT / f"requirements/{lock}.txt").read_text()
    assert [line for line in text.splitlines() if not LOCK_LINE.fullmatch(line)] == []
    assert [line for line in text.splitlines() if re.search("://|/root/|/home/", line)] == []
    entries = re.split(r"(?m)^(?=[a-z])", text)[1:]
    assert len(entries) == len(locked(lock))
    assert all("--hash=sha256:" in entry for entry in entries)


# make ---


def test_make_works_on_a_copy_of_a_tree_that_is_read_only() -> None:
    """It reports the copy's folder; a later run keeps environments, but no file missing from the tree."""
    with tempfile.TemporaryDirectory() as folder:  # others can enter it; root could write everywhere
        place, tree, cache = Path(folder), Path(folder) / "tree", Path(folder) / "cache"
        shutil.copytree(ROOT / "scripts", tree / "scripts")
        shutil.copy(ROOT / "Makefile", tree)
        cache.mkdir()
        for path, mode in ((place, 0o755), (cache, 0o777), (tree / "scripts", 0o555), (tree, 0o555)):
            path.chmod(mode)
        other = {"user": 65534} if os.geteuid() == 0 else {}

        def lines() -> list[str]:
            kept = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
            own = {"cwd": tree, "env": {**kept, "XDG_CACHE_HOME": str(cache)}, **other}
            run = subprocess.run(["make", "help"], capture_output=True, text=True, timeout=60, **own)
            assert (run.returncode, run.stderr) == (0, "")
            return run.stdout.splitlines()

        said = lines()
        (copy,) = cache.iterdir()
        assert said[0] == f"== This tree is read-only: make works in {copy}"
        assert said[1].startswith("make demo ")
        for name in (".venv", "gone"):
            (copy / name).mkdir()
        assert lines() == said
        assert sorted(path.name for path in copy.iterdir()) == [".venv", "Makefile", "scripts"]
        (tree / "scripts").chmod(0o755)
        tree.chmod(0o755)


def find_python(*words: object, path: Path | None = None) -> Path:
    """Output of scripts/find_python.sh, with a folder in front of the others on the PATH."""
    env = {**os.environ, "PATH": os.pathsep.join([*([str(path)] if path else []), os.environ["PATH"]])}
    command = ["sh", str(ROOT / "scripts" / "find_python.sh"), *map(str, words)]
    run = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stderr) == (0, "")
    return Path(run.stdout.strip())


def test_an_environment_keeps_its_python_unless_another_is_named_or_it_is_active(tmp_path: Path) -> None:
    """The active environment may be the one being made again."""
    base, other = find_python(), tmp_path / "other"
    other.symlink_to(base)
    stamp = tmp_path / "lock.stamp"
    for maker, named, expected in ((other, "", other), (tmp_path / "gone", "", base), (other, base, base)):
        stamp.write_text(f"/tree {maker} Python 3 1 2\n")
        assert find_python(named, tmp_path) == expected
    venv.create(tmp_path / "active", with_pip=False)
    own = tmp_path / "active" / "bin"
    found = find_python(own / "python", path=own)
    assert found.exists()
    assert not found.is_relative_to(tmp_path)
