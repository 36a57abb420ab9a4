"""``hd-diag replay`` and ``recover``: run the model over a bag, save the readable part of a damaged one."""

from __future__ import annotations

import dataclasses
import time
from functools import partial
from pathlib import Path

from hd_diag.bag import BagError
from hd_diag.bag.mcap_scan import DamagedChunk
from hd_diag.bag.recover import recover as recover_bag
from hd_diag.cli.joints import configured
from hd_diag.cli.lines import tell
from hd_diag.cli.progress import interrupted, working
from hd_diag.cli.targets import Problem, write_json
from hd_diag.replay.preparation import compile_apart
from hd_diag.replay.replay import Replay
from hd_diag.replay.replay import replay as replay_bag
from hd_diag.ros.stop_signals import Stopped, noted_signals


def replay(
    bag: Path,
    out: Path,
    config_file: str | None,
    topics: tuple[str, ...],
    overwrite: bool,
    json_file: str | None,
) -> int:
    """Run ``hd-diag replay``."""
    config = configured(config_file) if config_file else None
    begin, kept, done = time.monotonic(), out.exists(), 0
    try:
        with noted_signals() as came:
            compile_apart(came, partial(tell, err=True))
        if came:
            raise Stopped(came[0])
        with working() as part:
            advance = part("replay", "messages")

            def progress(messages: int, total: int) -> None:
                nonlocal done
                done = messages
                advance(messages, total)

            result = replay_bag(bag, out, config, topics=topics, overwrite=overwrite, progress=progress)
    except KeyboardInterrupt as error:
        interrupted(error, out, kept, f"what the first {done} messages give")
    except BagError as error:
        if not isinstance(error, DamagedChunk) and not isinstance(error.__cause__, DamagedChunk):
            raise
        raise Problem(f"{error}; hd-diag recover saves the rest of the bag") from error
    took = time.monotonic() - begin
    content = {"schema": "hd_diag/replay/1", "out": str(out), "seconds": took}
    if write_json(json_file, content | dataclasses.asdict(result)):
        _tell_replay(result, out, took)
    return Problem.exit_code if result.absent else 0


def _tell_replay(result: Replay, out: Path, took: float) -> None:
    for problem in result.problems:
        tell(f"warning: {problem}", err=True)
    how = "its own configuration followed" if result.reproduced else "with the given configuration"
    speed = f", {result.duration / took:.0f} times real time" if took > 0 else ""
    tell(
        f"{result.messages} messages of {result.duration:.1f} s replayed in {took:.1f} s{speed} ({how}); "
        f"{result.written} written to {out}"
    )
    for joint, why in result.absent.items():
        tell(f"hd-diag: {joint}: {why}", err=True)
    for joint in result.joints:
        if zero := result.stamps_zero[joint]:
            tell(f"{joint}: the stamps of {zero} messages are zero: the time of reception stands for them")
        if result.rejected[joint] or result.missed[joint]:
            last = f", the last because: {result.last_rejection[joint]}" if result.rejected[joint] else ""
            gaps = f"{result.missed[joint]} missing by the stamps"
            tell(f"{joint}: {result.rejected[joint]} rejected{last}; {gaps}")


def recover(bag: Path, out: Path, overwrite: bool, json_file: str | None) -> None:
    """Run ``hd-diag recover``."""
    kept = out.exists()
    try:
        with working() as part:
            advance = part("recover", "kB")

            def progress(done: int, total: int) -> None:
                advance(done * 1e-3, total * 1e-3)

            report = recover_bag(bag, out, overwrite=overwrite, progress=progress)
    except KeyboardInterrupt as error:
        interrupted(error, out, kept)
    if not any(report.counts.values()) and not report.complete:
        raise Problem(f"{bag}: nothing can be saved: {report.statement()[1]}")
    if write_json(json_file, {"schema": "hd_diag/recovery/1", **report.as_dict()}):
        for line in report.statement():
            tell(line)
