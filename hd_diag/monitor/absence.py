"""Why a joint has no sample, judged by the messages that arrived."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hd_diag.formatting import listed, visible
from hd_diag.monitor.joint import Joint, Window
from hd_diag.streams.alignment import Arrived
from hd_diag.streams.rules import Reason
from hd_diag.streams.signals import key, nearest

_SHOWN, _LONGEST = 8, 40  # names, and characters of one


def absence_of(joint: str) -> str:
    """Key of the fact by which the caller says why a joint has no sample."""
    return f"absence.{joint}"


def absence(joint: Joint, window: Window, lately: Sequence[Arrived]) -> str:
    """Text on why a joint has no sample since the last report, from the names that arrived `lately`."""
    config, signal = joint.config, joint.config.signals.input
    arrived = [each for times in lately for each in times]
    names = dict.fromkeys(name for own, _ in arrived for name in own)
    if window.rejected:
        stands = joint.state["reason"] == Reason.LATE_INPUT and not joint.state["reason_late"]
        return f"{'the stamps stand still' if stands else 'what comes is rejected'}: {joint.last_rejection}"
    if not arrived:
        return "nothing arrives"
    if signal is None and config.input_joint not in names:
        return missing(config.input_joint, names, config.output_joint)
    if signal is not None and not any(key(config.name, "input") in keys for _, keys in arrived):
        what = f"{signal.field} of {signal.topic or 'joint states'}"
        return f"no message has {what}; {missing(signal.name, names)}" if names else f"no message has {what}"
    if window.accepted or not lately[-1]:
        return "its input arrives no more"
    if config.signals.is_velocity:
        return "its velocity arrives, but no angle of the output to begin its integral from"
    return f"messages name {visible(config.input_joint, _LONGEST)} and give no angle of it"


def missing(wanted: str, names: Iterable[str], output: str = "") -> str:
    """Text that a name does not arrive, with the nearest name that does, or all that do."""
    shown = [visible(name, _LONGEST) for name in names]
    near, wanted = nearest(wanted, names), visible(wanted, _LONGEST)
    if near and near == output:
        return f"of {wanted} nothing arrives, of its output {visible(near, _LONGEST)} alone"
    if near:
        return f"{wanted} does not arrive; the nearest name that does is {visible(near, _LONGEST)}"
    return f"{wanted} does not arrive; the names that do are {listed(shown, _SHOWN) or 'none'}"
