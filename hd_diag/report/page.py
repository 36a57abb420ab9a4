"""A report as one page of HTML: no network, no script, nothing out of a bag that is not escaped."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from hd_diag.diagnosis.ripple import verdict as ripple
from hd_diag.formatting import arcsec, visible, words
from hd_diag.report import captions, glossary
from hd_diag.report.facts import Fact, JointReport, versions
from hd_diag.report.pictures.page_pictures import pictures


def page(reports: Sequence[JointReport], sources: Sequence[Fact]) -> str:
    """HTML of a report, with files and their digests: the same for the same numbers, without a date."""
    joints: list[dict[str, Any]] = [
        {"report": report, "pictures": pictures(report, number), "id": f"joint{number}"}
        for number, report in enumerate(reports, start=1)
    ]
    texts = [picture["caption"] for joint in joints for picture in joint["pictures"].values()]
    texts += [report.verdict for report in reports]
    cards = [card for report in reports if report.judgement for card in report.judgement.cards]
    texts += [text for card in cards for text in (card.title, card.cause, card.inspect)]
    return rendered(
        "report.html.jinja",
        title=f"Harmonic drive report: {', '.join(report.name for report in reports)}",
        sources=sources,
        versions=versions(),
        joints=joints,
        terms=glossary.used(" ".join(texts)),
        linked=glossary.Links(),
        captions=captions,
        ripple=ripple,
    )


def rendered(template: str, styles: str = "", **content: Any) -> str:
    """HTML of a template with its content; `styles` come after those that all pages share."""
    texts = files("hd_diag.report") / "templates"
    style = (texts / "report.css").read_text(encoding="utf-8") + styles
    environment = Environment(
        loader=PackageLoader("hd_diag.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"words": words}
    return environment.get_template(template).render(
        policy=_policy(style), style=style, arcsec=arcsec, **content
    )


def _policy(style: str) -> str:
    """Content-Security-Policy: this one style, pictures within the page, nothing else."""
    digest = base64.b64encode(hashlib.sha256(style.encode("utf-8")).digest()).decode("ascii")
    return (
        f"default-src 'none'; style-src 'sha256-{digest}'; img-src data:; base-uri 'none'; form-action 'none'"
    )


def _shown(value: Any) -> Any:
    """Text in which nothing is hidden: a name may hold control characters and marks that turn the line."""
    return visible(value) if isinstance(value, str) and not hasattr(value, "__html__") else value
