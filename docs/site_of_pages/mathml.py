"""Mathematics as MathML, which browsers draw by themselves: no script and no font from anywhere."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml


def inline(translator: Any, node: nodes.math) -> None:
    """An inline formula."""
    translator.body.append(latex2mathml.tex2mathml(node.astext()))
    raise nodes.SkipNode


def block(translator: Any, node: nodes.math_block) -> None:
    """A displayed formula."""
    translator.body.append(translator.starttag(node, "div", CLASS="formula"))
    translator.body.append(latex2mathml.tex2mathml(node.astext().strip(), True))
    translator.body.append("</div>\n")
    raise nodes.SkipNode
