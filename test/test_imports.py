"""Imports point one way, without circles, and the core starts without what belongs to the edges."""

import ast
import functools
import graphlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from cli_runner import config_file

ROOT = Path(__file__).resolve().parent.parent
# Each line may import the lines above it; what stands in one line does not know each other.
CHAIN = (
    ("arrays", "formatting", "memory", "process_pool", "whole_file"),
    ("model",),
    ("drive",),
    ("gears",),
    ("effects",),
    ("extended_model",),
    ("streams",),
    ("monitor", "diagnosis"),
    ("config",),
    ("messages",),
    ("bag",),
    ("records",),
    ("public",),
    ("replay",),
    ("simulation",),
    ("ros",),
    ("tolerance",),
    ("report",),
    ("fleet",),
    ("watch",),
    ("cli",),
    ("__main__",),
)
PLACE = {room: i for i, rooms in enumerate(CHAIN) for room in rooms}
CORE = (
    *("model", "drive", "gears", "effects", "extended_model", "streams", "monitor", "diagnosis", "tolerance"),
)
# Where the libraries of the edges may be named, in whatever part of a module.
ROS = ("ros", "watch")
OWNERS = {
    **dict.fromkeys(("rclpy", "rcl_interfaces", "sensor_msgs", "diagnostic_msgs", "visualization_msgs"), ROS),
    "matplotlib": ("report.pictures", "fleet.plots"),
    "yaml": ("config", "bag"),
    "mcap": ("bag",),
    "rosbags": ("bag", "messages", "records"),
    "click": ("cli",),
    "rich": ("cli", "watch", "fleet"),
    "jinja2": ("report",),
    "pyarrow": ("fleet",),
    "ruptures": ("fleet",),
    "distributed": ("fleet",),
}


def modules(folder: Path, prefix: str = "") -> dict[str, Path]:
    """Modules of a folder by their dotted names."""
    found = {}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        found[".".join((*prefix.split(), *parts)).removesuffix(".__init__")] = path
    return found


PACKAGE = modules(ROOT / "hd_diag", "hd_diag")
# The challenge's records stand among the tests, under the name of the script that uses them.
CHALLENGE = modules(ROOT / "test/challenge", "challenge")
BENCH = modules(ROOT / "bench") | CHALLENGE
INDEPENDENT = CHALLENGE | modules(ROOT / "test/reference", "reference")


@functools.cache
def named(path: Path) -> list[str]:
    """What a module imports, inside functions too."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


def graph(of: dict[str, Path]) -> dict[str, set[str]]:
    """Modules of a tree that each of its modules imports."""
    return {
        module: {name if name in of else name.rpartition(".")[0] for name in named(path)} & of.keys()
        for module, path in of.items()
    }


def room(module: str) -> str:
    return module.split(".")[1]


@pytest.mark.parametrize("of", [PACKAGE, BENCH], ids=["package", "bench"])
def test_modules_import_each_other_without_circles(of: dict[str, Path]) -> None:
    """Whatever stands in a function counts too: it would only hide the circle."""
    graphlib.TopologicalSorter(graph(of)).prepare()


def test_a_circle_would_be_seen(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("import b")
    (tmp_path / "b.py").write_text("def f():\n    from a import x\n")
    with pytest.raises(graphlib.CycleError):
        graphlib.TopologicalSorter(graph(modules(tmp_path))).prepare()


def test_rooms_import_earlier_ones_alone() -> None:
    pairs = [(a, b) for a, found in graph(PACKAGE).items() for b in found if "." in a and "." in b]
    assert {room(module) for module in PACKAGE if "." in module} == PLACE.keys()
    wrong = [(a, b) for a, b in pairs if room(a) != room(b) and PLACE[room(a)] <= PLACE[room(b)]]
    assert sorted(wrong) == []


def test_libraries_of_the_edges_stay_there() -> None:
    wrong = [
        (module, name)
        for module, path in PACKAGE.items()
        for name in sorted(set(named(path)))
        for inside in [OWNERS.get(name.partition(".")[0])]
        if inside and not module.startswith(tuple(f"hd_diag.{place}" for place in inside))
    ]
    assert wrong == []


def test_what_the_package_is_measured_by_shares_no_code_with_it() -> None:
    """No import, none by a name in a string, and none of what a process has loaded with all of it."""
    assert {"challenge.records", "challenge.clearances", "reference.polyline"} <= INDEPENDENT.keys()
    named = re.compile(r"^ *(import|from) hd_diag|['\"]hd_diag['\".]", re.MULTILINE)
    assert [m for m, path in INDEPENDENT.items() if named.search(path.read_text(encoding="utf-8"))] == []
    look = "print('hd_diag' in sys.modules)"
    path = f"sys.path[:0] = {[str(ROOT / 'test'), *sys.path]}"
    code = f"import sys; {path}; import {', '.join(INDEPENDENT)}; {look}; import hd_diag; {look}"
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout == "False\nTrue\n"


LOOK = """
import json, os, sys, numpy, scipy
before, found = set(sys.modules), {}
for name, statement in json.loads(sys.argv[1]).items():
    reader, writer = os.pipe()
    if os.fork() == 0:
        exec(statement)
        loaded = sorted({module.partition(".")[0] for module in set(sys.modules) - before})
        os.write(writer, json.dumps(loaded).encode())
        os._exit(0)
    os.close(writer)
    found[name] = json.loads(os.fdopen(reader).read())
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def loaded() -> dict[str, set[str]]:
    """Top-level modules that a process of its own has loaded after importing all of a room but its kernels.

    These are numba's, which comes when something is first computed.
    """
    inside = {
        name: [module for module in PACKAGE if module.split(".")[1:2] == [name] and ".kernel" not in module]
        for name in CORE
    }
    statements = {name: f"import {', '.join(found)}" for name, found in inside.items()}
    run = subprocess.run(
        [sys.executable, "-c", LOOK, json.dumps({**statements, "an edge": "import click"})],
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
    )
    return {name: set(found) for name, found in json.loads(run.stdout).items()}


@pytest.mark.parametrize("name", CORE)
def test_a_core_room_loads_no_edge(name: str, loaded: dict[str, set[str]]) -> None:
    assert "hd_diag" in loaded[name]
    assert not loaded[name] & {*OWNERS, "numba"}


def test_an_edge_would_be_seen(loaded: dict[str, set[str]]) -> None:
    assert "click" in loaded["an edge"]


VERB = """
import os, sys
from hd_diag.__main__ import main
try:
    main()
finally:
    print(*{name.partition(".")[0] for name in sys.modules}, *sys.modules, file=sys.stderr)
"""
PAGE = {"size": 25, "ratio": 100.0, "rated_torque": 67.0, "k1": 3.1e4, "k2": 5e4, "k3": 5.7e4}
SLOW = {
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "yaml",
    "rich",
    "rosbags",
    "mcap",
    "matplotlib",
    "jinja2",
    "rclpy",
}


@pytest.mark.parametrize(
    ("words", "may"),
    [
        ("check {file}", {"numpy", "yaml"}),
        ("mesh --config {file}", {"numpy", "yaml", "rich", "numba", "llvmlite", "scipy"}),
    ],
)
def test_a_verb_loads_what_it_needs_alone(words: str, may: set[str], tmp_path: Path) -> None:
    """What takes long: `check` of any drive needs neither kernels nor scipy, and a mesh no effects."""
    page = {f"gear__{name}": value for name, value in PAGE.items()}
    file = config_file(tmp_path, **(page if words.startswith("check") else {}))
    command = [sys.executable, "-c", VERB, *words.format(file=file).split()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0
    assert set(run.stderr.split()) & {*SLOW, "hd_diag.effects", "hd_diag.bag.reader"} <= may
