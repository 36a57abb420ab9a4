"""Files that a report is of, by their digests."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from hd_diag.report.facts import Fact

_PART = 1 << 20  # read at a time [byte]


def sources(bags: Sequence[Path]) -> list[Fact]:
    """Every file of some bags with its SHA-256; OSError where one cannot be read."""
    return [
        Fact(f"{bag.resolve().name}/{name}" if bag.is_dir() else name, f"SHA-256 {digest}")
        for bag in bags
        for name, digest in digests(bag).items()
    ]


def digests(path: Path) -> dict[str, str]:
    """SHA-256 of a file, or of every file of a folder, by name."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return {file.name: sha256(file).hex() for file in files if file.is_file()}


def sha256(file: Path) -> bytes:
    """SHA-256 of a file."""
    digest = hashlib.sha256()
    with file.open("rb") as opened:
        while part := opened.read(_PART):
            digest.update(part)
    return digest.digest()
