"""Records of a batch: sessions, tasks for workers, their outcomes."""

from dataclasses import dataclass, field
from typing import Any, Protocol

from verify.io.session.keys import Tolerance

UNREADABLE = "unreadable"  # the system refuses a folder or a file
REFUSED = "refused"  # the session cannot be measured: what `verify run` says of it
KILLED = "killed"  # its worker died each time
COPY = "copy"  # of another session of the batch: it is measured, and not counted again
DEFECT = "defect"  # an error of ours, not of the session
MAX_ATTEMPTS = 3  # of a task whose worker dies


@dataclass(frozen=True, slots=True, order=True)
class SessionLocation:
    """A session that is there."""

    session: str  # its name in every table: the folder as it was typed and the way down from it
    folder: str  # where a worker finds it: an absolute path, or a URL


@dataclass(frozen=True, slots=True, order=True)
class SessionFailure:
    """A session, or a folder that may hold some, of which nothing could be measured."""

    session: str
    kind: str
    why: str  # one line


class ToleranceRequest(Protocol):
    """Tolerances as they were asked for, for an arm with any number of joints."""

    def tolerance(self, joints: int) -> Tolerance:
        """Give them in rad and m; raise InputError where they do not fit the arm."""


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """What the figures depend on beside the inputs."""

    tolerances: ToleranceRequest
    version: str  # of the program

    @property
    def described(self) -> str:
        """The same text for the same options, to be compared with what was kept."""
        return f"{self.tolerances!r} {self.version}"


@dataclass(frozen=True, slots=True)
class SessionResults:
    """A session's results as the files of a results folder, by their names."""

    session: str
    files: dict[str, bytes] = field(repr=False)
    inputs: dict[str, str]  # digest of all that was read
    pairs: int


@dataclass(frozen=True, slots=True)
class WorkerDied:
    """The outcome of a task whose worker died each of MAX_ATTEMPTS times."""


class Task(Protocol):
    """Work for one worker; it travels there as a pickle and must not raise."""

    def perform(self) -> Any:
        """Do it."""


def perform(task: Task) -> Any:
    """Do a task, on a worker."""
    return task.perform()


def printable_path(text: str) -> str:
    """Write a path so that every table can hold it: bytes that are no UTF-8 by their escapes."""
    return text.encode(errors="backslashreplace").decode()
