"""What every command promises of broken input, and commands with files to break.

A case copies a folder, breaks one file and runs a command on it in this process. The promise:

- exit status 0, 1, 2 or 3, and no traceback;
- with status 2 one line of error, with a place and what to do, and nothing written;
- within 20 s;
- no wrong figure: what is accepted gives the same figures, or warns, or is undecided.
"""

import json
import re
import shutil
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from unittest.mock import patch

import numpy as np

from tests.fuzz.mutations import mutate
from tests.support.command import SAMPLES, Outcome, read_summary, verify
from tests.support.posed import Watched, poses_csv, write_posed
from verify.io.session.session import open_session

TIMEOUT = 20  # s a command
MAX_LINE = 5000  # characters of an error
MAX_SHIFT = 3.0  # expanded uncertainties that a figure may move without a word
MIN_SHIFT_DEG = 0.02  # less is within what a user would notice


@dataclass(frozen=True)
class Target:
    """A command and the folder that it reads."""

    name: str
    folder: Path
    words: Callable[[Path], list[str | Path]]  # of the command, for a copy of the folder
    out: bool = True  # whether the command writes to -o OUT


@dataclass(frozen=True)
class Case:
    """What one broken file led to."""

    target: str
    file: str
    how: str
    outcome: Outcome | None
    broken: str  # which part of the promise; empty: none

    def __str__(self) -> str:
        """Say it in one line and what the command printed."""
        said = "" if self.outcome is None else f"\n    {self.outcome.err[-600:]}"
        return f"{self.broken}: {self.target}, {self.file}: {self.how}{said}"


class TooLongError(BaseException):
    """The command took longer than TIMEOUT; not an Exception, which a command may catch."""


def make_targets(folder: Path) -> list[Target]:
    """Make the folders that are broken: small, so that a case takes about a second."""
    sample = SAMPLES / "multi_joint_fault_6r"
    pictures = folder / "pictures"
    shutil.copytree(sample, pictures)
    poses = write_posed(folder / "poses", sample, poses_csv(*Watched(open_session(sample)).poses))
    report = folder / "report"
    with quick_reports():
        assert verify("run", poses, "-o", report, "--tolerance", "0.2").status in (0, 1, 3)
    robot = folder / "robot"
    robot.mkdir()
    shutil.copy(Path(__file__).parents[2] / "robots" / "rv_3sd_melfa.toml", robot / "arm.toml")
    tolerance = ("--tolerance", "0.2")
    return [
        Target("run", pictures, lambda f: ["run", f, *tolerance]),
        Target("run poses", poses, lambda f: ["run", f, *tolerance]),
        Target("identify", poses, lambda f: ["identify", f]),
        Target("report", report, lambda f: ["report", f], out=False),
        Target("robots", robot, lambda f: ["robots", f / "arm.toml"], out=False),
    ]


def run_case(targets: list[Target], seed: int, place: Path) -> Case:
    """Break a copy of one target's folder, run its command, and check the promise."""
    rng = np.random.default_rng([seed, 20])
    target = targets[rng.integers(len(targets))]
    copy, out = place / "in" / target.folder.name, place / "out"
    shutil.copytree(target.folder, copy)
    files = sorted(f for f in copy.rglob("*") if f.is_file() and f.name != "README.md")
    file = files[rng.integers(len(files))]
    how = mutate(file, rng)
    words = target.words(copy) + (["-o", out] if target.out else [])
    name = str(file.relative_to(copy))
    try:
        with time_limit(), quick_reports(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            outcome = verify(*words)
    except TooLongError:
        return Case(target.name, name, how, None, "too slow")
    except Exception as error:
        return Case(target.name, name, how, None, f"raised {type(error).__name__}: {error}")
    return Case(target.name, name, how, outcome, _broken_promise(target, outcome, out, copy))


def _broken_promise(target: Target, outcome: Outcome, out: Path, copy: Path) -> str:
    if outcome.status not in (0, 1, 2, 3):
        return f"status {outcome.status}"
    if outcome.status == 2:
        lines = [line for line in outcome.err.splitlines() if line.startswith("error: ")]
        if len(lines) != 1 or len(lines[0]) > MAX_LINE:
            return f"{len(lines)} lines of error"
        if not re.search(r"[.?!…)\"'`] [A-Z`].*[.?!]$", lines[0]):
            return "no remedy"
        if out.exists():
            return "something was written"
    if any(entry.name.startswith(".verify-partial-") for entry in copy.parent.rglob("*")):
        return "half a file is left"
    if target.name.startswith("run") and outcome.status in (0, 1, 3):
        return _wrong_figure(target, outcome, out)
    return ""


def _wrong_figure(target: Target, outcome: Outcome, out: Path) -> str:
    """Compare mean errors with those of the whole files."""
    summary, whole = read_summary(out), _whole_summary(target)
    if "warning: " in outcome.err or summary["verdict"] == "undecided":
        return ""
    for new, old in zip(summary["joints"], whole["joints"], strict=False):
        if new["mean_error_deg"] is None or old["mean_error_deg"] is None:
            continue
        shift = abs(new["mean_error_deg"] - old["mean_error_deg"])
        u = np.hypot(new["expanded_uncertainty_deg"] or 0, old["expanded_uncertainty_deg"] or 0)
        if shift > max(MAX_SHIFT * u, MIN_SHIFT_DEG):
            return f"joint {new['joint']} moved by {shift:.3g}° without a word"
    return ""


def _whole_summary(target: Target) -> dict[str, list[dict[str, float]]]:
    """Measure the whole folder once, and keep its summary beside it."""
    kept = target.folder.parent / f"{target.folder.name}-whole"
    if not kept.exists():
        with quick_reports():
            verify(*target.words(target.folder), "-o", kept)
    return dict(json.loads((kept / "summary.json").read_text()))


@contextmanager
def quick_reports() -> Iterator[None]:
    """Leave the PDF out, which takes longest and reads nothing."""
    with patch("reports.render_pdf", lambda *_: b"%PDF-1.7"):
        yield


@contextmanager
def time_limit() -> Iterator[None]:
    """Raise TooLongError after TIMEOUT."""

    def late(_signal: int, _frame: FrameType | None) -> None:
        raise TooLongError

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(TIMEOUT)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
