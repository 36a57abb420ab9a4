"""Write the generated parts of the pages, and their pictures, from the present code and tables.

    python docs/generate.py [--check] [--gallery]

A part stands between ``<!-- made: NAME -->`` and ``<!-- end -->``: a name of `PARTS`, ``table NAME`` for
docs/tables/NAME.md, or ``file PATH`` for a file of the tree. With ``--check`` nothing is written: what is
out of date is listed, and the exit code is 1. With ``--gallery`` the scripts of docs/gallery are run too,
which takes a minute or two.
"""

# ruff: noqa: E402, T201

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS)]  # for parts/

from parts import catalogue, command_line, nomenclature, parameter_tables, pictures, public_face

PARTS: dict[str, Callable[[], str]] = {
    "refitted": catalogue.refitted,
    "effects": catalogue.effects,
    "about": command_line.about,
    "verbs": command_line.verbs,
    "frames": nomenclature.frames,
    "symbols": nomenclature.symbols,
    "parameters": parameter_tables.parameters,
    "public": public_face.functions,
}
MADE = re.compile(r"(?ms)^<!-- made: ([^>]+) -->\n.*?^<!-- end -->$")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".xml": "xml"}
FIGURES, GALLERY = DOCS / "figures", DOCS / "gallery"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
ROUNDING = 0.06  # by which coordinates may differ between processors [pt]
# The same for pictures of a search for causes, whose last digits do not matter [pt].
FITTED = 6.0


def part(name: str, captions: str) -> str:
    """Markdown of a part by its name."""
    kind, _, what = name.partition(" ")
    if kind == "table":
        return (DOCS / f"tables/{what}.md").read_text(encoding="utf-8").strip()
    if kind == "file":
        file = DOCS.parent / what
        return f"```{LANGUAGES[file.suffix]}\n{file.read_text(encoding='utf-8').strip()}\n```"
    return captions if name == "captions" else PARTS[name]()


def renewed(text: str, captions: str) -> str:
    """A page with its parts as they are now."""

    def made(old: re.Match[str]) -> str:
        return f"<!-- made: {old.group(1)} -->\n\n{part(old.group(1), captions)}\n\n<!-- end -->"

    return MADE.sub(made, text)


def same_picture(one: str, other: str, rounding: float = ROUNDING) -> bool:
    """Whether two SVG files show the same except for rounding; other versions of matplotlib are skipped."""
    makers = [re.findall(r"Matplotlib v[\d.]+", text) for text in (one, other)]
    if makers[0] != makers[1]:
        return True
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=False)
    same = NUMBER.sub("0", one) == NUMBER.sub("0", other)
    return same and all(abs(float(a) - float(b)) < rounding for a, b in pairs)


def same_in_gallery(name: str, kept: str, drawn: str) -> bool:
    """`same_picture` for the script of this name."""
    return same_picture(
        kept, drawn, FITTED if name in ("a_fleet", "diagnosis_with_its_evidence") else ROUNDING
    )


def stale_gallery(write: bool) -> list[str]:
    """Names of the gallery's pictures that their scripts now draw differently; `write` renews them."""
    old, path = [], f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    own = {"PATH": path, "MATPLOTLIBRC": str(GALLERY / "matplotlibrc"), "SOURCE_DATE_EPOCH": "0"}
    for script in sorted(GALLERY.glob("*.py")):
        kept = script.with_suffix(".svg")
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, script], cwd=folder, env={**os.environ, **own}, check=True)
            drawn = (Path(folder) / kept.name).read_text(encoding="utf-8")
        if not (kept.is_file() and same_in_gallery(script.stem, kept.read_text(encoding="utf-8"), drawn)):
            old.append(f"gallery/{kept.name}")
            if write:
                kept.write_text(drawn, encoding="utf-8")
    return old


def stale(write: bool) -> list[str]:
    """Names of the pages and pictures that are out of date; `write` renews them."""
    old = []
    with pictures.drawn() as folder:
        captions = pictures.captions(folder)
        for new in sorted(folder.glob("*.svg")):
            kept, text = FIGURES / new.name, new.read_text(encoding="utf-8")
            if not kept.is_file() or not same_picture(kept.read_text(encoding="utf-8"), text):
                old.append(f"figures/{new.name}")
                if write:
                    kept.write_text(text, encoding="utf-8")
    for page in sorted(DOCS.glob("*.md")) + sorted(DOCS.glob("api/*.md")):
        text = page.read_text(encoding="utf-8")
        if (now := renewed(text, captions)) != text:
            old.append(page.relative_to(DOCS).as_posix())
            if write:
                page.write_text(now, encoding="utf-8")
    return old


if __name__ == "__main__":
    check = "--check" in sys.argv[1:]
    FIGURES.mkdir(exist_ok=True)
    found = stale(write=not check)
    found += stale_gallery(write=not check) if "--gallery" in sys.argv[1:] else []
    print(
        "\n".join(f"{'out of date' if check else 'written'}: {name}" for name in found)
        or "all is as the code has it"
    )
    sys.exit(1 if check and found else 0)
