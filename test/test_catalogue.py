"""The catalogue of effects in force: the package's, those of installed packages, those of files."""

import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from models import content, model, own

from hd_diag.config import catalogue
from hd_diag.config.catalogue import GROUP, load
from hd_diag.config.model_file import ConfigError, document, model_for, write
from hd_diag.effects import CATALOGUE
from hd_diag.extended_model import Term

PINION = Path(__file__).resolve().parent.parent / "docs" / "examples" / "encoder_pinion.py"


@pytest.fixture
def afresh() -> Iterator[None]:
    """Entry points are looked up once a process."""
    catalogue._installed.cache_clear()
    yield
    catalogue._installed.cache_clear()


def installed(folder: Path, *values: str) -> None:
    """A package beside the example that declares entry points."""
    shutil.copy(PINION, folder / "my_pinion.py")
    information = folder / "my_effects-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my-effects\nVersion: 1.0\n")
    entries = "".join(f"one{i} = {value}\n" for i, value in enumerate(values))
    (information / "entry_points.txt").write_text(f"[{GROUP}]\n{entries}")


def test_nothing_given_is_the_package_s() -> None:
    assert load() == CATALOGUE


def test_effects_of_a_file_come_last() -> None:
    *known, pinion = load([PINION])
    assert (tuple(known), pinion.name) == (CATALOGUE, "encoder_pinion")


def test_several_effects_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "two.py"
    text = (
        PINION.read_text()
        + "\nfrom dataclasses import replace\nEFFECTS = [EFFECT, replace(EFFECT, name='two')]\n"
    )
    path.write_text(text)
    assert [effect.name for effect in load([path])[-2:]] == ["encoder_pinion", "two"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x = 1", "defines neither EFFECT nor EFFECTS"),
        ("EFFECT = 7", "expected an effect, not 7"),
        ("EFFECTS = ['a']", "expected an effect, not 'a'"),
        ("import nowhere_at_all", "cannot be loaded: ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("1 +", "cannot be loaded: SyntaxError: invalid syntax"),
        (
            "from hd_diag.effects.output_runout import EFFECT",
            "the catalogue has an effect 'output_runout' already",
        ),
    ],
)
def test_a_file_that_cannot_be_used_is_named(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load([path])
    assert str(caught.value).startswith(f"{path}: {reason}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["none.py", "none.txt"])
def test_a_file_that_is_not_there_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=rf"{name}: (cannot be loaded: FileNotFoundError|no Python file)"):
        load([tmp_path / name])


@pytest.mark.usefixtures("afresh")
def test_installed_effects_are_in_the_catalogue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(tmp_path, "my_pinion:EFFECT")
    monkeypatch.syspath_prepend(tmp_path)
    assert [effect.name for effect in load()[len(CATALOGUE) :]] == ["encoder_pinion"]
    assert load([]) == load()
    with pytest.raises(ConfigError, match="has an effect 'encoder_pinion' already"):
        load([PINION])
    del sys.modules["my_pinion"]


@pytest.mark.usefixtures("afresh")
def test_an_entry_point_that_cannot_be_loaded_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed(tmp_path, "my_pinion:NOTHING")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"^my-effects: one0: cannot be loaded: AttributeError: "):
        load()
    del sys.modules["my_pinion"]


def test_a_model_with_an_effect_of_a_file(tmp_path: Path) -> None:
    """Read again where the file is given; otherwise an error names the effect."""
    given = load([PINION])
    made = model()
    made = type(made)(made.drive, (Term(given[-1], (2e-5, 1e-5), ()),), made.offset, made.ranges)
    told = document("joint_1", own(), made, {}, [({}, ("encoder_pinion",))], {}, "0")
    write(tmp_path / "m.json", told, given)
    text = (tmp_path / "m.json").read_text()
    read = model_for(text, own(), given)
    rows = np.arange(5.0), np.linspace(0.0, 60.0, 5), None, np.full(5, 10.0)
    np.testing.assert_allclose(
        read.step(read.start(), *rows)[0], made.step(made.start(), *rows)[0], atol=1e-12
    )
    with pytest.raises(
        ConfigError, match=r"effects\[0\]: unknown effect 'encoder_pinion'; .* given or installed"
    ):
        model_for(text, own())
    assert model_for(json.dumps(content("hysteresis")), own(), given).effects[0].effect is CATALOGUE[10]
