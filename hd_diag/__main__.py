"""``hd-diag`` and ``python -m hd_diag``: Ctrl-C ends it quietly while modules are imported, too."""

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


if __name__ == "__main__":
    main()
