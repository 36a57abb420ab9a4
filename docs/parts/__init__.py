"""Parts of the pages, made from the code, from tables of measurements and from example files."""

from __future__ import annotations


def plain(text: object) -> str:
    """Text of the code as Markdown that shows it as it is; ``code`` keeps its marks."""
    parts = str(text).split("``")
    told = [_escaped(part) if index % 2 == 0 else f"`{part}`" for index, part in enumerate(parts)]
    return " ".join("".join(told).split())


def _escaped(text: str) -> str:
    for mark in "\\*_`<>[]|$#":
        text = text.replace(mark, f"\\{mark}")
    return text


def table(titles: list[str], rows: list[list[str]]) -> str:
    """A Markdown table of cells that are Markdown already."""
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
