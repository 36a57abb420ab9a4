"""Memory limits: 250 MB for the node, 300 MB for a replay; small cases take a known part."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from bag_samples import JOINT_STATE, rows
from pool_tasks import wait_for
from running import START_LIMIT, Process

from hd_diag.bag import BagWriter
from hd_diag.config.configuration import dump, resolve
from hd_diag.memory import give_back, is_memory, map_large_arrays
from hd_diag.replay.preparation import changed_since

SEVEN: dict = {"joints": [f"joint_{k}" for k in range(1, 8)]}
"""Seven drives whose maps never repeat and have nothing in common."""
SEVEN |= {f"joint_{k}.eccentricity.magnitude": 1e-6 * k for k in range(1, 8)}
SEVEN |= {f"joint_{k}.runout.magnitude": 4e-6 for k in range(1, 8)}


VERB = """
import sys
from pathlib import Path
from hd_diag.cli import cli
try:
    cli(sys.argv[1:])
except SystemExit as end:
    assert not end.code, end.code
print(*{"scipy.linalg", "scipy.optimize", "hd_diag.diagnosis"} & {*sys.modules})
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
"""


def python(code: str, words: str = "", **how) -> list[str]:
    command = [sys.executable, "-c", code, *words.split()]
    return subprocess.run(command, capture_output=True, text=True, check=True, **how).stdout.splitlines()


def replay(folder: Path, seconds: int, given: dict) -> float:
    """Peak memory of a 1 kHz replay of joints [MB]; it imports neither fits nor scipy.linalg."""
    config, size = resolve(given), 1000 * seconds
    names = [name for joint in config.joints for name in (joint.input_joint, joint.output_joint)]
    block, stamps = rows(size, names=names)
    with BagWriter(folder / "a.mcap", chunk_size=64 << 20, flush_period=1e9) as writer:
        writer.write_many("/joint_states", JOINT_STATE, block, stamps)
    (folder / "a.yaml").write_text(dump(config))
    *_, imported, found = python(VERB, "replay a.mcap --config a.yaml --out out.mcap", cwd=folder)
    assert not imported
    return int(found) * 1.024e-3


def test_replay_of_a_joint(tmp_path: Path) -> None:
    assert replay(tmp_path, 60, {}) < 230


@pytest.mark.slow  # 8 s: a whole diagnosis
def test_a_diagnosis_without_a_search(tmp_path: Path) -> None:
    """For 20 s at 500 Hz. Memory of the compilation is released before; otherwise it takes 340 MB."""
    python(VERB, "simulate --duration 20 --eccentricity-um 10 --out a.mcap", cwd=tmp_path)
    found = python(VERB, "diagnose a.mcap --time-limit 0", cwd=tmp_path)[-1]
    assert int(found) * 1.024e-3 < 300


@pytest.mark.slow  # 10 s: seven maps, and blocks of all their columns
def test_replay_of_seven_drives_that_share_no_map(tmp_path: Path) -> None:
    assert replay(tmp_path, 60, SEVEN) < 300


@pytest.mark.slow  # 6 s: seven maps
def test_a_node_with_seven_drives_that_share_no_map(tmp_path: Path) -> None:
    with Process(tmp_path, SEVEN) as node:
        wait_for(lambda: node.output().count("map in force") == 7, START_LIMIT)
        status = Path(f"/proc/{node.popen.pid}/status").read_text()
        assert int(status.partition("VmHWM:")[2].split()[0]) * 1.024e-3 < 250


def test_a_kernel_that_changed_is_compiled_apart_too(tmp_path: Path) -> None:
    """A kernel counts as changed if any kernel's source is newer than its machine code."""
    own, kept = SimpleNamespace(__qualname__="read_1"), SimpleNamespace(cache_path=str(tmp_path))
    kernel = SimpleNamespace(py_func=own, stats=kept)
    (tmp_path / "k.read_1-9.py312.nbi").touch()
    assert not changed_since(kernel)
    os.utime(tmp_path / "k.read_1-9.py312.nbi", (0.0, 0.0))
    assert changed_since(kernel)


COMPILED = """
import gc
from numba.core.registry import CPUDispatcher
from hd_diag.config.configuration import resolve
from hd_diag.replay.preparation import entry_points, prepare

prepare(resolve({}))
dispatchers = [each for each in gc.get_objects() if isinstance(each, CPUDispatcher)]
used = {each for each in dispatchers if each.signatures and each.stats.cache_path is not None}
print({each.py_func.__qualname__ for each in used ^ {*entry_points()}})
"""


def test_all_that_the_node_compiles_is_looked_for_before() -> None:
    """After a diagnosis on a fresh machine only some were compiled, and the node then compiled the others."""
    assert python(COMPILED) == ["set()"]


GIVEN_BACK = """
import re, numba
from pathlib import Path
from hd_diag.memory import give_back, is_memory, map_large_arrays

def resident():
    maps = re.split(r"(?m)^(?=[0-9a-f]+-[0-9a-f]+ )", Path("/proc/self/smaps").read_text())
    return sum(int(re.search(r"Rss: +([0-9]+)", m)[1]) for m in maps if "libllvmlite.so" in m)

numba.njit(lambda x: x + 1)(1)
before = resident()
give_back()
print(before, resident())
print(numba.njit(lambda x: x + 2)(1))
"""


def test_what_llvm_reads_from_its_file_is_given_back() -> None:
    """Everything except its address tables, which differ from the file; LLVM still works."""
    before, after, result = map(int, " ".join(python(GIVEN_BACK)).split())
    assert (before > 20_000, after < 4_000, result) == (True, True, 3)  # [kB]


def test_another_libc_gives_no_memory_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hd_diag.memory.ctypes.CDLL", lambda name: object())
    give_back()
    map_large_arrays()


FREED = """
from pathlib import Path
import numpy as np
from hd_diag.memory import map_large_arrays

def resident():
    return int(Path("/proc/self/status").read_text().partition("VmRSS:")[2].split()[0])

if {mapped}:
    map_large_arrays()
del (first := [np.ones(3 << 20)])[:]  # 24 MiB: from then on libc keeps rooms of that size
before, many = resident(), [np.ones(1 << 20) for _ in range(8)]
last = bytearray(100)
del many[:7]
print(resident() - before)
"""


def test_large_arrays_are_given_back_when_they_are_freed() -> None:
    """Seven of eight arrays of 8 MiB; without mapping, one array in use behind them holds all."""
    mapped, usual = (int(python(FREED.format(mapped=mapped))[0]) for mapped in (True, False))
    assert mapped < 10_000 < 60_000 < usual  # [kB]


LACKS = [MemoryError(), OSError(errno.ENOMEM, "no memory"), RuntimeError("can't start new thread")]
LACKS += [ImportError("libLLVM.so: failed to map segment from shared object")]
OTHERS = [OSError(errno.ENOENT, "no such file"), ImportError("No module named 'x'")]


@pytest.mark.parametrize(("error", "is_so"), [*((e, True) for e in LACKS), *((e, False) for e in OTHERS)])
def test_a_lack_of_memory_is_known_in_all_its_forms(error: Exception, is_so: bool) -> None:
    """Also as the cause of another error, for example a failed import."""
    wrapped = ImportError("numpy's own words")
    wrapped.__cause__ = error
    assert (is_memory(error), is_memory(wrapped)) == (is_so, is_so)
    one, other = ValueError("one"), ValueError("other")  # each was raised while the other was handled
    one.__context__, other.__context__ = other, one
    assert not is_memory(one)


@pytest.mark.parametrize("ended", ["os._exit(1)", "os._exit(127)", "os.abort()"])
def test_a_library_out_of_memory_is_one_line(ended: str) -> None:
    """The library's own text is hidden: OpenBLAS exits with 1 and three lines, the loader with 127."""
    code = f"from hd_diag.memory import watch_limit; import os; watch_limit(); os.write(2, b'words'); {ended}"
    said = "hd-diag: there is not enough memory: ulimit -v is 20000000 kB\n"
    assert limited(20_000_000, "-c", code) == (2, "", said)


def test_what_ends_of_itself_below_a_limit_ends_as_without() -> None:
    start = "from hd_diag.memory import watch_limit; import os, sys, signal; watch_limit()"
    assert limited(20_000_000, "-c", f"{start}; print(1); sys.exit('no')") == (1, "1\n", "no\n")
    killed = f"{start}; os.kill(os.getppid(), signal.SIGTERM); signal.pause()"
    assert limited(20_000_000, "-c", killed) == (128 + signal.SIGTERM, "", "")


@pytest.mark.parametrize("limit", [60_000, 150_000, 300_000, 400_000])
def test_a_limit_of_memory_ends_in_a_result_or_one_line(limit: int, tmp_path: Path) -> None:
    """Address space [kB] too small for OpenBLAS, for numba, or for the data."""
    file = tmp_path / "a.csv"
    file.write_text("t,x,y\n" + "".join(f"{0.01 * k},{k % 700},{k % 700 / 100}\n" for k in range(9000)))
    code, shown, said = limited(limit, "-m", "hd_diag", "topics", str(file))
    assert (code, "not enough memory" in said, said.count("\n")) in ((2, True, 1), (0, False, 0)), said
    assert (code == 0) == bool(shown)


def limited(limit: int, *words: str) -> tuple[int, str, str]:
    command = ["bash", "-c", f'ulimit -v {limit}; exec "$0" "$@"', sys.executable, *words]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    return run.returncode, run.stdout, run.stderr
