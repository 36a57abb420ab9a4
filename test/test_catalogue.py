"""The active catalogue of effects: from the package, installed packages, and files."""

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
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed packages; entry points are looked up once per process."""
    monkeypatch.syspath_prepend(tmp_path)
    catalogue._installed.cache_clear()
    yield tmp_path
    catalogue._installed.cache_clear()
    sys.modules.pop("my_pinion", None)


def installed(folder: Path, value: str) -> None:
    """Install a package with a copy of the example and an entry point."""
    shutil.copy(PINION, folder / "my_pinion.py")
    information = folder / "my_effects-1.0.dist-info"
    information.mkdir(exist_ok=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my-effects\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(f"[{GROUP}]\none0 = {value}\n")


def test_effects_of_a_file_come_after_the_package_s(tmp_path: Path) -> None:
    *known, pinion = load([PINION])
    assert (tuple(known), pinion.name) == (load(), "encoder_pinion")
    assert load() == CATALOGUE
    more = "\nfrom dataclasses import replace\nEFFECTS = [EFFECT, replace(EFFECT, name='two')]\n"
    (tmp_path / "two.py").write_text(PINION.read_text() + more)
    assert [effect.name for effect in load([tmp_path / "two.py"])[-2:]] == ["encoder_pinion", "two"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x = 1", "defines neither EFFECT nor EFFECTS"),
        ("EFFECT = 7", "expected an effect, not 7"),
        ("EFFECTS = ['a']", "expected an effect, not 'a'"),
        ("import nowhere_at_all", "cannot be loaded: ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("1 +", "cannot be loaded: SyntaxError: invalid syntax"),
        ("from hd_diag.effects.output_runout import EFFECT", "the catalogue has an effect 'output_runout'"),
    ],
)
def test_a_file_that_cannot_be_used_is_named(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load([path])
    assert str(caught.value).startswith(f"{path}: {reason}")
    assert "\n" not in str(caught.value)
    for name, wrong in (("none.py", "cannot be loaded: FileNotFoundError"), ("none.txt", "no Python file")):
        with pytest.raises(ConfigError, match=f"{name}: {wrong}"):
            load([tmp_path / name])


def test_installed_effects_are_in_the_catalogue(packages: Path) -> None:
    installed(packages, "my_pinion:EFFECT")
    assert [effect.name for effect in load()[len(CATALOGUE) :]] == ["encoder_pinion"]
    assert load([]) == load()
    with pytest.raises(ConfigError, match="has an effect 'encoder_pinion' already"):
        load([PINION])
    installed(packages, "my_pinion:NOTHING")
    catalogue._installed.cache_clear()
    with pytest.raises(ConfigError, match=r"^my-effects: one0: cannot be loaded: AttributeError: "):
        load()


def test_a_model_with_an_effect_of_a_file(tmp_path: Path) -> None:
    given = load([PINION])
    made = model()
    made = type(made)(made.drive, (Term(given[-1], (2e-5, 1e-5), ()),), made.offset, made.ranges)
    told = document("joint_1", own(), made, {}, [({}, ("encoder_pinion",))], {}, "0")
    write(tmp_path / "m.json", told, given)
    text = (tmp_path / "m.json").read_text()
    read = model_for(text, own(), given)
    rows = np.arange(5.0), np.linspace(0.0, 60.0, 5), None, np.full(5, 10.0)
    found, expected = (each.step(each.start(), *rows)[0] for each in (read, made))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    unknown = r"effects\[0\]: unknown effect 'encoder_pinion'; .* given or installed"
    with pytest.raises(ConfigError, match=unknown):
        model_for(text, own())
    read = model_for(json.dumps(content("hysteresis")), own(), given)
    assert read.effects[0].effect in CATALOGUE
