"""Fuzz the edges for some time: damaged bags, messages and logs are taken, or refused in the proper way.

    python bench/fuzz.py bags|replay [--minutes M] [--seed S]

`bags`: readers and `recover`, which may raise BagError alone. `replay`: the verbs replay and recover and the
reader of diagnose, which may end with one line and code 2. Prints the number of bags tried and refused, the
longest time that one took, and the peak of memory. A bag that gives anything else is kept as
``fuzz_<turn>.mcap`` in the current folder, and the exit code is 1.
"""

# ruff: noqa: D101, D103, T201

import argparse
import contextlib
import random
import resource
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test"))
from bag_samples import accepts, corpus, damaged, joint_state_cdr
from replay_fuzz import Fuzz

from hd_diag.bag import BagError, recover
from hd_diag.messages.joint_states import JointStateDecoder, decode_joint_states

MESSAGE = joint_state_cdr(("joint_1_motor", "joint_1"), 5, (1.0, 2.0), (3.0, 4.0), (5.0, 6.0), "base")


class Bags:
    def __init__(self, folder, seed):
        self._chance, self._bags = random.Random(seed), corpus(folder)
        self.bag, self._out = folder / "a.mcap", folder / "b.mcap"
        self.counts = {"accepted": 0, "refused": 0}

    def turn(self):
        """Read a bag, sometimes also recover it; decode ten messages in both ways."""
        self.bag.write_bytes(damaged(self._chance.choice(self._bags), self._chance))
        self.counts["refused" if accepts(self.bag) is None else "accepted"] += 1
        if self._chance.random() < 0.1:
            with contextlib.suppress(BagError):
                recover(self.bag, self._out, overwrite=True)
        for _ in range(10):
            data = damaged(MESSAGE, self._chance)
            columns, _ = decode_joint_states([data])
            try:
                JointStateDecoder().decode(data)
            except ValueError:
                assert not columns
            else:
                assert columns


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("bags", "replay"))
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    failed = turns = 0
    slowest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        fuzz = (Bags if options.what == "bags" else Fuzz)(Path(folder), options.seed)
        stop = time.monotonic() + 60 * options.minutes
        while time.monotonic() < stop:
            begin = time.process_time()
            try:
                fuzz.turn()
            except Exception as error:
                failed += 1
                Path(f"fuzz_{turns}.mcap").write_bytes(fuzz.bag.read_bytes())
                print(f"turn {turns}: {type(error).__name__}: {' '.join(str(error).split())[:300]}")
            slowest = max(slowest, time.process_time() - begin)
            turns += 1
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    counts = fuzz.counts
    print(f"{turns} bags: {counts['refused']} refused, {counts['accepted']} taken, {failed} failed")
    print(f"slowest bag {slowest:.3f} s of CPU time; peak memory {memory:.0f} MB")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
