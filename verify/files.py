"""Files that a user gives us, read whole; what the system refuses is said in one line."""

import errno
import hashlib
import os
from pathlib import Path

from verify.errors import InputError

_REMEDIES = {
    errno.ENOENT: "Put the file there or name another.",
    errno.EACCES: "Grant access to it and run again.",
    errno.EPERM: "Grant access to it and run again.",
    errno.EROFS: "Choose a place that can be written to.",
    errno.ENOSPC: "Free some space or write somewhere else.",
    errno.EDQUOT: "Free some space or write somewhere else.",
    errno.ENAMETOOLONG: "Choose a shorter name.",
}


def system_refusal(path: str | Path, error: OSError) -> InputError:
    """Word what the operating system refused: which path, why, what to do."""
    reason = os.strerror(error.errno) if error.errno else str(error)
    remedy = _REMEDIES.get(error.errno or 0, "Check the disk and the path.")
    return InputError(path, reason[:1].lower() + reason[1:], "", remedy)


def output_refusal(path: str | Path, error: OSError) -> InputError:
    """Word what the system refused of something that we make: nobody can put it there for us."""
    refused = system_refusal(path, error)
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        what = f"cannot be made: {refused.found}"
        return InputError(path, what, "", "Choose another place, in a folder that takes files.")
    if error.errno in (errno.EACCES, errno.EPERM):
        remedy = "Grant access to the folder that it goes into, or choose another place."
        return InputError(path, refused.found, "", remedy)
    return refused


def require_file(path: Path) -> None:
    """Refuse what is not a plain file with something in it (a pipe would block for ever).

    Raises:
        InputError: the path leads nowhere, to a folder or a device, or to an empty file.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise system_refusal(path, error) from error
    if not path.is_file():
        kind = "a folder" if path.is_dir() else "not a plain file"
        raise InputError(path, f"is {kind}", "a file is expected", "Name the file itself.")
    if size == 0:
        raise InputError(path, "is empty", "", "Record or export it again.")


def read_bytes(path: Path) -> bytes:
    """Read a whole file.

    Raises:
        InputError: there is none, it is empty, or the system refuses it.
    """
    require_file(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise system_refusal(path, error) from error


def digest(path: Path) -> str:
    """SHA-256 of a file, as `sha256:…`.

    A folder's is that of the lines that `sha256sum *` prints inside it, names in byte order, so
    that `cd left; sha256sum * | sha256sum` (LC_ALL=C) makes it again.

    Raises:
        InputError: the system refuses a file.
    """
    try:
        if not path.is_dir():
            with path.open("rb") as file:
                return f"sha256:{hashlib.file_digest(file, 'sha256').hexdigest()}"
        files = sorted(
            (entry for entry in path.iterdir() if entry.is_file() and entry.name[0] != "."),
            key=lambda entry: entry.name.encode(errors="surrogateescape"),
        )
        lines = "".join(f"{digest(file).partition(':')[2]}  {file.name}\n" for file in files)
    except OSError as error:
        raise system_refusal(error.filename or path, error) from error
    return f"sha256:{hashlib.sha256(lines.encode(errors='surrogateescape')).hexdigest()}"
