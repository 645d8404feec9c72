"""What workers do: measure a session, see whether one has changed, write its own report."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import reports
from reports import Results
from reports.results import plain
from verify.analysis import analyse
from verify.batch.places import at_hand, is_url, states
from verify.batch.records import (
    DEFECT,
    REFUSED,
    UNREADABLE,
    Failure,
    Found,
    Measured,
    Options,
    named,
)
from verify.errors import InputError, one_line
from verify.files import digest, system_refusal
from verify.results_folder import RESULTS, read_results, write_results
from verify.session import open_session

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Measure:
    """Measure one session from end to end."""

    found: Found
    options: Options

    def perform(self) -> Measured | Failure:
        """Give its results as files, or why there are none."""
        return _guarded(self.found, self._measured)

    def _measured(self) -> Measured:
        with at_hand(self.found.folder) as folder:
            opened = open_session(folder)
            tolerance = self.options.asked.tolerance(opened.arm.dof)
            results = called(analyse(opened, tolerance=tolerance), str(folder), self.found.session)
            remote = is_url(self.found.folder)
            return measured(
                self.found.session, results, states(self.found.folder) if remote else None
            )


@dataclass(frozen=True, slots=True)
class Compare:
    """See whether what a session's results rest on is still the same."""

    found: Found
    inputs: dict[str, str]  # digest by name, as kept

    def perform(self) -> list[str]:
        """Name what has changed or is gone; nothing where all is as it was."""
        try:
            if is_url(self.found.folder):
                now = states(self.found.folder)
                names = sorted({*now, *self.inputs})
                return [name for name in names if now.get(name) != self.inputs.get(name)]
            folder = Path(self.found.folder)
            return [name for name, was in self.inputs.items() if digest(folder / name) != was]
        except InputError as problem:
            return [problem.place]


@dataclass(frozen=True, slots=True)
class Report:
    """Write a kept session's own report beside its results."""

    folder: str

    def perform(self) -> None:
        """Write all that `verify run` writes."""
        folder = Path(self.folder)
        write_results(read_results(folder), folder, force=True)


def measured(session: str, results: Results, inputs: dict[str, str] | None) -> Measured:
    """Turn results into the files of a results folder."""
    packed = reports.packed(results, Path(RESULTS))
    files = {f"{RESULTS}/{name}": content for name, content in packed.items()}
    digests = results.summary["inputs"] if inputs is None else inputs
    return Measured(session, files, dict(digests), int(results.summary["pairs"]["recorded"]))


def called(results: Results, folder: str, session: str) -> Results:
    """Call a session by its name in the tables, wherever a worker found it."""
    summary: dict[str, Any] = plain(results.summary)
    summary["session"]["path"] = session
    was, now = one_line(folder), one_line(session)
    summary["warnings"] = [named(text.replace(was, now)) for text in summary["warnings"]]
    return replace(results, summary=summary)


def _guarded(found: Found, work: Callable[[], T]) -> T | Failure:
    """Do the work on one session; whatever is wrong with it must not stop the others."""
    try:
        return work()
    except InputError as problem:
        return Failure(found.session, REFUSED, _said(str(problem), found))
    except OSError as problem:
        refused = system_refusal(problem.filename or found.folder, problem)
        return Failure(found.session, UNREADABLE, _said(str(refused), found))
    except Exception as problem:  # a defect of ours: it is told, and the batch goes on
        why = f"{found.session}: {type(problem).__name__}: {problem}. Please report this defect."
        return Failure(found.session, DEFECT, named(one_line(why)))


def _said(text: str, found: Found) -> str:
    return named(text.replace(one_line(found.folder), one_line(found.session)))
