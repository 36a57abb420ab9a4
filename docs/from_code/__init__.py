"""Sphinx extension: pages that hold what the code knows, and mathematics that a browser draws without help.

The pages in `PAGES` are Jinja templates; each gets what a function takes from the code. They are read anew in
every build, for the code may have changed where the page has not.
"""

from __future__ import annotations

import re
from typing import Any

from jinja2 import Environment, StrictUndefined
from sphinx.application import Sphinx

from from_code import catalogue, command_line, mathml, nomenclature, parameter_tables, result_tables, tables

PAGES = {
    "effects": catalogue.content,
    "command_line": command_line.content,
    "parameters": parameter_tables.content,
    "physics": nomenclature.content,
    "benchmarks": result_tables.content,
    "faults": result_tables.content,
    "gears": result_tables.content,
}


def plain(text: object) -> str:
    """Text of the code as Markdown that shows it as it is; ``code`` keeps its marks."""
    parts = str(text).split("``")
    told = [_escaped(part) if index % 2 == 0 else f"`{part}`" for index, part in enumerate(parts)]
    return " ".join("".join(told).split())


def _escaped(text: str) -> str:
    for mark in "\\*_`<>[]|$#":
        text = text.replace(mark, f"\\{mark}")
    return text


def render(app: Sphinx, page: str, source: list[str]) -> None:
    """Fill in a page that is a template."""
    if page in PAGES:
        environment = Environment(
            undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
        )
        environment.filters["plain"] = plain
        source[0] = environment.from_string(source[0]).render(PAGES[page](app.srcdir))


def keep_bars(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Let bars in docstrings be what they are there: an absolute value."""
    lines[:] = [re.sub(r"(?<![`\w])\|(?=\w+\|)", r"\\|", line) for line in lines]


def outdated(*_: Any) -> list[str]:
    """Pages that are read anew in every build."""
    return list(PAGES)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("source-read", render)
    app.connect("autodoc-process-docstring", keep_bars)
    app.connect("env-get-outdated", outdated)
    tables.setup(app)
    app.add_html_math_renderer(
        "mathml", inline_renderers=(mathml.inline, None), block_renderers=(mathml.block, None)
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
