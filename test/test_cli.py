"""The command line: every verb's help, exit codes, one-line errors, and what `mesh --json` says."""

import importlib.abc
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from cli_runner import assert_one_line_error, hd_diag, runner
from reference import published

from hd_diag.__main__ import main
from hd_diag.cli import cli
from hd_diag.cli.verbs import VERBS
from hd_diag.config.configuration import dump, resolve

COMMANDS = {verb: cli.get_command(click.Context(cli), verb) for verb in VERBS}


def config_file(folder: Path, **values: Any) -> str:
    """A parameter file with some values of joint_1; double underscores for dots."""
    named = {f"joint_1.{name.replace('__', '.')}": value for name, value in values.items()}
    path = folder / "drive.yaml"
    path.write_text(dump(resolve(named)))
    return str(path)


def mesh(*arguments: str) -> dict[str, Any]:
    result = hd_diag("mesh", *arguments, "--json", "-")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


# Help and usage ---


def test_the_verbs_of_the_contract_are_there() -> None:
    contract = "demo check mesh simulate replay diagnose report tolerance recover figures fleet watch node"
    assert set(contract.split()) <= set(VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_every_verb(verb: str) -> None:
    for option in ("--help", "-h"):
        result = hd_diag(verb, option)
        assert result.exit_code == 0
        assert result.output.startswith(f"Usage: cli {verb} ")
        assert COMMANDS[verb].help.splitlines()[0].split(":")[0] in " ".join(result.output.split())


def test_help_lists_every_verb_in_order() -> None:
    listed = hd_diag("--help").output.partition("Commands:")[2]
    assert re.findall(r"(?m)^  (\w+)", listed) == list(VERBS) == sorted(VERBS)


def test_help_imports_nothing_that_is_slow() -> None:
    code = "import sys; from hd_diag.cli import cli; cli(['--help'], standalone_mode=False)"
    slow = "{'numba', 'numpy', 'scipy', 'matplotlib', 'rclpy', 'rich', 'yaml', 'mcap'}"
    code = f"import atexit, sys; atexit.register(lambda: print('slow:', {slow} & set(sys.modules))); {code}"
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60)
    assert run.stdout.endswith("slow: set()\n")


def test_help_cuts_no_verb_s_line_short_at_80_columns() -> None:
    told = runner().invoke(cli, ["--help"], terminal_width=80).output.partition("Commands:")[2]
    assert not [line for line in told.splitlines() if line.endswith("...") or len(line) > 80]


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_an_example_that_its_parser_takes(verb: str) -> None:
    example = COMMANDS[verb].epilog
    command, own, *words = shlex.split(example.removeprefix("Example: "))
    assert (command, own) == ("hd-diag", verb)
    COMMANDS[verb].make_context(verb, words)
    assert example in runner().invoke(cli, [verb, "--help"], terminal_width=80).output  # on one line


def test_readme_lists_every_verb() -> None:
    readme = (Path(__file__).resolve().parent.parent / "README.md").read_text()
    assert sorted(re.findall(r"(?m)^\| `([a-z]+)` \|", readme)) == sorted(VERBS)


def test_without_a_verb_it_tells_the_verbs() -> None:
    assert (hd_diag().exit_code, hd_diag().output) == (0, hd_diag("--help").output)


def test_version() -> None:
    assert hd_diag("--version").output == "hd-diag, version 0.1.0\n"


# check ---


def test_check_describes_a_valid_configuration(tmp_path: Path) -> None:
    path = config_file(tmp_path, eccentricity__magnitude=12e-6)
    result = hd_diag("check", path)
    assert result.exit_code == 0
    assert result.output == (
        "joint_1: joint_1_motor -> joint_1, ratio 100, 200/202 teeth, rated 56 N m, eccentricity 12 um\n"
        f"{path}: valid\n"
    )


def test_check_json_holds_every_parameter(tmp_path: Path) -> None:
    path = config_file(tmp_path, torque=3.5)
    result = hd_diag("check", path, "--json", "-")
    told = json.loads(result.stdout)
    assert (told["schema"], told["valid"]) == ("hd_diag/check/1", True)
    assert told["parameters"] == dict(resolve({"joint_1.torque": 3.5}).flat)


def test_check_names_file_parameter_and_expectation(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("hd_diag: {ros__parameters: {joint_1: {rated_torque: '56'}}}")
    result = hd_diag("check", str(path))
    assert_one_line_error(result, str(path), "joint_1.rated_torque", "expected a number [N m]", "'56'")


# mesh ---


def test_mesh_json_has_the_keys_of_the_contract(tmp_path: Path) -> None:
    told = mesh("--input-angle", "0.3", "--torque", "14")
    keys = "schema joint input_angle torque torsion transmission_error lost_motion interference backlash load"
    assert set(keys.split()) | {"pressure_angle"} <= set(told)
    assert told["schema"] == "hd_diag/mesh/1"
    assert (told["joint"], told["input_angle"], told["torque"]) == ("joint_1", 0.3, 14.0)
    for key in ("backlash", "load", "pressure_angle"):
        assert {sign: len(values) for sign, values in told[key].items()} == {"+": 200, "-": 200}
    assert None in told["backlash"]["+"]
    assert all(isinstance(force, float) and force >= 0.0 for force in told["load"]["+"] + told["load"]["-"])


@pytest.mark.parametrize("case", published.LOAD_CASES)
def test_mesh_gives_the_published_numbers(case: published.LoadCase, tmp_path: Path) -> None:
    """Backlash to 0.05 um, and to 0.1 % where a value is printed to no more; torsion and loads."""
    path = config_file(tmp_path, eccentricity__magnitude=case.eccentricity, eccentricity__direction=np.pi / 2)
    told = mesh("--config", path, "--torque", str(case.torque))
    expected = published.BACKLASH[case.eccentricity]
    backlash = [told["backlash"]["+"][tooth] for tooth in published.BACKLASH_TEETH]
    assert backlash == pytest.approx(expected, abs=0.05e-6, rel=0.0)
    assert told["torsion"] == pytest.approx(case.torsion, rel=1e-3)
    loaded = tuple(sum(force > 0.0 for force in told["load"][sign]) for sign in "+-")
    assert loaded == case.loaded
    assert told["loaded_pairs"] == sum(loaded)
    if case.largest_force is not None:
        assert max(told["load"]["+"]) == pytest.approx(case.largest_force, abs=0.05)


def test_mesh_as_driven_is_the_reaction() -> None:
    """The torque that the drive exerts on the link turns the cup the other way; the error is its torsion."""
    told = mesh("--torque", "20")
    assert told["transmission_error"] == pytest.approx(told["as_driven"]["torsion"], rel=1e-12)
    assert told["transmission_error"] < 0.0 < told["torsion"]


def test_mesh_of_another_joint(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    path.write_text(dump(resolve({"joints": ["a", "b"], "b.ratio": -100.0})))
    first, second = (
        mesh("--config", str(path), "--input-angle", "0.2", *which) for which in ((), ("--joint", "b"))
    )
    assert (first["joint"], second["joint"]) == ("a", "b")
    mirrored = [first["backlash"]["-"][-tooth] for tooth in range(200)]
    assert second["backlash"]["+"] == pytest.approx(mirrored, abs=1e-12, nan_ok=True)


def test_mesh_table_lists_the_teeth_that_can_touch(tmp_path: Path) -> None:
    path = tmp_path / "mesh.json"
    result = hd_diag("mesh", "--torque", "56", "--json", str(path))
    assert result.exit_code == 0
    told = json.loads(path.read_text())
    can_touch = [
        n for n in range(200) if (told["backlash"]["+"][n], told["backlash"]["-"][n]) != (None, None)
    ]
    rows = [line.split("│")[1].strip() for line in result.output.splitlines() if line.startswith("│")]
    assert rows == [str(tooth) for tooth in can_touch]
    assert "70 loaded flanks, largest force 39.755 N" in " ".join(result.output.split())


# Bad usage and input ---


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nonsense",), "No such command 'nonsense'"),
        (("mesh", "--nonsense"), "--nonsense"),
        (("check",), "Missing argument 'CONFIG'"),
        (("mesh", "--torque", "x"), "'x' is not a valid float"),
        (("check", "none.yaml"), "none.yaml: cannot be read: No such file or directory"),
        (("mesh", "--config", "none.yaml"), "none.yaml: cannot be read: No such file or directory"),
        (("node", "--config", "none.yaml"), "none.yaml: cannot be read: No such file or directory"),
        (("mesh", "--json", "no/folder.json"), "folder.json: cannot be written: no such folder"),
        (("mesh", "--torque", "nan"), "--torque must be a number of at most 1e+06"),
        (("mesh", "--torque", "-1e7"), "--torque must be a number of at most 1e+06"),
        (("mesh", "--input-angle", "1e300"), "--input-angle must be a number of at most 1e+10"),
        (("mesh", "--joint", "c"), "no joint 'c' in the configuration; it has joint_1"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], said: str) -> None:
    assert_one_line_error(hd_diag(*arguments), said)


def test_a_missing_dependency_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: Any) -> None:
        raise ModuleNotFoundError("No module named 'numba'", name="numba")

    monkeypatch.setattr("hd_diag.cli.mesh.moment", missing)
    assert_one_line_error(hd_diag("mesh"), "hd-diag: No module named 'numba': python3 -m pip install numba")


# Ctrl-C ---


def test_an_interruption_is_one_line_and_130(monkeypatch: pytest.MonkeyPatch) -> None:
    """The usual one, and what numba's compiled code makes of one that comes while it runs."""

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    def in_compiled_code(*_: Any) -> None:
        try:
            interrupted()
        except KeyboardInterrupt as error:
            raise SystemError("CPUDispatcher returned a result with an exception set") from error

    def further_in(*_: Any) -> None:
        try:
            in_compiled_code()
        except SystemError as error:
            raise SystemError("another returned a result with an exception set") from error

    for happens in (interrupted, in_compiled_code, further_in):
        monkeypatch.setattr("hd_diag.cli.mesh.moment", happens)
        result = hd_diag("mesh")
        assert (result.exit_code, result.stdout, result.stderr.strip()) == (130, "", "hd-diag: interrupted")


def test_an_interruption_while_modules_are_imported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupting(importlib.abc.MetaPathFinder):
        def find_spec(self, name: str, *_: Any) -> None:
            if name == "hd_diag.cli":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "hd_diag.cli")
    monkeypatch.setattr(sys, "meta_path", [Interrupting(), *sys.meta_path])
    with pytest.raises(SystemExit) as ended:
        main()
    assert (ended.value.code, *capsys.readouterr()) == (130, "", "hd-diag: interrupted\n")


# As installed ---


def test_installed_command(tmp_path: Path) -> None:
    """The console script, once; a traceback would show here as it does to the user."""
    command = Path(sys.executable).with_name("hd-diag")
    if not command.exists():
        pytest.skip("this Python has no hd-diag installed")
    good = subprocess.run(
        [command, "check", config_file(tmp_path)], capture_output=True, text=True, timeout=60
    )
    assert (good.returncode, good.stderr) == (0, "")
    bad = subprocess.run([command, "check", tmp_path / "none"], capture_output=True, text=True, timeout=60)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr == f"hd-diag: {tmp_path / 'none'}: cannot be read: No such file or directory\n"
