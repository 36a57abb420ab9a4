"""The generator of test records shares no code with what it tests."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

TEST = Path(__file__).resolve().parent
SOURCES = sorted((TEST / "challenge").glob("**/*.py")) + sorted((TEST / "reference").glob("**/*.py"))
UNDER_TEST = "hd_diag"


def imported(tree: ast.AST) -> set[str]:
    """Roots of all that a module names in an import, also in strings handed to import_module."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add("." * node.level + (node.module or ""))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "\n" not in node.value:
            names |= {node.value} if node.value.split(".")[0] == UNDER_TEST else set()
    return {name.split(".")[0] for name in names}


def loaded_by(statement: str, path: Path = TEST) -> set[str]:
    """Roots of the modules that a fresh interpreter holds after a statement."""
    code = f"import sys; sys.path.insert(0, {str(path)!r}); {statement}; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    return {name.split(".")[0] for name in run.stdout.split()}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_no_source_names_the_package(path: Path) -> None:
    assert UNDER_TEST not in imported(ast.parse(path.read_text()))


def test_no_module_loads_the_package() -> None:
    modules = [f"{path.parent.name}.{path.stem}" for path in SOURCES if path.stem != "__init__"]
    loaded = loaded_by("import " + ", ".join(modules))
    assert {"challenge", "reference"} <= loaded
    assert UNDER_TEST not in loaded


@pytest.mark.parametrize(
    "line",
    ["import hd_diag", "from hd_diag.model import torsion", "import hd_diag.bag as b", "x = 'hd_diag.drive'"],
)
def test_a_line_that_shares_code_is_seen(line: str) -> None:
    assert UNDER_TEST in imported(ast.parse(line))


def test_a_module_that_shares_code_is_seen() -> None:
    assert UNDER_TEST in loaded_by("import hd_diag", TEST.parent)


def test_all_sources_are_walked() -> None:
    assert {"clearances", "contact", "mesh_causes", "records", "families", "polyline"} <= {
        p.stem for p in SOURCES
    }
