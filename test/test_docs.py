"""The documentation: it builds, its names exist, it covers the code, and its examples run."""

import dataclasses
import importlib.util
import json
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from urllib.parse import urldefrag

import click
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from browser import Markup, page_faults
from cli_runner import hd_diag
from live import config
from numpy.testing import assert_allclose

from hd_diag.cli import cli
from hd_diag.config.configuration import resolve
from hd_diag.config.parameters import JOINT_PARAMETERS, NODE_PARAMETERS
from hd_diag.effects import CATALOGUE
from hd_diag.messages.publications import published_topics
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.health import FAULT_CODES
from hd_diag.simulation import write_bag

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
NAMES = [path.relative_to(DOCS).as_posix() for path in PAGES]
LARGEST_PICTURE = 200_000  # in the README [byte]


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


rerun, generate = load(DOCS / "rerun.py"), load(DOCS / "generate.py")


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run commands of hd-diag in this process: a separate one takes a second to start."""

    def run(command: list[str], check: bool, **_: Any) -> SimpleNamespace:
        words = command[1:] if command[0] == "hd-diag" else command[3:]
        assert command[: -len(words)] in (["hd-diag"], [sys.executable, "-m", "hd_diag"])
        result = hd_diag(*words)
        assert check
        assert result.exit_code == 0, result.output
        return SimpleNamespace(stdout=result.stdout)

    monkeypatch.setattr(subprocess, "run", run)


# Names in the pages ---


def calls(text: str) -> list[list[str]]:
    """Words of every hd-diag call in the code blocks of a page, whether generated or for the reader."""
    read = [line for block in re.findall(r"(?ms)^```sh\n(.*?)^```$", text) for line in block.splitlines()]
    parts = (part for line in [*rerun.commands(text), *read] for part in re.split(r"\||&&|;", line))
    words = (shlex.split(part, comments=True) for part in parts)
    return [call[1:] for call in words if call[:1] == ["hd-diag"]]


def faults(words: list[str]) -> list[str]:
    """Parts of a call that the command line does not have."""
    verb = cli.get_command(click.Context(cli), words[0])
    if verb is None:
        return [f"no verb {words[0]}"]
    known = {name for option in verb.params for name in option.opts} | {"--help", "-h"}
    own = words[1 : words.index("--")] if "--" in words else words[1:]
    given = [word.partition("=")[0] for word in own if re.match(r"--?[a-z]", word)]
    return [f"{words[0]}: no option {name}" for name in given if name not in known]


@pytest.mark.parametrize("page", [*NAMES, "../README.md"])
def test_commands_exist(page: str) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    assert [fault for words in calls(text) for fault in faults(words)] == []


def test_faults_of_commands_are_seen_and_every_verb_is_shown_at_work() -> None:
    text = "```sh\nhd-diag mesh --torque 3 | head\nhd-diag mash\nhd-diag mesh --tork 3 -- --ros\n```\n"
    assert [faults(words) for words in calls(text)] == [[], ["no verb mash"], ["mesh: no option --tork"]]
    whole = "\n".join(path.read_text(encoding="utf-8") for path in PAGES)
    assert [verb for verb in cli.commands if not re.search(rf"hd-diag {verb}\b", whole)] == []


@pytest.mark.parametrize("page", ["tour.md", "runtime.md"])
def test_what_check_says_is_what_the_page_shows(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(DOCS)
    compared = 0
    text = (DOCS / page).read_text(encoding="utf-8")
    for command, shown in re.findall(r"(?m)^\$ (.+)\n((?:(?!\$ |```).*\n)*)", text):
        if command.startswith("printf"):
            subprocess.run(["sh", "-c", command], check=True)
        elif command.startswith("hd-diag check"):
            result = hd_diag(*shlex.split(command)[1:])
            assert result.stdout + result.stderr == shown
            compared += 1
    assert compared


def table(page: str, heading: str) -> set[str]:
    """Code names in the first column below a heading."""
    text = (DOCS / page).read_text(encoding="utf-8").partition(f"{heading}\n")[2]
    rows = text.partition("\n#")[0].splitlines()
    return {
        name for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1] if "|" in row else "")
    }


def test_diagnostics_and_topics_are_all_explained() -> None:
    status = Monitor(config()).tick(0, 0, {}).statuses[0]
    assert table("robot.md", "### Diagnostics") == set(status.values)
    assert table("robot.md", "### Fault codes") == set(FAULT_CODES)
    assert table("robot.md", "## What it gives") >= set(published_topics(["<joint>"]))


PROGRESS = (
    "joint_1: looking for cause 1: 10 s so far",
    "joint_1: fitting: 40 %, about 2 min left",
    "a.mcap: 9,120 of 60,000 messages, 912/s",
)


def test_outputs_are_put_beneath_their_commands(tmp_path: Path) -> None:
    text = "a\n```console\n$ echo one; pwd\n{}$ false\n```\nb\n```sh\n$ echo no\n```\n"
    outputs = rerun.told(rerun.commands(text.format("old\n")), tmp_path.resolve())
    shown = rerun.refreshed(text.format("old\n"), outputs)
    assert shown == text.format(f"one\n{tmp_path.resolve()}\n")
    lines = " ".join(f"'hd-diag: {line}'" for line in (*PROGRESS, "no such file: 3"))
    (told,) = rerun.told([f"printf '%s\\n' {lines} >&2"], tmp_path)
    assert told == "hd-diag: no such file: 3\n"


@pytest.mark.parametrize("page", NAMES)
def test_files_of_the_tree_are_there_when_a_page_is_run_again(page: str) -> None:
    lines = rerun.commands((DOCS / page).read_text(encoding="utf-8"))
    words = [word for line in lines for word in shlex.split(line) if "/" in word[1:]]
    named = {word: word.partition("/")[0] for word in words if word[0] != "/"}
    there = [word for word, top in named.items() if top in rerun.TREE and (ROOT / word).exists()]
    assert [word for word, top in named.items() if (ROOT / top).is_dir() and word not in there] == []


def test_readme_is_short_with_its_picture_and_what_the_demo_takes_before_its_command() -> None:
    names = ("README.md", "CONTRIBUTING.md", "scripts/environment.sh")
    readme, more, script = ((ROOT / name).read_text(encoding="utf-8") for name in names)
    assert len(readme.split()) < 700
    (size,) = re.findall(r'demo\) size="(\d+ MB)', script)
    assert size in readme.partition("    make demo\n")[0]
    (name,) = re.findall(r'<img src="([^"]+)"', readme)
    assert 0 < (ROOT / name).stat().st_size < LARGEST_PICTURE
    links = re.findall(r"\]\(([^)#:]+)\)", readme + more)
    assert [link for link in links if not (ROOT / link).exists()] == []


# The pages on a code host ---


@pytest.mark.parametrize("page", [name for name in NAMES if not name.startswith("api/")])
def test_pages_are_plain_markdown_whose_links_lead_somewhere(page: str) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    prose = re.sub(r"(?ms)^```(?!\{).*?^```$|`[^`\n]+`", "", text)
    assert re.findall(r"\{\{|\{%|^```\{|\{\w+\}`", prose, flags=re.MULTILINE) == []
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", prose) if not re.match(r"[a-z]+:", link)]
    assert [link for link in links if not is_there(DOCS / page, *urldefrag(link))] == []


def is_there(page: Path, file: str, place: str) -> bool:
    target = page.parent / file if file else page
    return target.is_file() and (not place or place in places_of(target))


def places_of(page: Path) -> set[str]:
    """Anchors under which a code host links the headings of a page."""
    titles = re.findall(r"(?m)^#+ (.+)$", page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", title.replace("\\", "").lower()).replace(" ", "-") for title in titles}


def test_generated_parts_and_pictures_are_those_of_the_code(in_this_process: None) -> None:
    assert generate.stale(write=False) == [], "python docs/generate.py"


def test_every_verb_option_parameter_and_effect_is_explained() -> None:
    command_line, parameters, effects = (
        " ".join((DOCS / f"{name}.md").read_text(encoding="utf-8").replace("\\", "").split())
        for name in ("command_line", "parameters", "effects")
    )
    verbs = [cli.get_command(click.Context(cli), verb) for verb in cli.commands]
    options = [option for verb in verbs for option in verb.params if isinstance(option, click.Option)]
    assert [name for option in options for name in option.opts if name not in command_line] == []
    every = (*NODE_PARAMETERS, *JOINT_PARAMETERS)
    assert [p.name for p in every if p.name not in parameters or p.meaning not in parameters] == []
    for effect in CATALOGUE:
        names = (effect.name, *(quantity.name for quantity in effect.quantities))
        wanted = (*names, *effect.confused_with, *effect.always_confused, " ".join(effect.cause.split()))
        assert [name for name in wanted if name not in effects] == []


def test_what_is_out_of_date_is_seen_and_nothing_else_is_changed() -> None:
    """Outdated parts of pages are found; pictures are compared by their content."""
    text = "before\n<!-- made: frames -->\n\nold\n\n<!-- end -->\nafter\n"
    found = generate.renewed(text, "")
    assert re.fullmatch("before\n.*slot 0 lies on its x axis.*<!-- end -->\nafter\n", found, re.DOTALL)
    assert generate.renewed(found, "") == found
    text = (DOCS / "figures/drive.svg").read_text(encoding="utf-8")
    moved = re.sub(r"(M )(\d+)\.(\d)", lambda m: f"{m[1]}{int(m[2]) + 1}.{m[3]}", text, count=1)
    assert generate.same_picture(text, text)
    assert moved != text
    assert not generate.same_picture(text, moved)
    assert not generate.same_picture(text, text.replace("<text", "<desc", 1))


# The built pages ---


@pytest.fixture(scope="module")
def site(source_copy: Path) -> Path:
    """The pages, built like `make docs` from a copy of the tree."""
    pytest.importorskip("sphinx")
    folders = [source_copy / "docs", source_copy / "docs/_build/html"]
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", *folders]
    built = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert built.returncode == 0, built.stdout + built.stderr
    return source_copy / "docs/_build/html"


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[str, Markup]:
    return {
        path.relative_to(site).as_posix(): Markup(path.read_text(encoding="utf-8"))
        for path in site.rglob("*.html")
    }


def test_pages_need_no_network_and_name_no_place_of_a_machine(
    pages: dict[str, Markup], site: Path, source_copy: Path
) -> None:
    text = "".join(page.source for page in pages.values())
    assert re.findall(r'(?:src|<link[^>]*href)="(?:https?:)?//[^"]*', text) == []
    styles = "".join(path.read_text(encoding="utf-8") for path in site.rglob("*.css"))
    assert re.findall(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//[^)]*", styles) == []
    told = " ".join(page.text for page in pages.values())
    assert str(source_copy) not in told
    assert re.findall(r"/(?:root|home|tmp|work|Users)/\w", told) == []


def test_nomenclature_figures_and_the_public_core_are_those_of_the_code(pages: dict[str, Markup]) -> None:
    names = ("slot 0 lies on its x axis", "arc offset of tooth 0 along the neutral curve")
    names += ("negative: the flanks interfere",)
    assert [name for name in names if name not in " ".join(pages["physics.html"].text.split())] == []
    for page, pictures in (("index", "drive"), ("physics", "drive"), ("paper", "figure_5 figure_6 figure_7")):
        links = " ".join(pages[f"{page}.html"].values("href", "src"))
        assert [name for name in pictures.split() if f"{name}.svg" not in links] == []
    assert all(f"({letter})" in pages["paper.html"].text for letter in "abcde")
    places = {place for page in pages.values() for place in page.values("id", "name")}
    core = ("model.load_sharing", "drive", "effects.effect", "diagnosis.diagnosis")
    assert {f"module-hd_diag.{module}" for module in core} <= places
    # A phone shows a row as a list with these names; cells without a word are left out.
    cells = re.findall(r'<td data-name="([^"]+)"', pages["parameters.html"].source)
    assert set(cells) == {"default", "from, to", "meaning"}
    assert cells.count("default") == cells.count("meaning") > cells.count("from, to")


# Other pages take a second each. The theme fixes the contrast; on long tables its test takes ten seconds.
SHORT, LONG = ("index", "parameters"), ("benchmarks", "effects", "parameters", "command_line")
SHOWN = [name.removesuffix(".md") for name in NAMES if name != "tables/README.md"]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in SHORT else [pytest.mark.slow]) for name in SHOWN]
)
def test_pages_fit_a_phone_and_a_desk(browser: Any, site: Path, name: str) -> None:
    rules = () if name in LONG or name.startswith("api/") else ("color-contrast",)
    assert page_faults(browser, (site / f"{name}.html").as_uri(), rules) == []


# Examples ---


def test_one_moment_runs() -> None:
    found = load(DOCS / "examples/one_moment.py")
    assert found.error.shape == (3,)
    assert np.all((found.peak > 10.0) & (found.peak < 60.0) & (found.error < 0.0))  # the output lags


@pytest.mark.slow
def test_the_worked_example_is_named_by_a_diagnosis(tmp_path: Path) -> None:
    """The size is right: 1 arcsec of noise over about 12,000 samples leaves 0.02 arcsec, out of 6."""
    example, effect = load(DOCS / "examples/pinion_joint.py"), DOCS / "examples/encoder_pinion.py"
    motion = dataclasses.replace(example.MOTION, sample_rate=100.0)
    bag, model = tmp_path / "pinion.mcap", tmp_path / "model.json"
    write_bag(bag, resolve({}), motion, np.random.default_rng(1), {"joint_1": example.joint()})
    result = hd_diag("diagnose", bag, "--effects", effect, "--model", model, "--time-limit", 600)
    assert result.exit_code == 0, result.output
    said = (
        r"The eccentricity is 1[12]\.\d+ ± [^\n]*\njoint_1: Beside that: encoder pinion, 4\.\d+ arcsec rms\."
    )
    assert re.search(said, result.stdout)
    assert " ".join(load(effect).EFFECT.inspect.split()) in result.stdout
    (found,) = json.loads(model.read_text())["effects"]
    assert_allclose(found["parameters"]["amplitude"]["value"], example.SIZE, atol=0.1 * ARCSEC)
    assert_allclose(found["parameters"]["direction"]["value"], example.DIRECTION, atol=0.02)


GALLERY = sorted((DOCS / "gallery").glob("*.py"))
LONG_SCRIPTS = ("a_fleet", "eccentricity_against_tilt", "tolerance_chart")  # more than 10 s each


@pytest.mark.parametrize(
    "script",
    [pytest.param(one, marks=[pytest.mark.slow] if one.stem in LONG_SCRIPTS else []) for one in GALLERY],
    ids=lambda script: script.stem,
)
def test_a_script_of_the_gallery_draws_the_picture_that_is_shown(
    script: Path, tmp_path: Path, in_this_process: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")  # makes files reproducible
    matplotlib.use("agg")
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rc_file(DOCS / "gallery/matplotlibrc")
        runpy.run_path(str(script))  # pool workers would run the main module again
        plt.close("all")
    drawn = (tmp_path / f"{script.stem}.svg").read_text(encoding="utf-8")
    kept = script.with_suffix(".svg").read_text(encoding="utf-8")
    assert generate.same_in_gallery(script.stem, kept, drawn), "python docs/generate.py --gallery"
    assert f"gallery/{script.stem}.svg" in (DOCS / "gallery.md").read_text(encoding="utf-8")
