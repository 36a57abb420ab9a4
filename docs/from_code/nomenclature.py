"""Frames, signs and symbols, from the one place that states them: the model's own documentation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import hd_diag.model

GREEK = ("alpha", "beta", "theta")
TERM = re.compile(r" {4}(\S.{0,14}?)(?:: |  +)(.+)")


def content(folder: Path) -> dict[str, Any]:
    """What physics.md is filled with."""
    sections = {name: _entries(name) for name in ("Frames", "Signs", "Nomenclature")}
    return {"frames": sections["Frames"], "symbols": sections["Signs"] + sections["Nomenclature"]}


def _entries(section: str) -> list[tuple[str, str]]:
    """Pairs of term and meaning below a heading; a line without a term goes on."""
    text = hd_diag.model.__doc__ or ""
    found = re.search(rf"(?m)^{section}\n((?:    .*\n)+)", text)
    if not found:
        raise ValueError(f"hd_diag.model documents no {section}")
    entries: list[list[str]] = []
    for line in found.group(1).splitlines():
        begun = TERM.fullmatch(line)
        if begun:
            entries.append([*begun.groups()])
        else:
            entries[-1][1] += f" {line.strip()}"
    return [(symbol(term), meaning) for term, meaning in entries]


def symbol(term: str) -> str:
    """A term as mathematics, unless it is a word."""
    if re.search(r"[a-z]{3,}", re.sub("|".join(GREEK), "", term)):
        return term
    term = re.sub(r"\bK(\d)", r"K_\1", term)
    return f"${re.sub('|'.join(GREEK), lambda name: chr(92) + name.group(), term)}$"
