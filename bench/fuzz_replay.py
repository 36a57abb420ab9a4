"""Fuzz replay, recover and the reader of diagnose for some time: damaged logs are taken or refused properly.

    python bench/fuzz_replay.py [--minutes M] [--seed S]

Prints the number of bags tried and refused, the longest time that one took, and the peak of memory. A bag
that gives a traceback, more than one line or another exit code is kept as ``fuzz_<turn>.mcap`` in the current
folder, and the exit code is 1.
"""

# ruff: noqa: D103, T201

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test"))
from replay_fuzz import Fuzz


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    failed = turns = 0
    slowest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        fuzz = Fuzz(Path(folder), options.seed)
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
