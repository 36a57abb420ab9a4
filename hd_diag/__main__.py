"""``hd-diag``, ``python -m hd_diag``, ``hd_diag_node``: a signal during their imports ends them cleanly."""

import sys

_INTERRUPTED = 130  # exit code, as of a process that SIGINT has ended


def main() -> None:
    """Entry point of the ``hd-diag`` command."""
    try:
        from hd_diag.cli import main as run

        run()
    except KeyboardInterrupt:
        print("hd-diag: interrupted", file=sys.stderr)  # noqa: T201
        sys.exit(_INTERRUPTED)


def node() -> None:
    """Entry point of the ``hd_diag_node`` executable."""
    from hd_diag.ros.stop_signals import note_signals

    stopped = note_signals()
    from hd_diag.ros.node import main as run

    sys.exit(run(stopped=stopped))


if __name__ == "__main__":
    main()
