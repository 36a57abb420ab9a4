"""The core is arithmetic: none of its modules needs ROS, files or pictures."""

import importlib.util
import json
import pkgutil
import subprocess
import sys

import pytest

CORE = (
    "hd_diag.streams.columns",
    "hd_diag.model",
    "hd_diag.effects",
    "hd_diag.drive",
    "hd_diag.monitor",
    "hd_diag.diagnosis",
    "hd_diag.tolerance",
)
# These are numba's, which reads yaml itself; the rest of the core must start without them.
KERNELS = ("hd_diag.model.kernel", "hd_diag.tolerance.kernel", "hd_diag.streams.kernel")
EDGES = {"rclpy", "rosbags", "mcap", "yaml", "matplotlib", "click", "rich", "sensor_msgs", "diagnostic_msgs"}
LATER = {"numba"}  # imported when something is first computed


def core_modules() -> list[str]:
    """Names of the core's modules and of the modules inside its packages, without importing them."""
    names = []
    for name in CORE:
        spec = importlib.util.find_spec(name)
        if spec is None:
            continue
        names.append(name)
        inside = spec.submodule_search_locations or []
        names += [module.name for module in pkgutil.walk_packages(inside, prefix=f"{name}.")]
    return [name for name in names if not name.startswith(KERNELS)]


def imported_by(statement: str) -> set[str]:
    """Top-level modules that a fresh process has loaded after the statement, beyond those it starts with."""
    code = (
        f"import json, sys; before = set(sys.modules); {statement};"
        "print(json.dumps(sorted({name.partition('.')[0] for name in set(sys.modules) - before})))"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60)
    return set(json.loads(run.stdout))


@pytest.mark.parametrize("module", core_modules())
def test_core_module_imports_no_edge(module: str) -> None:
    loaded = imported_by(f"import {module}")
    assert "hd_diag" in loaded
    assert not loaded & (EDGES | LATER)


def test_core_is_found() -> None:
    assert {*CORE, "hd_diag.model.tooth_profile", "hd_diag.tolerance.study"} <= set(core_modules())


def test_an_edge_would_be_seen() -> None:
    assert "yaml" in imported_by("import yaml")
