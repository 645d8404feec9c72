"""What the user sees while a command works: progress, lines, or JSON; colour honours NO_COLOR."""

import json
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from verify.errors import one_line

MAX_LINES = 10  # progress lines where there is no terminal to draw a bar on


@dataclass(slots=True)
class Terminal:
    """How much is said, and in which form."""

    quiet: bool = False
    verbose: bool = False
    as_json: bool = False

    def say(self, text: str) -> None:
        """Print a line for the reader; nothing with --quiet or --json."""
        if not (self.quiet or self.as_json):
            _write(text)

    def detail(self, text: str) -> None:
        """Print a line that only --verbose asks for."""
        if self.verbose:
            self.say(text)

    def warn(self, text: str) -> None:
        """Print a warning on standard error, or as an object with --json."""
        if self.as_json:
            self.record({"type": "warning", "text": text})
        elif not self.quiet:
            sys.stderr.write(f"warning: {one_line(text)}\n")

    def record(self, fields: dict[str, Any]) -> None:
        """Print one JSON object on a line of its own, with --json."""
        if self.as_json:
            _write(json.dumps(fields, ensure_ascii=False, allow_nan=False))

    @contextmanager
    def progress(self, what: str) -> Iterator["ProgressCounter"]:
        """Show how far long work has come: a bar on a terminal, plain lines elsewhere."""
        console = Console(stderr=True)
        if self.quiet or self.as_json:
            yield ProgressCounter(None, what, silent=True)
        elif not console.is_terminal:
            yield ProgressCounter(None, what, silent=False)
        else:
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                _PairRate(),
                TimeRemainingColumn(),
            )
            with Progress(*columns, console=console, transient=True) as bar:
                yield ProgressCounter(bar, what, silent=False)


def _write(line: str) -> None:
    """Write a line to standard output; to nowhere once the reader has gone (`| head`)."""
    try:
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _PairRate(ProgressColumn):
    """Pairs a second."""

    def render(self, task: Task) -> Text:
        """Write the rate, once it is known."""
        return Text("" if task.speed is None else f"{task.speed:.1f}/s")


class ProgressCounter:
    """Receives `done, total` and shows it."""

    def __init__(self, bar: Progress | None, what: str, *, silent: bool) -> None:
        self._bar, self._what, self._silent = bar, what, silent
        self._task = bar.add_task(what, total=None) if bar is not None else None
        self._said = 0

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Take note that `done` of `total` are through; `note` says more about them."""
        if self._bar is not None and self._task is not None:
            said = f"{self._what}, {note}" if note else self._what
            self._bar.update(self._task, completed=done, total=total, description=said)
        elif not self._silent and done * MAX_LINES // max(total, 1) > self._said:
            self._said = done * MAX_LINES // max(total, 1)
            sys.stderr.write(f"{self._what}: {done} of {total}{f', {note}' if note else ''}\n")


class _LogHandler(logging.Handler):
    """Show what the package logs on standard error; nothing with --quiet or --json."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        if not (terminal.quiet or terminal.as_json):
            sys.stderr.write(f"{record.getMessage()}\n")


terminal = Terminal()
logging.getLogger("verify").addHandler(_LogHandler())
logging.getLogger("verify").setLevel(logging.INFO)
