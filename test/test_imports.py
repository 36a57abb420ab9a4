"""Imports point one way, without circles, and the core starts without the edges' libraries."""

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
# Each entry may import those before it; rooms of one entry may not import each other.
CHAIN = (
    "arrays formatting memory process_pool whole_file",
    *("model", "drive", "gears", "effects", "extended_model", "streams"),
    "monitor diagnosis",
    *("config", "messages", "bag", "records", "public", "replay", "simulation", "ros"),
    *("tolerance", "report", "fleet", "watch", "cli", "__main__"),
)
PLACE = {room: i for i, rooms in enumerate(CHAIN) for room in rooms.split()}
CORE = [*CHAIN[1:7], "monitor", "diagnosis", "tolerance"]
# The only modules that may name the libraries of the edges.
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
    found = {}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        found[".".join((*prefix.split(), *parts)).removesuffix(".__init__")] = path
    return found


PACKAGE = modules(ROOT / "hd_diag", "hd_diag")
# The challenge's records are among the tests, under the name of the script that uses them.
CHALLENGE = modules(ROOT / "test/challenge", "challenge")
BENCH = modules(ROOT / "bench") | CHALLENGE
INDEPENDENT = CHALLENGE | modules(ROOT / "test/reference", "reference")


@functools.cache
def named(path: Path) -> list[str]:
    """All imports of a module, including those inside functions."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


def graph(of: dict[str, Path]) -> dict[str, set[str]]:
    """For each module of a tree, the modules of that tree it imports."""
    return {
        module: {name if name in of else name.rpartition(".")[0] for name in named(path)} & of.keys()
        for module, path in of.items()
    }


def room(module: str) -> str:
    return module.split(".")[1]


@pytest.mark.parametrize("of", [PACKAGE, BENCH], ids=["package", "bench"])
def test_modules_import_each_other_without_circles(of: dict[str, Path], tmp_path: Path) -> None:
    """Imports inside functions count too: they would only hide a circle."""
    graphlib.TopologicalSorter(graph(of)).prepare()
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
    def may(module: str, name: str) -> bool:
        inside = OWNERS.get(name.partition(".")[0])
        return inside is None or module.startswith(tuple(f"hd_diag.{place}" for place in inside))

    assert [(m, name) for m, path in PACKAGE.items() for name in named(path) if not may(m, name)] == []


def test_what_the_package_is_measured_by_shares_no_code_with_it() -> None:
    """No import, no import by name in a string, and nothing in a process that loads all of them."""
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


def test_a_core_room_loads_no_edge() -> None:
    """A separate process imports all of a room except for its kernels.

    Kernels need numba, which is loaded with the first computation.
    """
    inside = [module for module in PACKAGE if "." in module and ".kernel" not in module]
    rooms = {name: [module for module in inside if room(module) == name] for name in CORE}
    statements = {name: f"import {', '.join(found)}" for name, found in rooms.items()} | {"": "import click"}
    command = [sys.executable, "-c", LOOK, json.dumps(statements)]
    run = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)
    known, told = {*OWNERS, "numba", "hd_diag"}, json.loads(run.stdout)
    loaded = {name: known.intersection(found) for name, found in told.items()}
    assert loaded == {name: {"hd_diag"} for name in CORE} | {"": {"click"}}  # edges would be seen


VERB = """
import os, sys
from hd_diag.__main__ import main
try:
    main()
finally:
    print(*{name.partition(".")[0] for name in sys.modules}, *sys.modules, file=sys.stderr)
"""
PAGE = {"size": 25, "ratio": 100.0, "rated_torque": 67.0, "k1": 3.1e4, "k2": 5e4, "k3": 5.7e4}
SLOW = {"numpy", "scipy", "numba", "llvmlite", "yaml", "rich", "rosbags", "mcap", "matplotlib", "jinja2"}


@pytest.mark.parametrize(
    ("words", "may"),
    [
        ("check {file}", {"numpy", "yaml"}),
        ("mesh --config {file}", {"numpy", "yaml", "rich", "numba", "llvmlite", "scipy"}),
    ],
)
def test_a_verb_loads_what_it_needs_alone(words: str, may: set[str], tmp_path: Path) -> None:
    """For slow imports: `check` of any drive needs neither kernels nor scipy, and a mesh no effects."""
    page = {f"gear__{name}": value for name, value in PAGE.items()}
    file = config_file(tmp_path, **(page if words.startswith("check") else {}))
    command = [sys.executable, "-c", VERB, *words.format(file=file).split()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0
    assert set(run.stderr.split()) & {*SLOW, "rclpy", "hd_diag.effects", "hd_diag.bag.reader"} <= may
