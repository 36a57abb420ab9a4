"""A report as one page of HTML: no network, no script, all text from a bag escaped."""

from __future__ import annotations

import base64
import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from hd_diag.diagnosis.ripple import verdict as ripple
from hd_diag.formatting import (
    ARCSEC,
    arcsec,
    direction,
    number,
    percent,
    percents,
    rounded,
    si,
    size,
    visible,
    words,
)
from hd_diag.report.drawings import drawings
from hd_diag.report.facts import Fact, JointReport, versions
from hd_diag.report.pictures.markup import inline_svg
from hd_diag.report.torsion import k_shown

TERMS = {
    "wave generator": "The elliptical plug on the motor's shaft. At both ends of its long axis, the lobes, "
    "it presses the flexspline's teeth into the slots of the circular spline.",
    "eccentricity": "How far the wave generator's centre stands beside the circular spline's axis, fixed in "
    "the housing.",
    "runout": "The same, but turning with the wave generator: the plug is off centre on its shaft.",
    "tilt": "Angle between the wave generator's axis and the circular spline's, fixed in the housing: "
    "along the width of the teeth the eccentricity then changes.",
    "datum": "Radius at the origin of the circular spline's slot profile. A larger one gives "
    "all teeth more clearance.",
    "backlash": "Clearance of one tooth in its slot, along the circumference.",
    "lost motion": "Free angle of the output while the input stands: the clearance that all "
    "teeth together leave. None is left where the lobes overlap.",
    "interference": "A tooth and its slot would take the same place: backlash below zero at that tooth, as "
    "long as the flexspline does not turn out of the way.",
    "overlap": "How far the teeth of both lobes press against each other without torque, at the best "
    "position of the flexspline. Preloaded gears have some µm of it; it loads the teeth without use.",
    "windup": "Torsion of the gear by friction between it and the torque sensor, a torque that the sensor "
    "does not see.",
    "hysteresis": "Torsion differs between rising and falling torque: friction in the teeth and in the "
    "flexspline.",
    "compliance": "Yielding under load, the inverse of a stiffness: of a pair of teeth [nm/N], of the "
    "flexspline's cup [arcsec/(N m)].",
    "residual": "Measured less simulated transmission error.",
    "noise floor": "Scatter of the measurement itself: no model can be nearer to the data than that.",
}
"""What a term means, in the order in which they are listed."""


def page(reports: Sequence[JointReport], sources: Sequence[Fact]) -> str:
    """HTML of a report, with its source files' digests. Equal numbers give equal pages: there is no date."""
    joints: list[dict[str, Any]] = []
    texts = [line for report in reports for line in report.lines]
    for report in reports:
        name, pictures = f"joint{len(joints) + 1}", {}
        for key, title, figure, caption in drawings(report):
            svg = inline_svg(figure, f"{name}-{key}", title, caption)
            pictures[key] = {"svg": svg, "caption": caption}
            texts.append(caption)
        joints.append({"report": report, "pictures": pictures, "id": name})
        for card in report.judgement.cards if report.judgement else ():
            texts += (card.title, card.cause, card.inspect)
    return rendered(
        "report.html.jinja",
        title=f"Harmonic drive report: {', '.join(report.name for report in reports)}",
        sources=sources,
        versions=versions(),
        joints=joints,
        terms=used(" ".join(texts)),
        linked=Links(),
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
    told = (arcsec, direction, number, percent, percents, rounded, si, size, k_shown)
    environment.globals |= {each.__name__: each for each in told} | {"ARCSEC": ARCSEC, "pi": math.pi}
    # Content-Security-Policy: this one style, pictures within the page, nothing else.
    digest = base64.b64encode(hashlib.sha256(style.encode("utf-8")).digest()).decode("ascii")
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; img-src data:; base-uri 'none'; "
    policy += "form-action 'none'"
    return environment.get_template(template).render(policy=policy, style=style, **content)


def _shown(value: Any) -> Any:
    """Text with hidden characters made visible: a name may hold control characters and direction marks."""
    return visible(value) if isinstance(value, str) and not hasattr(value, "__html__") else value


# Words of the field ---


def used(text: str) -> dict[str, str]:
    """Terms that a text uses, with their meaning."""
    return {term: meaning for term, meaning in TERMS.items() if _pattern(term).search(text)}


@dataclass
class Links:
    """Links from the first use of each term on a page to its meaning; ids begin with ``term-``."""

    linked: set[str] = field(default_factory=set)

    def __call__(self, text: str) -> Markup:
        """Text for the page, escaped."""
        found = str(escape(visible(text)))
        places = {term: match for term in TERMS if (match := _pattern(term).search(found))}
        new = {term: match for term, match in places.items() if term not in self.linked}
        for term, match in sorted(new.items(), key=lambda item: -item[1].start()):
            link = f'<a class="term" href="#term-{term.replace(" ", "-")}">{match[0]}</a>'
            found = found[: match.start()] + link + found[match.end() :]
        self.linked |= set(new)
        return Markup(found)


def _pattern(term: str) -> re.Pattern[str]:
    return re.compile(rf"\b{term}s?\b", re.IGNORECASE)
