"""Tables whose cells know their column's title: on a phone a row is a list of them (static/pages.css)."""

from __future__ import annotations

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator


class Translator(HTML5Translator):
    """Sphinx's translator, which also puts a column's title into each cell except for the first of a row."""

    def visit_entry(self, node: nodes.entry) -> None:
        """Begin a cell."""
        super().visit_entry(node)
        title = _title(node)
        if title:
            self.body[-1] = self.body[-1].replace("<td", f'<td data-name="{self.attval(title)}"', 1)


def _title(cell: nodes.entry) -> str:
    """Title of a cell's column; empty for a first or empty cell, a title, and a table without titles."""
    row, group = cell.parent, cell.parent.parent.parent
    head = group.next_node(nodes.thead)
    column = row.index(cell)
    if head is None or row.parent is head or not 0 < column < len(head[0]) or not cell.astext():
        return ""
    return str(head[0][column].astext())


def setup(app: Sphinx) -> None:
    """Register with Sphinx."""
    app.set_translator("html", Translator)
