"""Words of the field that a page uses, each in a sentence or two."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from markupsafe import Markup, escape

from hd_diag.formatting import visible

TERMS = {
    "wave generator": "The elliptical plug on the motor's shaft. At both ends of its long axis, the lobes, "
    "it presses the flexspline's teeth into the slots of the circular spline.",
    "eccentricity": "How far the wave generator's centre stands beside the circular spline's axis, fixed in "
    "the housing.",
    "runout": "The same, but turning with the wave generator: the plug is off centre on its shaft.",
    "datum": "Radius from which the profile of the circular spline's slots is measured. A larger one gives "
    "all teeth more clearance.",
    "backlash": "Clearance of one tooth in its slot, along the circumference.",
    "lost motion": "Angle by which the output turns freely while the input stands: the clearance that all "
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


def used(text: str) -> dict[str, str]:
    """Terms that a text uses, with their meaning."""
    return {term: meaning for term, meaning in TERMS.items() if _pattern(term).search(text)}


@dataclass
class Links:
    """Links from where terms come first on a page to their meaning, whose ids begin with ``term-``."""

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
