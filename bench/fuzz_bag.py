"""Fuzz the bag edge for some time: damaged, random and cut bags must be read or refused with BagError.

    python bench/fuzz_bag.py [--minutes M] [--seed S]

Prints the number of bags tried and refused, the longest time that one took, and the peak of memory. A bag
that causes any other error is kept as ``fuzz_<turn>.mcap`` in the current folder, and the exit code is 1.
"""

# ruff: noqa: D103, T201

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

from hd_diag.bag import BagError, recover
from hd_diag.messages.joint_states import JointStateDecoder, decode_joint_states


def try_bag(path, out, chance):
    """Read a bag, sometimes also recover it; whether it was accepted."""
    found = accepts(path)
    if chance.random() < 0.1:
        with contextlib.suppress(BagError):
            recover(path, out, overwrite=True)
    return found is not None


def try_message(chance, message):
    """Decode a damaged JointState in both ways."""
    data = damaged(message, chance)
    columns, _ = decode_joint_states([data])
    try:
        JointStateDecoder().decode(data)
    except ValueError:
        assert not columns
    else:
        assert columns


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    chance = random.Random(options.seed)
    tried = refused = failed = messages = 0
    slowest = 0.0
    message = joint_state_cdr(("joint_1_motor", "joint_1"), 5, (1.0, 2.0), (3.0, 4.0), (5.0, 6.0), "base")
    with tempfile.TemporaryDirectory() as folder:
        bags = corpus(Path(folder))
        path, out = Path(folder) / "a.mcap", Path(folder) / "b.mcap"
        stop = time.monotonic() + 60 * options.minutes
        while time.monotonic() < stop:
            path.write_bytes(damaged(bags[tried % len(bags)], chance))
            begin = time.monotonic()
            try:
                refused += not try_bag(path, out, chance)
                for _ in range(10):
                    try_message(chance, message)
                    messages += 1
            except Exception as exc:
                failed += 1
                Path(f"fuzz_{tried}.mcap").write_bytes(path.read_bytes())
                print(f"turn {tried}: {type(exc).__name__}: {exc}")
            slowest = max(slowest, time.monotonic() - begin)
            tried += 1
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{tried} damaged bags: {refused} refused, {tried - refused - failed} read, {failed} failed")
    print(f"{messages} damaged messages; slowest bag {slowest:.3f} s; peak memory {memory:.0f} MB")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
