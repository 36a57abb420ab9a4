"""``hd-diag``, ``python -m hd_diag``, ``hd_diag_node``: a signal during their imports ends them cleanly."""

import atexit
import gc
import os
import sys

from hd_diag.memory import watch_limit

atexit.register(gc.freeze)  # skips a last garbage collection at exit, which takes 0.25 s


def _open_streams() -> None:
    """Open closed standard streams on the null device; the next file would get their number otherwise."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115


def main() -> None:
    """Entry point of the ``hd-diag`` command."""
    _open_streams()
    is_node = sys.argv[1:2] == ["node"]
    if not is_node:  # in a node ROS writes its log past Python
        watch_limit()
    gc.disable()  # until a verb runs: imports leave no garbage, and collecting takes a sixth of a start
    try:
        from hd_diag.ros.stop_signals import note_signals, raise_signals

        if is_node:
            note_signals()
        else:
            raise_signals()
        from hd_diag.cli import main as run

        run()
    except (Exception, KeyboardInterrupt) as error:
        from hd_diag.ros.stop_signals import ignore_signals, signalled

        if not (code := signalled(error)):
            raise
        ignore_signals()
        print("hd-diag: interrupted", file=sys.stderr)  # noqa: T201
        sys.exit(code)


def node() -> None:
    """Entry point of the ``hd_diag_node`` executable."""
    _open_streams()
    from hd_diag.ros.stop_signals import note_signals

    stopped = note_signals()
    from hd_diag.ros.node import main as run

    sys.exit(run(stopped=stopped))


if __name__ == "__main__":
    main()
