"""One word has one meaning: no module, message or page uses a word that the glossary replaces."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
GLOSSARY = ROOT / "docs/glossary.md"
ROWS = [line.strip("| ").split(" |") for line in GLOSSARY.read_text(encoding="utf-8").splitlines()[6:]]
OLD = [word for row in ROWS if len(row) > 2 for word in re.findall(r"\*\*(.+?)\*\*", row[2])]
FOLDERS = {"hd_diag": "py", "bench": "py", "examples": "py", "docs": "md", "config": "yaml"}
PAGES = [path for name, kind in FOLDERS.items() for path in sorted((ROOT / name).rglob(f"*.{kind}"))]
TEXTS = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]


def uses(text: str) -> list[str]:
    """Replaced words in a text, including those across line ends."""
    words = "|".join(re.escape(word).replace("\\ ", r"[\s#]+") for word in OLD)
    return re.findall(rf"(?i)\b(?:{words})\b", text)


def test_no_old_word_is_used() -> None:
    skipped = {GLOSSARY, *(ROOT / "docs/_build").rglob("*.md")}
    found = {
        str(path.relative_to(ROOT)): old
        for path in TEXTS
        if path not in skipped and (old := uses(path.read_text(encoding="utf-8")))
    }
    assert found == {}


@pytest.mark.parametrize("text", ["it begins anew", "Told apart", "all\n    # but\n    # for one", "thus"])
def test_an_old_word_would_be_found(text: str) -> None:
    assert len(uses(text)) == 1


def test_words_are_in_order_once_and_each_has_its_meaning() -> None:
    words = [row[0].strip() for row in ROWS]
    assert words == sorted(set(words))
    assert len(words) > 40
    assert all(len(row[1].split()) > 2 for row in ROWS)
