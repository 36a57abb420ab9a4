"""Sphinx extension of the built pages: tables for phones, mathematics without scripts, table of contents.

The pages in docs/ are plain Markdown. Nothing here adds words to them.
"""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

from site_of_pages import mathml, tables

CONTENTS = ("index", "api/index")
LINK = re.compile(r"(?m)^\* \[[^\]]+\]\(([\w/]+)\.md\)")


def with_contents(app: Sphinx, page: str, source: list[str]) -> None:
    """Give a page that lists other pages a table of contents with the same links, under its headings."""
    if page not in CONTENTS:
        return
    for part in re.split(r"(?m)^## ", source[0])[1:]:
        title, names = part.partition("\n")[0], LINK.findall(part)
        source[0] += "\n```{toctree}\n:hidden:\n:caption: " + "\n".join([title, "", *names, "```", ""])


def keep_bars(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Keep bars in docstrings as absolute values."""
    lines[:] = [re.sub(r"(?<![`\w])\|(?=\w+\|)", r"\\|", line) for line in lines]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("source-read", with_contents)
    app.connect("autodoc-process-docstring", keep_bars)
    tables.setup(app)
    app.add_html_math_renderer(
        "mathml", inline_renderers=(mathml.inline, None), block_renderers=(mathml.block, None)
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
