"""How bad a joint is, in words: what a verdict begins with."""

from __future__ import annotations

from hd_diag.diagnosis.judgement import Answer
from hd_diag.formatting import ARCSEC, words


def first_words(answer: Answer) -> str:
    """What the verdict begins with: whether the model describes the record, and how bad the joint is."""
    fatal = [finding for finding in answer.diagnosis.findings if finding.fatal]
    return f"First of all: {fatal[0].text}" if fatal else "; ".join([*_misfit(answer), *_severity(answer)])


def _misfit(answer: Answer) -> list[str]:
    left = answer.diagnosis.misfit
    if left is None or not left.suspected or (left.measured and not left.certain):
        return []
    if not left.certain:
        return [
            "whether the model describes this record cannot be determined: "
            f"{left.low:.1f} to {left.value:.1f} times the noise is left, "
            "and too little of the motion repeats to tell"
        ]
    text = "the model does not describe this record"
    if not answer.diagnosis.record.has_torque:
        text += ", whose torque is not measured, so that torsion by it counts as unexplained"
    return [f"{text}: {left.value:.1f} times the noise is left"]


def _severity(answer: Answer) -> list[str]:
    """The joint beside its catalogue's accuracy, and its eccentricity beside what the assembly may have."""
    parts, usual, assembly = [], answer.normal, answer.tolerance
    if usual is not None:
        size, allowed = usual.value / ARCSEC, usual.limit / ARCSEC
        where = "within" if usual.within else "beyond"
        own = f"{size:.0f}" if size >= 0.5 else "none to be seen beside the noise,"
        parts.append(f"the joint is {where} its accuracy ({own} of {allowed:.0f} arcsec peak to peak)")
    else:
        parts.append("whether the joint is within its accuracy cannot be judged without its torque")
    if assembly is not None and answer.diagnosis.allowed is not None:
        where = "within" if assembly.within else "beyond"
        sizes = f"{assembly.value * 1e6:.1f} of {assembly.limit * 1e6:.1f} µm"
        by = words(answer.diagnosis.allowed.criterion)
        parts.append(f"its eccentricity is {where} the tolerance's limit ({sizes}, by {by})")
    return [" and ".join(parts)]
