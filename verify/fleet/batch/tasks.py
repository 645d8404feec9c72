"""Tasks of workers: measure a session, check whether it has changed, write its report."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import reports
from reports import Results
from reports.results import to_json_value
from verify.analysis.session import analyse
from verify.errors import InputError, one_line
from verify.fleet.batch.finding import file_versions, is_url, local_copy
from verify.fleet.batch.records import (
    DEFECT,
    REFUSED,
    UNREADABLE,
    BatchOptions,
    SessionFailure,
    SessionLocation,
    SessionResults,
    ToleranceRequest,
    printable_path,
)
from verify.io.files import digest, lacks_memory, memory_refusal, system_refusal
from verify.io.results import RESULTS, read_results, write_report_folder
from verify.io.session.folder import SESSION_FILE, load_arm
from verify.io.session.keys import RunTable
from verify.io.session.session import open_session
from verify.io.toml import decode


@dataclass(frozen=True, slots=True)
class MeasureTask:
    """Measure one session from end to end."""

    found: SessionLocation
    options: BatchOptions

    def perform(self) -> SessionResults | SessionFailure:
        """Give its results as files, or why there are none: that must not stop the others."""
        session, folder = self.found.session, self.found.folder
        try:
            return self._measured()
        except InputError as problem:
            kind, refused = REFUSED, problem
        except OSError as problem:
            kind, refused = UNREADABLE, system_refusal(problem.filename or folder, problem)
        except Exception as problem:  # a defect of ours is reported, and the batch goes on
            if not lacks_memory(problem):
                why = one_line(f"{session}: {type(problem).__name__}: {problem}. ")
                defect = printable_path(f"{why}Please report this defect.")
                return SessionFailure(session, DEFECT, defect)
            kind, refused = UNREADABLE, memory_refusal(folder)
        why = str(refused).replace(one_line(folder), one_line(session))
        return SessionFailure(session, kind, printable_path(why))

    def _measured(self) -> SessionResults:
        with local_copy(self.found.folder) as folder:
            opened = open_session(folder)
            tolerance = self.options.tolerances.tolerance(opened.arm.dof)
            results = rename_session(
                analyse(opened, tolerance=tolerance), str(folder), self.found.session
            )
            remote = is_url(self.found.folder)
            return pack_results(
                self.found.session, results, file_versions(self.found.folder) if remote else None
            )


def require_joints(found: Sequence[SessionLocation], tolerances: ToleranceRequest) -> None:
    """Refuse, by an InputError, tolerances for a number of joints that no session's robot has."""
    refusals = []
    for one in found:
        if is_url(one.folder):  # it is not fetched twice
            return
        path = Path(one.folder) / SESSION_FILE
        with suppress(InputError):  # measuring it says what is wrong
            joints = load_arm(path, decode(path, RunTable)[0]).dof
            try:
                tolerances.tolerance(joints)
            except InputError as refusal:
                refusals.append(refusal)
            else:
                return
    if refusals:
        raise refusals[0]


@dataclass(frozen=True, slots=True)
class CompareTask:
    """See whether what a session's results rest on is still the same."""

    found: SessionLocation
    inputs: dict[str, str]  # digest by name, as kept

    def perform(self) -> list[str]:
        """Name what has changed or is gone; nothing where all is as it was."""
        try:
            if is_url(self.found.folder):
                now = file_versions(self.found.folder)
                names = sorted({*now, *self.inputs})
                return [name for name in names if now.get(name) != self.inputs.get(name)]
            folder = Path(self.found.folder)
            return [name for name, was in self.inputs.items() if digest(folder / name) != was]
        except InputError as problem:
            return [problem.place]


@dataclass(frozen=True, slots=True)
class ReportTask:
    """Write a kept session's own report beside its results."""

    folder: str

    def perform(self) -> None:
        """Write all that `verify run` writes."""
        folder = Path(self.folder)
        write_report_folder(read_results(folder), folder, force=True, frames=True)


def pack_results(session: str, results: Results, inputs: dict[str, str] | None) -> SessionResults:
    """Turn results into the files of a results folder."""
    packed = reports.packed(results, Path(RESULTS))
    files = {f"{RESULTS}/{name}": content for name, content in packed.items()}
    digests = results.summary["inputs"] if inputs is None else inputs
    return SessionResults(session, files, dict(digests), int(results.summary["pairs"]["recorded"]))


def rename_session(results: Results, folder: str, session: str) -> Results:
    """Call a session by its name in the tables, wherever a worker found it."""
    summary: dict[str, Any] = to_json_value(results.summary)
    summary["session"]["path"] = session
    was, now = one_line(folder), one_line(session)
    summary["warnings"] = [printable_path(text.replace(was, now)) for text in summary["warnings"]]
    return replace(results, summary=summary)
