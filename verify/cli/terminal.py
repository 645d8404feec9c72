"""The user's terminal: progress, lines or JSON out, typed lines in; colour honours NO_COLOR."""

import json
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from verify.errors import one_line

if TYPE_CHECKING:  # imported with the first bar: `--help` answers at once
    from rich.progress import Progress

MAX_LINES = 10  # progress lines where there is no terminal to draw a bar on
STDIN = 0  # its descriptor


@dataclass(slots=True)
class Terminal:
    """How much is printed, and in which form."""

    quiet: bool = False
    verbose: bool = False
    as_json: bool = False
    opens: bool = False  # a report's page, in the browser

    @property
    def draws(self) -> bool:
        """Whether there is a terminal to draw a table on."""
        return sys.stdout.isatty() and not self.as_json and not self.quiet

    def say(self, *texts: str) -> None:
        """Print lines for the reader; nothing with --quiet or --json."""
        for text in texts:
            if not (self.quiet or self.as_json):
                _write(text)

    def detail(self, *texts: str) -> None:
        """Print lines that only --verbose asks for."""
        if self.verbose:
            self.say(*texts)

    def warn(self, *texts: str) -> None:
        """Print warnings on standard error, or as objects with --json."""
        for text in texts:
            if self.as_json:
                self.record("warning", text=text)
            elif not self.quiet:
                sys.stderr.write(f"warning: {one_line(text)}\n")

    def record(self, kind: str, /, **fields: Any) -> None:
        """Print one JSON object, its `type` and its fields, on a line of its own, with --json."""
        if self.as_json:
            _write(json.dumps({"type": kind, **fields}, ensure_ascii=False, allow_nan=False))

    @contextmanager
    def progress(self, what: str) -> Iterator["ProgressCounter"]:
        """Show how far long work has come: a bar on a terminal, plain lines elsewhere."""
        from rich import progress as bars
        from rich.console import Console

        console, silent = Console(stderr=True), self.quiet or self.as_json
        if silent or not console.is_terminal:
            yield ProgressCounter(None, what, silent=silent)
            return
        columns = (
            bars.TextColumn("{task.description}", markup=False),  # it may name a folder
            bars.BarColumn(),
            bars.MofNCompleteColumn(),
            bars.TextColumn("{task.fields[rate]}"),
            bars.TimeRemainingColumn(),
        )
        with bars.Progress(*columns, console=console, transient=True) as bar:
            yield ProgressCounter(bar, what, silent=False)


def report_files(folder: Path, name: str = "report") -> str:
    """Name the two files of a report in a sentence, as links on a terminal; --open opens one."""
    page, paper = folder / f"{name}.html", folder / f"{name}.pdf"
    if terminal.opens:
        import webbrowser

        if not webbrowser.open(page.resolve().as_uri()):
            terminal.warn(f"No browser was found to open {page}.")
    return f"{_link(page)} and {_link(paper)}"


def _link(path: Path) -> str:
    """A path that a terminal opens (OSC 8); elsewhere its text alone."""
    if not terminal.draws:
        return str(path)
    return f"\x1b]8;;{path.resolve().as_uri()}\x1b\\{path}\x1b]8;;\x1b\\"


def read_lines(descriptor: int, take: Callable[[str], None]) -> None:
    """Pass on each line that is typed, from a thread of its own; an input that ends is ignored."""

    def read() -> None:
        with suppress(OSError):  # no input at all
            # not sys.stdin's own lines: a thread that waits in there locks it to the very end
            while typed := os.read(descriptor, 1024):
                for line in typed.decode(errors="replace").splitlines():
                    take(line)

    threading.Thread(target=read, name="keys", daemon=True).start()


def _write(line: str) -> None:
    """Write a line to standard output at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


class ProgressCounter:
    """Receives `done, total` and shows it."""

    def __init__(self, bar: "Progress | None", what: str, *, silent: bool) -> None:
        self._bar, self._what, self._silent = bar, what, silent
        self._task = bar.add_task(what, total=None, rate="") if bar is not None else None
        self._lines = 0

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Show that `done` of `total` are finished, with a note on them."""
        if self._bar is not None and self._task is not None:
            text = f"{self._what}, {note}" if note else self._what
            speed = self._bar.tasks[self._task].speed  # one task a bar
            rate = "" if speed is None else f"{speed:.1f}/s"
            self._bar.update(self._task, completed=done, total=total, description=text, rate=rate)
        elif not self._silent and done * MAX_LINES // max(total, 1) > self._lines:
            self._lines = done * MAX_LINES // max(total, 1)
            sys.stderr.write(f"{self._what}: {done} of {total}{f', {note}' if note else ''}\n")


def show_log() -> None:
    """Show the package's log on standard error; nothing with --quiet or --json.

    Not called in child processes, which know no --quiet.
    """
    handler = logging.StreamHandler()
    handler.addFilter(lambda _: not (terminal.quiet or terminal.as_json))
    log = logging.getLogger("verify")
    log.handlers[:] = [handler]
    log.setLevel(logging.INFO)


def hangups() -> tuple[signal.Signals, ...]:
    """Signals of a terminal that closes: none where ignored, as under nohup, or not known."""
    number: signal.Signals | None = getattr(signal, "SIGHUP", None)
    if number is None or signal.getsignal(number) is signal.SIG_IGN:
        return ()
    return (number,)


terminal = Terminal()
