"""Frames, signs and symbols from the docstring of `hd_diag.model`: physics.md."""

from __future__ import annotations

import re

import hd_diag.model
from parts import plain, table

GREEK = ("alpha", "beta", "theta")
TERM = re.compile(r" {4}(\S.{0,14}?)(?:: |  +)(.+)")


OF_THE_ERROR = (
    (r"$\theta_{in}, \theta_{out}$", r"input and output angle as the robot reports them \[rad\]"),
    (r"$T$", r"torque on the link by the drive, positive in the link's positive direction \[N m\]"),
    (r"$c_{cup}$", r"torsion of cup and output per torque, beyond the teeth's \[rad/(N m)\]"),
    ("TE", r"transmission error \[rad\]"),
)


def frames() -> str:
    """A paragraph for each frame."""
    return "\n\n".join(f"**{term}.** {meaning}" for term, meaning in _entries("Frames"))


def symbols() -> str:
    """A table of symbols with their meaning."""
    entries = [(term, plain(meaning)) for term, meaning in _entries("Signs") + _entries("Nomenclature")]
    return table(["symbol", "meaning"], [[*entry] for entry in (*entries, *OF_THE_ERROR)])


def _entries(section: str) -> list[tuple[str, str]]:
    """Pairs of term and meaning below a heading; a line without a term continues the one before."""
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
