"""The command, and `python -m verify`: what must be settled before anything is loaded.

Ctrl-C while it is loaded ends it in a word too. What libraries and child processes print past
Python (libpng, urdfdom) is kept aside unless --verbose, as the one line of a refusal says it; the
last of it is shown where the command ends by a defect. A crash shows where it was.
"""

import faulthandler
import io
import os
import signal
import sys
from contextlib import suppress
from typing import Any, TextIO

MAX_KEPT = 1 << 20  # bytes of what libraries print: beyond it nothing is taken
MAX_LINES = 20  # of it, shown


def _leave(_signal: int, _frame: object) -> None:
    with suppress(OSError):
        os.write(sys.stderr.fileno(), b"interrupted\n")
    os._exit(130)


class _StreamFile(io.FileIO):
    """The descriptor of a standard stream: after an error what is written is dropped.

    An error that is not of the `dropped` kind is raised, once.
    """

    def __init__(self, descriptor: int, dropped: type[OSError]) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._dropped = dropped

    def write(self, data: Any, /) -> int:
        """Write bytes, or drop them."""
        try:
            return super().write(data)
        except OSError as error:
            dropped, self._dropped = isinstance(error, self._dropped), OSError
            if not dropped:
                raise
            return len(data)


def _stream(before: TextIO | None, file: _StreamFile, errors: str) -> io.TextIOWrapper:
    """Make a standard stream in the encoding of the one that it replaces."""
    encoding = None if before is None else before.encoding
    buffer = io.BufferedWriter(file)
    return io.TextIOWrapper(buffer, encoding=encoding, errors=errors, line_buffering=True)


def _replace_streams(*, muted: bool) -> None:
    """Replace the standard streams by ones that drop what cannot be written, and open closed ones.

    A full disk remains an error of standard output. With `muted` descriptor 2 is not used.
    """
    for descriptor, stream in enumerate((sys.stdin, sys.stdout, sys.stderr)):
        if stream is None:  # else the next file that is opened gets the descriptor
            os.dup2(os.open(os.devnull, os.O_RDWR), descriptor)
    out = _StreamFile(1, OSError if os.isatty(1) else BrokenPipeError)  # a terminal closes
    error = _StreamFile(os.dup(2) if muted else 2, OSError)
    sys.stdout = sys.__stdout__ = _stream(sys.stdout, out, "replace")  # type: ignore[misc]
    stderr = _stream(sys.stderr, error, "backslashreplace")
    sys.stderr = sys.__stderr__ = stderr  # type: ignore[misc]


def _mute_libraries() -> int:
    """Point descriptor 2 at a file in memory."""
    if sys.platform != "linux":
        kept = os.open(os.devnull, os.O_RDWR)
    else:
        import fcntl

        kept = os.memfd_create("stderr", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(kept, MAX_KEPT)
        fcntl.fcntl(kept, fcntl.F_ADD_SEALS, fcntl.F_SEAL_GROW)
    os.dup2(kept, 2)
    return kept


def main() -> None:
    """Load the command line and run it."""
    muted = "--verbose" not in sys.argv
    _replace_streams(muted=muted)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored by the caller
        signal.signal(signal.SIGINT, _leave)
    kept = _mute_libraries() if muted else None
    faulthandler.enable(sys.stderr)
    from verify.cli.main import DEFECT, INTERRUPTED
    from verify.cli.main import main as run

    try:
        run()
    except SystemExit as end:
        if kept is not None and end.code == DEFECT:  # show what was printed last
            os.lseek(kept, 0, os.SEEK_SET)
            lines = os.read(kept, MAX_KEPT).rstrip(b"\0").decode(errors="replace").splitlines()
            sys.stderr.write("".join(f"{line}\n" for line in lines[-MAX_LINES:]))
        raise
    except KeyboardInterrupt:  # one more, while the first was answered
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
