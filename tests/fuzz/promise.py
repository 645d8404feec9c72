"""What every command promises of broken input.

A case copies a folder, breaks one file and runs a command on it in this process. The promise:

- exit status 0, 1, 2 or 3 (a batch: 4), and no traceback;
- with status 2 one line of error, with a place and what to do, and nothing written;
- nothing else is printed on the way, by a library neither;
- within 20 s of processor time and 1 GB;
- no wrong figure: what is accepted gives the same figures, or warns, or is undecided.
"""

import json
import os
import re
import resource
import shutil
import signal
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from tests.fuzz.mutations import mutate
from tests.fuzz.targets import Target, quick, whole_out
from tests.support.command import Outcome, verify

TIMEOUT = 20.0  # s of processor time a command
MAX_WAIT = 120  # s: a pipe that nobody writes to takes no processor time; the machine may be busy
MAX_MEMORY = 1e9  # bytes
MAX_LINE = 5000  # characters of an error
MAX_SHIFT = 3.0  # expanded uncertainties that a figure may move without a word
MIN_SHIFT = 0.02  # deg or mm: less is within what a user would notice
REMEDY = re.compile(r"[.?!…)\"'`] [A-Z`].*[.?!]$")
LINE = re.compile(r"(error|warning): |[\w' ]+: \d+ of \d+(,|$)")  # that a command may print


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


def run_case(targets: list[Target], seed: int, place: Path) -> Case:
    """Break a copy of one target's folder, run its command, and check the promise."""
    rng = np.random.default_rng([seed, 20])
    weights = np.array([target.weight for target in targets])
    target = targets[rng.choice(len(targets), p=weights / weights.sum())]
    copy, out = place / "in", place / "out"
    shutil.copytree(target.folder, copy)
    file = _draw_file(copy, rng)
    name = str(file.relative_to(copy))
    how = mutate(file, rng)
    before = _listing(place)
    try:
        with _time_limit(), quick(), _native_output() as native, warnings.catch_warnings():
            warnings.simplefilter("always", RuntimeWarning)
            warnings.simplefilter("always", UserWarning)
            memory = _peak_memory(reset=True)
            outcome = verify(*target.command(copy, out))
            memory = _peak_memory() - memory
            native.seek(0)
            beside = native.read()
    except TooLongError:
        return Case(target.name, name, how, None, "too slow")
    except Exception as error:
        return Case(target.name, name, how, None, f"raised {type(error).__name__}: {error}")
    broken = _unfit_output(target, outcome, place) or (
        f"printed beside: {beside[:300]!r}" if beside.strip() else ""
    )
    if memory > MAX_MEMORY:
        broken = f"took {memory / 1e9:.1f} GB"
    keeps = target.name.startswith(("batch", "watch", "record"))  # what was done or recorded so far
    if outcome.status == 2 and not keeps and _listing(place) != before:
        broken = broken or "something was written"
    if outcome.status in (0, 1, 3) and not broken:
        broken = _wrong_figure(target, outcome, out)
    return Case(target.name, name, how, outcome, broken)


def _draw_file(folder: Path, rng: np.random.Generator) -> Path:
    """Draw a kind of file, so that pictures are not the most, then one of them."""
    kinds: dict[str, list[Path]] = {}
    for file in sorted(f for f in folder.rglob("*") if f.is_file() and f.name != "README.md"):
        kinds.setdefault(re.sub(r"\d+", "", str(file.relative_to(folder))), []).append(file)
    files = kinds[list(kinds)[rng.integers(len(kinds))]]
    return files[rng.integers(len(files))]


def _listing(place: Path) -> set[str]:
    return {str(entry) for entry in place.rglob("*")}


def _unfit_output(target: Target, outcome: Outcome, place: Path) -> str:
    """Which part of the promise the status and the lines break."""
    if outcome.status not in (0, 1, 2, 3) + (4,) * target.name.startswith("batch"):
        return f"status {outcome.status}"
    lines = outcome.err.splitlines()
    if other := [line for line in lines if not LINE.match(line)]:
        return f"printed beside: {other[0][:300]}"
    refusals = [line for line in lines if re.match(r"(error|warning: failed): ", line)]
    if outcome.status == 2 and sum(line.startswith("error") for line in lines) != 1:
        return f"{len(refusals)} lines of error"
    for line in refusals:
        if len(line) > MAX_LINE:
            return "a line too long"
        if not REMEDY.search(line):
            return "no remedy"
        if str(place) not in line and not line.startswith("error: --"):
            return "no place"
    if any(".verify-partial-" in name for name in _listing(place)):
        return "half a file is left"
    return ""


def _wrong_figure(target: Target, outcome: Outcome, out: Path) -> str:
    """Compare figures with those of the whole files."""
    new, old = (_summary(folder) for folder in (out, whole_out(target)))
    known = set(old.get("warnings", []))
    if new.get("verdict") == "undecided" or set(new.get("warnings", [])) - known:
        return ""
    if [line for line in outcome.err.splitlines() if "in/" in line]:  # a warning names a file
        return ""
    before = dict(_figures(old))
    for name, (value, u) in _figures(new):
        shift = abs(value - before.get(name, (value, 0.0))[0])
        if shift > max(MAX_SHIFT * np.hypot(u, before.get(name, (0.0, 0.0))[1]), MIN_SHIFT):
            return f"{name} moved by {shift:.3g} without a word"
    return ""


def _summary(folder: Path) -> dict[str, Any]:
    file = folder / "summary.json"
    return dict(json.loads(file.read_text())) if file.exists() else {}


def _figures(summary: dict[str, Any]) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield figures with a name, each with its expanded uncertainty."""
    for joint in summary.get("joints", []):
        if joint.get("mean_error_deg") is not None:
            u = joint["expanded_uncertainty_deg"] or 0.0
            yield f"joint {joint['joint']}", (joint["mean_error_deg"], u)
    for entry in summary.get("parameters", []):
        if entry.get("change") is not None:
            yield entry["name"], (entry["change"], entry["expanded_uncertainty"])
    for part, key, unit in (
        ("base", "position_mm", "standard_uncertainty_mm"),
        ("base", "rotation_vector_deg", "standard_uncertainty_deg"),
        ("stereo", "position_mm", "position_standard_uncertainty_mm"),
        ("stereo", "rotation_vector_deg", "rotation_vector_standard_uncertainty_deg"),
    ):
        table = summary.get(part) or {}
        for axis, (value, u) in enumerate(
            zip(table.get(key, []), table.get(unit, []), strict=True)
        ):
            yield f"{part} {key}[{axis}]", (value, 2.0 * (u or 0.0))


def _peak_memory(*, reset: bool = False) -> float:
    """Peak of this process's memory, bytes; with `reset` counted anew from now on."""
    if reset:
        Path("/proc/self/clear_refs").write_text("5")
    status = Path("/proc/self/status").read_text()
    return 1024.0 * int(re.findall(r"VmHWM:\s+(\d+)", status)[0])


@contextmanager
def _native_output() -> Iterator[Any]:
    """Catch what libraries print past Python's streams; of errors none is shown (`__main__`)."""
    before = [os.dup(number) for number in (1, 2)]
    with tempfile.TemporaryFile() as file, Path(os.devnull).open("wb") as nowhere:
        try:
            for number, taker in ((1, file), (2, nowhere)):
                os.dup2(taker.fileno(), number)
            yield file
        finally:
            for number, kept in zip((1, 2), before, strict=True):
                os.dup2(kept, number)
                os.close(kept)


@contextmanager
def _time_limit() -> Iterator[None]:
    """Raise TooLongError after TIMEOUT; no more memory than 4 GB beyond what is taken now."""

    def late(_signal: int, _frame: FrameType | None) -> None:
        raise TooLongError

    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limit = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (taken + 4_000_000_000, limit[1]))
    before = [signal.signal(number, late) for number in (signal.SIGPROF, signal.SIGALRM)]
    signal.setitimer(signal.ITIMER_PROF, TIMEOUT, 1.0)  # again: an exception in a callback is lost
    signal.alarm(MAX_WAIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        for number, handler in zip((signal.SIGPROF, signal.SIGALRM), before, strict=True):
            signal.signal(number, handler)
        resource.setrlimit(resource.RLIMIT_AS, limit)
