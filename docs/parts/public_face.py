"""The public Python functions: python.md."""

from __future__ import annotations

import inspect

import hd_diag


def functions() -> str:
    """Signature and docstring of each."""
    return "\n\n".join(map(_section, hd_diag.__all__))


def _section(name: str) -> str:
    own = getattr(hd_diag, name)
    text = inspect.getdoc(own) or ""
    return f"### {name}\n\n```text\n{name}{inspect.signature(own)}\n\n{text}\n```"
