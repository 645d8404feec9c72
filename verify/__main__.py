"""The command, and `python -m verify`: what must be settled before anything is loaded.

Ctrl-C while it is loaded ends it in a word too. What libraries and child processes print past
Python (libpng, urdfdom) is kept aside unless --verbose, as the one line of a refusal says it; the
last of it is shown where the command ends by a defect. A crash shows where it was.
"""

import faulthandler
import os
import signal
import sys

MAX_KEPT = 1 << 20  # bytes of what libraries print: beyond it nothing is taken
MAX_LINES = 20  # of it, shown


def _leave(_signal: int, _frame: object) -> None:
    if sys.stderr is not None:
        os.write(sys.stderr.fileno(), b"interrupted\n")
    os._exit(130)


def _mute_libraries() -> int:
    """Point descriptor 2 at a file in memory; Python's own standard error goes where that led."""
    stream = os.fdopen(os.dup(2), "w", buffering=1, errors="backslashreplace")
    sys.stderr = sys.__stderr__ = stream  # type: ignore[misc]
    if sys.platform != "linux":
        kept = os.open(os.devnull, os.O_RDWR)
    else:
        import fcntl

        kept = os.memfd_create("stderr", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(kept, MAX_KEPT)
        fcntl.fcntl(kept, fcntl.F_ADD_SEALS, fcntl.F_SEAL_GROW)
    os.dup2(kept, 2)
    return kept


def _show(kept: int) -> None:
    """Show the last lines of what libraries and child processes have printed."""
    os.lseek(kept, 0, os.SEEK_SET)
    lines = os.read(kept, MAX_KEPT).rstrip(b"\0").decode(errors="replace").splitlines()
    sys.stderr.write("".join(f"{line}\n" for line in lines[-MAX_LINES:]))


def main() -> None:
    """Load the command line and run it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored by the caller
        signal.signal(signal.SIGINT, _leave)
    kept = None
    if sys.stderr is not None:
        kept = None if "--verbose" in sys.argv else _mute_libraries()
        faulthandler.enable(sys.stderr)
    from verify.cli.main import DEFECT
    from verify.cli.main import main as run

    try:
        run()
    except SystemExit as end:
        if kept is not None and end.code == DEFECT:
            _show(kept)
        raise


if __name__ == "__main__":
    main()
