"""OUT/sessions: the results of each finished session, written whole or not at all."""

import hashlib
import json
import re
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reports.results import MANIFEST
from verify.errors import InputError
from verify.fleet.batch.records import BatchOptions, SessionResults
from verify.io.files import (
    FolderTakenError,
    output_refusal,
    read_bytes,
    refuse_obstacles,
    refused_as_input_error,
    write_folder_whole,
)
from verify.io.results import RESULTS

SESSIONS_FOLDER = "sessions"
ENTRY_FILE = "entry.json"
BATCH_FILES = (
    f"{SESSIONS_FOLDER}/{ENTRY_FILE}", f"{RESULTS}/{MANIFEST}", "fleet.html", "fleet.pdf",
    "sessions.parquet", "frames.parquet", "failures.csv",
)  # fmt: skip
FORMAT_VERSION = 1
_MAX_NAME_LETTERS = 40  # of a session's own name in its folder's


@dataclass(frozen=True, slots=True)
class StoredResults:
    """Results that an earlier batch left."""

    inputs: dict[str, str]  # digest of all that they rest on
    options: str


class ResultStore:
    """Finished sessions by name, in the batch's folder."""

    def __init__(self, out: Path) -> None:
        self.folder = out / SESSIONS_FOLDER

    def place(self, session: str) -> Path:
        """Where a session's results are kept: its name made harmless, and a hash of all of it."""
        own = re.sub(r"[^A-Za-z0-9_-]+", "-", session.rstrip("/").rpartition("/")[2])
        code = hashlib.sha256(session.encode()).hexdigest()[:12]
        return self.folder / f"{own.strip('-')[:_MAX_NAME_LETTERS] or 'session'}-{code}"

    def kept(self, session: str) -> StoredResults | None:
        """Find a session's results; None where there are none, or none that can be trusted."""
        folder = self.place(session)
        try:
            entry: Any = json.loads(read_bytes(folder / ENTRY_FILE))
            if entry["format"] != FORMAT_VERSION or entry["session"] != session:
                return None
            for name, was in entry["files"].items():
                if hashlib.sha256(read_bytes(folder / name)).hexdigest() != was:
                    return None
            return StoredResults(dict(entry["inputs"]), str(entry["options"]))
        except (InputError, ValueError, RecursionError, AttributeError, KeyError, TypeError):
            return None

    def keep(self, measured: SessionResults, options: BatchOptions) -> None:
        """Put a session's results in place of older ones; the same of another batch are left.

        Raises:
            FolderTakenError: another batch has written other results there meanwhile.
            InputError: the system refuses the place.
        """
        results = StoredResults(measured.inputs, options.described)
        if self.kept(measured.session) == results:
            return
        try:
            self._replace(measured, options)
        except FolderTakenError:
            if self.kept(measured.session) != results:
                raise

    def _replace(self, measured: SessionResults, options: BatchOptions) -> None:
        folder = self.place(measured.session)
        self._remove(folder)
        entry = {
            "format": FORMAT_VERSION,
            "session": measured.session,
            "options": options.described,
            "inputs": measured.inputs,
            "files": {n: hashlib.sha256(c).hexdigest() for n, c in measured.files.items()},
        }
        with write_folder_whole(folder) as partial:
            (partial / RESULTS).mkdir()
            for name, content in measured.files.items():
                (partial / name).write_bytes(content)
            text = json.dumps(entry, indent=1, sort_keys=True)
            (partial / ENTRY_FILE).write_text(text + "\n", encoding="utf-8")

    def _remove(self, folder: Path) -> None:
        """Take older results away, first what makes them count."""
        with refused_as_input_error(folder):
            (folder / ENTRY_FILE).unlink(missing_ok=True)
            with suppress(FileNotFoundError):  # another batch removes it as well
                shutil.rmtree(folder)


def require_writable(out: Path) -> None:
    """Raise InputError for a place where no batch can write, before hours of work go into it."""
    if out.exists() and not out.is_dir():
        raise InputError(out, "is a file", "a folder is expected", "Choose another -o.")
    refuse_obstacles(out, BATCH_FILES)
    try:
        (out / SESSIONS_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_refusal(out, error) from error
