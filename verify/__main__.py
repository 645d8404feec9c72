"""The command, and `python -m verify`: what must be settled before anything is loaded.

Ctrl-C while it is loaded ends it in a word too. What libraries print past Python (libpng, urdfdom)
goes nowhere unless --verbose: the one line of a refusal says it.
"""

import os
import signal
import sys


def _leave(_signal: int, _frame: object) -> None:
    if sys.stderr is not None:
        os.write(sys.stderr.fileno(), b"interrupted\n")
    os._exit(130)


def _mute_libraries() -> None:
    """Point descriptor 2 nowhere; Python's own standard error goes where that led."""
    stream = os.fdopen(os.dup(2), "w", buffering=1, errors="backslashreplace")
    sys.stderr = sys.__stderr__ = stream  # type: ignore[misc]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)


def main() -> None:
    """Load the command line and run it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored by the caller
        signal.signal(signal.SIGINT, _leave)
    if sys.stderr is not None and "--verbose" not in sys.argv:
        _mute_libraries()
    from verify.cli.main import main as run

    run()


if __name__ == "__main__":
    main()
