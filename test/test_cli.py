"""The command line: help of every verb, exit codes, one-line errors, and the content of `mesh --json`."""

import contextlib
import gc
import importlib.abc
import itertools
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import weakref
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import click
import numpy as np
import pytest
from cli_runner import assert_one_line_error, config_file, files_up_to, hd_diag

from hd_diag.__main__ import main
from hd_diag.cli import cli
from hd_diag.cli.options import Source, Target
from hd_diag.cli.verbs import main as run_verbs
from hd_diag.config.configuration import dump, resolve
from hd_diag.ros.stop_signals import Stopped, signalled


def mesh(*arguments: object) -> dict[str, Any]:
    result = hd_diag("mesh", *arguments, "--json", "-")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


# Help and usage ---


@pytest.mark.parametrize("verb", cli.commands)
def test_every_verb_has_help_and_an_example_that_its_parser_takes(verb: str) -> None:
    command, told = cli.commands[verb], hd_diag(verb, "--help", terminal_width=80)
    assert (told.exit_code, told.output) == (0, hd_diag(verb, "-h", terminal_width=80).output)
    assert told.output.startswith(f"Usage: cli {verb} ")
    assert command.help.splitlines()[0].split(":")[0] in " ".join(told.output.split())
    example = command.epilog.splitlines()[-1]
    assert example in told.output  # on one line
    name, own, *words = shlex.split(example.removeprefix("Example: "))
    assert (name, own) == ("hd-diag", verb)
    command.make_context(verb, words)


def test_help_and_readme_list_the_verbs_of_the_contract() -> None:
    contract = "demo check mesh simulate replay diagnose report tolerance recover figures fleet watch node"
    assert set(contract.split()) <= set(cli.commands)
    assert (hd_diag().exit_code, hd_diag().output) == (0, hd_diag("--help").output)
    told = hd_diag("--help", terminal_width=80).output.partition("Commands:")[2]
    assert re.findall(r"(?m)^  (\w+)", told) == sorted(cli.commands)
    assert not [line for line in told.splitlines() if line.endswith("...") or len(line) > 80]
    readme = (Path(__file__).resolve().parent.parent / "README.md").read_text()
    told = readme.partition("| task | verbs |")[2].partition("\n\n")[0]
    assert sorted(set(re.findall(r"`([a-z]+)`", told)) & set(cli.commands)) == sorted(cli.commands)
    assert hd_diag("--version").output == "hd-diag, version 0.1.0\n"


def test_help_and_completion_import_nothing_that_is_slow() -> None:
    """The help of all verbs, in one process: it takes a tenth of a second; numpy would double that."""
    code = (
        "import contextlib, io, sys\n"
        "from hd_diag.cli import cli\n"
        "with contextlib.redirect_stdout(io.StringIO()) as told:\n"
        "    verbs = ([verb, '--help'] for verb in cli.commands)\n"
        "    for words in ([], ['--help'], *verbs, ['completion', 'zsh']):\n"
        "        with contextlib.suppress(SystemExit):\n"
        "            cli(words, prog_name='hd-diag')\n"
        "slow = 'numba llvmlite numpy scipy matplotlib jinja2 rclpy rich yaml mcap rosbags'.split()\n"
        "print(told.getvalue().count('Usage: hd-diag '), [name for name in slow if name in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60)
    assert run.stdout == f"{len(cli.commands) + 2} []\n"


def test_blas_has_one_thread_unless_the_user_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads of BLAS spent a quarter of a diagnosis's CPU time waiting for each other."""
    monkeypatch.setattr("hd_diag.cli.verbs.cli", lambda: None)
    for given, wanted in (({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")):
        monkeypatch.setattr(os, "environ", given)
        run_verbs()
        assert given["OPENBLAS_NUM_THREADS"] == wanted


@pytest.fixture
def shells(tmp_path: Path) -> dict[str, str]:
    command = tmp_path / "hd-diag"
    call = "import sys; sys.argv[0] = 'hd-diag'; from hd_diag.__main__ import main; main()"
    command.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -c "{call}" "$@"\n')
    command.chmod(0o755)
    path = f"{tmp_path}:{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "HOME": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}


def test_bash_completes_verbs_options_choices_and_files(shells: dict[str, str]) -> None:
    """The test does what bash does: it sources the script and calls its function for the typed words."""
    typed = ("re", "mesh --to", "gear --output f", "gear --output = f", "mesh --config = con", "check con")
    # compopt works only in an interactive shell.
    script = ['compopt() { echo "compopt $@"; }', "source <(hd-diag completion bash)"]
    for words in typed:
        script.append(f"COMPREPLY=(); COMP_WORDS=(hd-diag {words}); COMP_CWORD={len(words.split())}")
        script.append('_hd_diag_completion hd-diag; echo "${COMPREPLY[@]}"')
    command = ["bash", "-c", "\n".join(script)]
    run = subprocess.run(command, env=shells, capture_output=True, text=True, timeout=60)
    file = ["compopt -o default", ""]
    told = ["recover replay report", "--torque", "flexspline", "flexspline", *file, *file]
    assert (run.stdout.splitlines(), run.stderr) == (told, "")


def test_zsh_and_fish_complete_values_after_an_equals_sign(shells: dict[str, str], tmp_path: Path) -> None:
    """zsh completes only in a terminal, so the test checks that its script keeps the option's name."""
    script = hd_diag("completion", "zsh").output
    assert "compset -P '--*='" in script
    assert "compadd -U" not in script
    assert "| string replace -r '^' -- (string match -r '^--[^=]*=' " in hd_diag("completion", "fish").output
    if not shutil.which("fish"):
        return
    (tmp_path / "joint.yaml").touch()
    typed = ("mesh --config=jo", "gear --output=f", "gear --output f", "mesh --to")
    asked = [f"complete -C 'hd-diag {words}' | string replace -r '\\t.*' ''" for words in typed]
    command = ["fish", "-c", "\n".join(["hd-diag completion fish | source", *asked])]
    run = subprocess.run(command, cwd=tmp_path, env=shells, capture_output=True, text=True, timeout=60)
    told = ["--config=joint.yaml", "--output=flexspline", "flexspline", "--torque"]
    assert (run.stdout.splitlines(), run.stderr) == (told, "")


def test_what_nobody_reads_on_costs_no_file_and_no_exit_code(tmp_path: Path) -> None:
    """``hd-diag ... | head``: diagnose still writes its file and returns the finding as exit code."""
    found, table = tmp_path / "found.json", tmp_path / "table.csv"
    rows = "\n".join(f"{k / 100},{k / 20},{k / 20},0" for k in range(400))  # one sensor given twice
    table.write_text(f"time,input,output,torque\n{rows}\n")
    columns = "time=time,input=input,output=output,torque=torque"
    command = [sys.executable, "-m", "hd_diag", "diagnose", table, "--columns", columns, "--json", found]
    read, write = os.pipe()
    os.close(read)
    run = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, timeout=120)
    os.close(write)
    assert (run.returncode, json.loads(found.read_text())["judgement"]) == (2, "not_judged")


# check ---


def test_check_describes_a_valid_configuration(tmp_path: Path) -> None:
    path = config_file(tmp_path, eccentricity__magnitude=12e-6)
    result = hd_diag("check", path)
    first, *what, last = result.output.splitlines()
    said = "joint_1: joint_1_motor -> joint_1, ratio 100, 200/202 teeth, rated 56 N m, eccentricity 12 µm"
    assert (result.exit_code, first, last) == (0, said, f"{path}: valid")
    for part in ("module 0.3 mm", "K1 2.8", "lost motion 0 arcsec", "overlap of the lobes", "at 10 µm"):
        assert part in "\n".join(what)
    told = json.loads(hd_diag("check", path, "--json", "-").stdout)
    assert (told["schema"], told["valid"]) == ("hd_diag/check/1", True)
    assert told["parameters"] == dict(resolve({"joint_1.eccentricity.magnitude": 12e-6}).flat)


# mesh ---


def test_mesh_json_has_the_keys_of_the_contract() -> None:
    told = mesh("--input-angle", "0.3", "--torque", "14")
    assert {"torsion", "transmission_error", "lost_motion", "interference", "pressure_angle"} <= set(told)
    asked = {"schema": "hd_diag/mesh/1", "joint": "joint_1", "input_angle": 0.3, "torque": 14.0}
    assert asked.items() <= told.items()
    for key in ("backlash", "load", "pressure_angle"):
        assert {sign: len(values) for sign, values in told[key].items()} == {"+": 200, "-": 200}
    assert None in told["backlash"]["+"]
    assert all(isinstance(force, float) and force >= 0.0 for force in told["load"]["+"] + told["load"]["-"])


def test_mesh_of_another_joint(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    path.write_text(dump(resolve({"joints": ["a", "b"], "b.ratio": -100.0})))
    first, second = (mesh("--config", path, "--input-angle", "0.2", "--joint", name) for name in "ab")
    assert (first["joint"], second["joint"]) == ("a", "b")
    mirrored = [first["backlash"]["-"][-tooth] for tooth in range(200)]
    assert second["backlash"]["+"] == pytest.approx(mirrored, abs=1e-12, nan_ok=True)


def test_mesh_json_has_sections_and_their_sums(tmp_path: Path) -> None:
    assert "sections" not in mesh("--torque", "20")
    path = config_file(tmp_path, face_width=11e-3, cup_length=0.04, tilt__magnitude=1e-3)
    told = mesh("--config", path, "--torque", "20")
    sections = told["sections"]
    assert [each["z"] for each in sections] == pytest.approx([-z["z"] for z in reversed(sections)], abs=1e-15)
    assert (len(sections), sections[0]["z"] < 0.0) == (5, True)
    for sign in "+-":
        apart = np.array([[np.inf if b is None else b for b in each["backlash"][sign]] for each in sections])
        whole = [np.inf if b is None else b for b in told["backlash"][sign]]
        assert whole == pytest.approx(apart.min(axis=0).tolist(), rel=1e-15)
        together = np.sum([each["load"][sign] for each in sections], axis=0)
        assert told["load"][sign] == pytest.approx(together.tolist(), rel=1e-12)


def test_mesh_table_lists_the_teeth_that_can_touch(tmp_path: Path) -> None:
    result = hd_diag("mesh", "--torque", "56", "--json", tmp_path / "mesh.json")
    assert result.exit_code == 0
    backlash = json.loads((tmp_path / "mesh.json").read_text())["backlash"]
    pairs = enumerate(zip(backlash["+"], backlash["-"], strict=True))
    rows = re.findall(r"(?m)^(\d+)  +[-.\d]+ ", result.output)
    assert rows == [str(tooth) for tooth, pair in pairs if pair != (None, None)]
    assert "backlash +       -  load +" in result.output
    assert "tooth        [µm]    [µm]     [N]" in result.output
    assert "70 loaded flanks, largest force 39.755 N" in " ".join(result.output.split())


# Bad usage and input ---


def pairs_of_files() -> list[tuple[str, click.Parameter, click.Parameter]]:
    """All pairs of options of one verb where one names a file to write and the other a file to read."""
    return [
        (verb, target, source)
        for verb, command in cli.commands.items()
        for target, source in itertools.permutations(command.params, 2)
        if isinstance(target.type, Target) and (isinstance(source.type, Source) or source.name == "bags")
    ]


def written(params: dict[str, tuple[click.Parameter, Path]]) -> list[str]:
    """Words of a command line that set these parameters."""
    return [
        str(word)
        for param, value in params.values()
        for word in ((value,) if isinstance(param, click.Argument) else (param.opts[-1], value))
    ]


@pytest.mark.parametrize("link", [None, os.link, os.symlink], ids=["name", "hard link", "link"])
def test_no_verb_writes_over_what_it_reads(link: Any, tmp_path: Path) -> None:
    """This holds for every verb, and for other names of the same file."""
    content = config_file(tmp_path).read_bytes()
    assert len(pairs_of_files()) > 30
    for number, (verb, target, source) in enumerate(pairs_of_files()):
        ending = {"bags": ".mcap", "out": ".mcap"}.get(target.name, ".json")
        ending = next(iter(target.type._endings), ending)
        folder = tmp_path / str(number)
        folder.mkdir()
        (read := folder / f"read{ending}").write_bytes(content)
        (place := read if link is None else folder / f"link{ending}")
        if link:
            link(read, place)
        params = cli.commands[verb].params
        needed = {"bags": "a.mcap", "bag": "a.mcap", "out": f"out{'.parquet' * (verb == 'fleet')}"}
        given = {p.name: (p, folder / needed[p.name]) for p in params if p.required and p.name in needed}
        given |= {source.name: (source, read), target.name: (target, place)}
        if "bags" in given and source.name != "bags":
            (folder / "a.mcap").touch()
        there = sorted(folder.iterdir())
        told = hd_diag(verb, *written(given))
        assert_one_line_error(told, " the input ", str(place))
        assert (read.read_bytes(), sorted(folder.iterdir())) == (content, there), (verb, target.name)


def test_a_target_is_replaced_only_when_it_is_whole(tmp_path: Path) -> None:
    """The system ends a write in the middle, as a full disk does; the target may be a link."""
    path, link = tmp_path / "old.json", tmp_path / "link.json"
    path.write_text("old")
    link.symlink_to(path)
    with files_up_to(100):
        failed = [hd_diag("mesh", "--json", target) for target in (path, link)]
    for result in failed:
        assert_one_line_error(result, "cannot be written: File too large")
    assert (path.read_text(), link.is_symlink()) == ("old", True)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["link.json", "old.json"]
    assert hd_diag("mesh", "--json", link).exit_code == 0
    assert json.loads(path.read_text())["schema"] == "hd_diag/mesh/1"
    (tmp_path / "new").touch()
    assert path.stat().st_mode == (tmp_path / "new").stat().st_mode
    # A draft never takes the name of an existing file.
    part = config_file(tmp_path).rename(tmp_path / ".part.old.json")
    content = part.read_bytes()
    assert (hd_diag("check", part, "--json", path).exit_code, part.read_bytes()) == (0, content)


@pytest.mark.parametrize(
    ("words", "code"),
    [
        *((f"check FILE {streams}", 0) for streams in (">&-", "2>&-", "<&- >&- 2>&-", "2>/dev/full")),
        *((f"{words} >/dev/full", 2) for words in ("check FILE", "--help")),
        *((f"{words} | true; exit ${{PIPESTATUS[0]}}", 0) for words in ("mesh", "mesh --help", "--help")),
    ],
)
def test_streams_that_are_closed_or_full_or_read_no_more(words: str, code: int, tmp_path: Path) -> None:
    """Stderr has at most one line, and opened files do not take the number of a standard stream."""
    command = f"{shlex.quote(sys.executable)} -m hd_diag {words.replace('FILE', str(config_file(tmp_path)))}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    full = "hd-diag: the output cannot be written: No space left on device\n"
    assert (done.returncode, done.stderr) == (code, full if code else "")


def test_a_link_or_pipe_that_is_written_to_stays_one(tmp_path: Path) -> None:
    """If root replaced the target by a file, the system would lose its /dev/null."""
    link, pipe = tmp_path / "link.json", tmp_path / "pipe"
    link.symlink_to(tmp_path / "real.json")
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    for path in (link, pipe):
        assert hd_diag("check", config_file(tmp_path), "--json", path).exit_code == 0
    assert (link.is_symlink(), pipe.is_fifo()) == (True, True)
    assert os.read(reader, 1 << 16) == (tmp_path / "real.json").read_bytes()
    os.close(reader)


# Errors and Ctrl-C ---


OUT = "IndexError: index 5 is out of bounds"
INSTALL, NO_NUMBA = "python3 -m pip install", "No module named 'numba'"


def interrupted(compiled: int) -> BaseException:
    """KeyboardInterrupt, wrapped once for each of numba's compiled functions on the way."""
    error: BaseException = KeyboardInterrupt()
    for _ in range(compiled):
        outer = SystemError("CPUDispatcher returned a result with an exception set")
        outer.__cause__, error = error, outer
    return error


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (ModuleNotFoundError(NO_NUMBA, name="numba"), 2, f"hd-diag: {NO_NUMBA}: {INSTALL} numba"),
        # Code 1 means a finding: a script must never take a crash for one.
        (IndexError("index 5 is out of bounds\nfor axis 0"), 2, rf".*{OUT} \(mesh, line.*"),
        *((interrupted(compiled), 130, "hd-diag: interrupted") for compiled in (0, 1, 2)),
    ],
)
def test_an_error_in_a_verb_is_one_line(
    error: BaseException, code: int, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hd_diag.cli.mesh.moment", Mock(side_effect=error))
    result = hd_diag("mesh")
    assert (result.exit_code, result.stdout) == (code, "")
    assert re.fullmatch(told, result.stderr.strip())


STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.mark.parametrize("lost", ["", "callback", "cleared", "replaced"])
@pytest.mark.parametrize("number", STOPS)
def test_a_signal_while_modules_are_imported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], number: signal.Signals, lost: str
) -> None:
    """This holds even if the exception is lost: in a callback, or in a library that clears it."""

    class Interrupting(importlib.abc.MetaPathFinder):
        def find_spec(self, name: str, *_: Any) -> None:
            if name != "hd_diag.cli":
                return
            if lost == "replaced":  # like C code that hides the cause of its error
                with contextlib.suppress(KeyboardInterrupt):
                    signal.raise_signal(number)
                raise ImportError("a module cannot be initialised")
            with contextlib.suppress(BaseException) if lost == "cleared" else contextlib.nullcontext():
                if lost == "callback":
                    weakref.finalize(Interrupting(), signal.raise_signal, number)
                else:
                    signal.raise_signal(number)
            time.sleep(20.0)

    monkeypatch.delitem(sys.modules, "hd_diag.cli")
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(sys, "meta_path", [Interrupting(), *sys.meta_path])
    before = {each: signal.signal(each, signal.SIG_DFL) for each in STOPS}
    try:
        with pytest.raises(SystemExit) as ended:
            main()
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
        gc.enable()
    assert (ended.value.code, *capsys.readouterr()) == (128 + number, "", "hd-diag: interrupted\n")


def test_an_error_that_is_its_own_context_is_told() -> None:
    one, other = ValueError("one"), ValueError("other")
    one.__cause__, other.__cause__ = other, one
    assert signalled(one) == 0
    other.__cause__ = Stopped(signal.SIGTERM)
    assert signalled(one) == 143


def test_a_mesh_is_swept_into_a_table_and_drawn(tmp_path: Path) -> None:
    out, figure = tmp_path / "sweep.csv", tmp_path / "sweep.svg"
    words = ("mesh", "--eccentricity-um", "12", "--direction-deg", "50")
    for over, count in (("angle", 8 * 202 + 1), ("torque", 401)):
        result = hd_diag(*words, "--torque", "9", "--input-angle", "0.4", "--sweep", over, "--out", out)
        assert (result.exit_code, result.stderr) == (0, "")
        header, *_ = out.read_text(encoding="utf-8").splitlines()
        table = np.loadtxt(out, delimiter=",", skiprows=1)
        assert len(table) == count
        row = table[count // 3]
        told = mesh(*words[1:], "--input-angle", row[0], "--torque", row[1])
        for index, name in enumerate(header.split(",")):
            key = name.partition(" ")[0]
            if key in told:
                assert row[index] == pytest.approx(told[key], rel=1e-6, abs=1e-12)
    assert hd_diag(*words, "--out", out, "--figure", figure).exit_code == 0
    teeth = np.genfromtxt(out, delimiter=",", names=True)
    assert len(teeth) == 200
    assert "Backlash of both flanks" in figure.read_text(encoding="utf-8")


def test_mesh_takes_a_tilt_and_shows_one_section(tmp_path: Path) -> None:
    width, out = {"face_width": 0.011, "cup_length": 0.04, "sections": 3}, tmp_path / "section.csv"
    leaning = {"tilt__magnitude": 0.8e-3, "tilt__direction": float(np.radians(50.0))}
    plain = config_file(tmp_path, **width).rename(tmp_path / "plain.yaml")
    tilted = config_file(tmp_path, **width, **leaning)
    words = ("--torque", "9", "--config")
    expected, found = mesh(*words, tilted), mesh(*words, plain, "--tilt-mrad", "0.8", "--direction-deg", "50")
    assert found["torsion"] == pytest.approx(expected["torsion"], rel=1e-12)
    assert found["torsion"] != mesh(*words, plain)["torsion"]
    result = hd_diag("mesh", *words, tilted, "--section", "3", "--out", out)
    place = expected["sections"][2]["z"]
    assert f"Section 3, {place * 1e3:.2f} mm" in result.stdout
    rows = np.genfromtxt(out, delimiter=",", names=True, deletechars="")
    np.testing.assert_allclose(rows["load_+_[N]"], expected["sections"][2]["load"]["+"], rtol=1e-6, atol=1e-9)
    for wrong, *parts in (
        (("--config", plain, "--section", "4"), "--section 4: the drive has 3"),
        (("--tilt-mrad", "1"), "give face_width and sections"),
        (("--eccentricity-um", "900"), "--eccentricity-um", "must add up to"),
        (("--eccentricity-um", "nan"), "--eccentricity-um must be a number"),
        (("--sweep", "angle"), "--sweep needs --out or --figure"),
        (("--sweep", "angle", "--section", "1", "--out", out), "--section is of one moment, --sweep of many"),
    ):
        assert_one_line_error(hd_diag("mesh", *wrong), *parts)


def test_names_that_no_disk_takes_are_one_line(tmp_path: Path) -> None:
    json_of = ("check", config_file(tmp_path), "--json")
    for words in (json_of, ("check",), ("diagnose",), ("recover", "x", "--out")):
        result = hd_diag(*words, "a" * 5000)
        assert (result.exit_code, len(result.stderr.splitlines())) == (2, 1)
        assert "too long" in result.stderr or "exist" in result.stderr
