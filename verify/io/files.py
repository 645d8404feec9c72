"""Read files whole, write files and folders whole or not at all, and word what the system refuses.

A reader never sees half a file: what is written is built under another name on the same disk,
flushed, and renamed.
"""

import codecs
import errno
import hashlib
import os
import re
import secrets
import shutil
import socket
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from verify.errors import InputError

_REMEDIES = {
    errno.ENOENT: "Put the file there or name another.",
    errno.EACCES: "Grant access to it and run again.",
    errno.EPERM: "Grant access to it and run again.",
    errno.EROFS: "Choose a place that can be written to.",
    errno.ENOSPC: "Free some space or write somewhere else.",
    errno.EDQUOT: "Free some space or write somewhere else.",
    errno.ENAMETOOLONG: "Choose a shorter name.",
    errno.ELOOP: "Put the file or folder itself there instead of the link.",
    errno.ENOMEM: "Close other programs, or use a machine with more memory.",
}
_NO_MEMORY = re.compile(  # in libraries' own words
    "cannot allocate memory|insufficient memory|bad_alloc|failed to map segment|"
    "start new thread|launch worker thread",
    re.IGNORECASE,
)
SPARE_BYTES = 200_000_000  # what decoding a video takes
MAX_TABLE_BYTES = 2_000_000_000  # of a CSV file, a picture, a ring of pairs: more is no such file


def system_refusal(path: str | Path, error: OSError) -> InputError:
    """Word what the operating system refused: which path, why, what to do."""
    reason = os.strerror(error.errno) if error.errno else str(error)
    remedy = _REMEDIES.get(error.errno or 0, "Check the disk and the path.")
    return InputError(path, reason[:1].lower() + reason[1:], "", remedy)


def memory_refusal(path: str | Path) -> InputError:
    """Word that there is too little memory for what was to be done."""
    return system_refusal(path, OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)))


def lacks_memory(error: BaseException | None) -> bool:
    """Whether an error, or one that it came from, is for want of memory."""
    while error is not None:
        of_system = isinstance(error, OSError) and error.errno == errno.ENOMEM
        if of_system or isinstance(error, MemoryError) or _NO_MEMORY.search(str(error)):
            return True
        error = error.__cause__ or error.__context__
    return False


def require_memory(path: Path) -> None:
    """Refuse, by an InputError, where a library that fails without a reason lacks memory."""
    try:
        bytearray(SPARE_BYTES)
    except MemoryError as error:
        raise memory_refusal(path) from error


@contextmanager
def refused_as_input_error(path: str | Path) -> Iterator[None]:
    """Turn what the operating system refuses inside into an `InputError` about the path."""
    try:
        yield
    except OSError as error:
        raise system_refusal(path, error) from error
    except RuntimeError as error:  # `Path.resolve` on a link that leads to itself
        raise system_refusal(path, OSError(errno.ELOOP, os.strerror(errno.ELOOP))) from error
    except ValueError as error:  # a zero byte in the name
        raise system_refusal(path, OSError(str(error))) from error


@contextmanager
def restated(kind: type[Exception], before: str = "", place: str | None = None) -> Iterator[None]:
    """Turn errors in an InputError's four parts into one, with `before` before their place.

    Or at another `place`; theirs is then part of what was found.
    """
    try:
        yield
    except kind as error:
        parts: Any = error
        own = f"{before}{parts.place}"
        found = parts.found if place is None else f"{own} {parts.found}"
        raise InputError(place or own, found, parts.expected, parts.remedy) from error


def output_refusal(path: str | Path, error: OSError) -> InputError:
    """Word what the operating system refused of an output: the user cannot put it there."""
    refused = system_refusal(path, error)
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        what = f"cannot be made: {refused.found}"
        return InputError(path, what, "", "Choose another place, in a folder that takes files.")
    if error.errno in (errno.EACCES, errno.EPERM):
        remedy = "Grant access to the folder that it goes into, or choose another place."
        return InputError(path, refused.found, "", remedy)
    return refused


def require_file(path: Path, max_bytes: int | None = None) -> None:
    """Refuse what is not a plain file with something in it (a pipe would block for ever).

    Raises:
        InputError: nothing, a folder or a device, an empty file, or one larger than its kind is.
    """
    with refused_as_input_error(path):
        size = path.stat().st_size
    if not path.is_file():
        kind = "a folder" if path.is_dir() else "not a plain file"
        raise InputError(path, f"is {kind}", "a file is expected", "Name the file itself.")
    if size == 0:
        raise InputError(path, "is empty", "", "Record or export it again.")
    if max_bytes is not None:
        _require_size(path, size, max_bytes)


def _require_size(path: Path, size: int, max_bytes: int) -> None:
    if size > max_bytes:
        found, expected = f"has {size} bytes", f"a file of its kind has at most {max_bytes}"
        raise InputError(path, found, expected, "Put the right file there.")


@contextmanager
def named_for_library(path: Path) -> Iterator[str]:
    """Yield a name of a file for a C library, which takes UTF-8 alone and gives no reasons.

    Raises:
        InputError: the system refuses to open the file.
    """
    with refused_as_input_error(path):
        file = path.open("rb")
    with file:
        # the full path, which no protocol of ffmpeg's (http:, concat:) can be mistaken for
        name = str(path.resolve())
        yield name if is_unicode(name) else f"/dev/fd/{file.fileno()}"


def is_unicode(name: str) -> bool:
    """Whether a file's name is UTF-8; bytes that are not stand in it as surrogates."""
    return not any("\ud800" <= character <= "\udfff" for character in name)


def real_path(path: Path) -> Path:
    """Follow links; raises InputError: one leads to itself."""
    with refused_as_input_error(path):
        return path.resolve()


def require_folder(folder: Path, expected: str, remedy: str) -> None:
    """Refuse, by an InputError, what is not a folder or what the system refuses."""
    with refused_as_input_error(folder):
        if folder.is_dir():
            return
        found = "is a file" if folder.exists() else "does not exist"
        folder.resolve()  # refuses a link that leads to itself
    raise InputError(folder, found, expected, remedy)


def require_apart(out: Path, source: Path, written: Collection[str] = ()) -> None:
    """Refuse, by an InputError, a result that would replace its source, or stand inside it.

    `written` are names of the files that are made where `out` is a folder.
    """
    target, there = real_path(out), real_path(source)
    replaced = there.parent == target and there.name in written
    if replaced or there in (target, *target.parents):
        found = f"would change {source}, which is read"
        expected = "a result stands apart from its source"
        raise InputError(out, found, expected, "Choose another place.")


def read_bytes(path: Path, max_bytes: int = MAX_TABLE_BYTES) -> bytes:
    """Read a whole file; raises InputError: none, empty, too large, or the system refuses it."""
    require_file(path, max_bytes)
    with refused_as_input_error(path):
        return path.read_bytes()


def refuse_utf_16(path: Path, data: bytes) -> None:
    """Refuse text that begins with the mark of UTF-16, by an InputError."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(path, "is UTF-16", "UTF-8 is expected", "Save it again as UTF-8.")


def digest(path: Path) -> str:
    """SHA-256 of a file, as `sha256:…`; InputError: the system refuses it, too large a picture.

    A folder's is that of the lines that `sha256sum *` prints inside it, names in byte order, so
    that `cd left; sha256sum * | sha256sum` (LC_ALL=C) makes it again.
    """
    try:
        if not path.is_dir():
            with path.open("rb") as file:
                return f"sha256:{hashlib.file_digest(file, 'sha256').hexdigest()}"
        files = sorted(
            (entry for entry in path.iterdir() if entry.is_file() and entry.name[0] != "."),
            key=lambda entry: entry.name.encode(errors="surrogateescape"),
        )
        for entry in files:
            _require_size(entry, entry.stat().st_size, MAX_TABLE_BYTES)
        lines = "".join(f"{digest(file).partition(':')[2]}  {file.name}\n" for file in files)
    except OSError as error:
        raise system_refusal(error.filename or path, error) from error
    return f"sha256:{hashlib.sha256(lines.encode(errors='surrogateescape')).hexdigest()}"


class FolderTakenError(InputError):
    """A folder holds something already, or another run has written to it meanwhile."""


PARTIAL_PREFIX = ".verify-partial-"  # first part of the name while a file or folder is built
_HOST = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]
_FULL = (errno.ENOSPC, errno.EDQUOT)


def _partial_path(folder: Path) -> Path:
    """Name what is built in a folder, and delete there what a killed process has left."""
    with suppress(OSError):
        for left in folder.glob(f"{PARTIAL_PREFIX}{_HOST}-*"):
            pid = left.name.removeprefix(f"{PARTIAL_PREFIX}{_HOST}-").partition("-")[0]
            if pid.isdecimal() and not _is_running(int(pid)):
                shutil.rmtree(left) if left.is_dir() else left.unlink()
    return folder / f"{PARTIAL_PREFIX}{_HOST}-{os.getpid()}-{secrets.token_hex(8)}"


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError as error:  # else another user's
        return not isinstance(error, ProcessLookupError)
    return True


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that its name never shows half of it, not even after a power cut.

    Built under another name in the same folder, flushed to the disk, then renamed. A file that
    was there is replaced.

    Raises:
        InputError: no space, no permission, no such folder; what was there is untouched.
    """
    with write_file_whole(path) as partial:
        handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(handle, rest) :]
        finally:
            os.close(handle)


@contextmanager
def write_file_whole(path: Path) -> Iterator[Path]:
    """Build a file aside, by a program that needs its name, and put it in place at the end.

    Raises:
        InputError: no space, no permission, no such folder; what was there is untouched.
    """
    partial = _partial_path(path.parent)
    try:
        yield partial
        _fsync(partial)
        partial.replace(path)
        _fsync(path.parent)
    except OSError as error:
        raise output_refusal(path, error) from error
    finally:
        with suppress(OSError):  # gone since the rename, or the folder itself refuses
            partial.unlink()


@contextmanager
def write_folder_whole(out: Path, force: bool = False) -> Iterator[Path]:
    """Build a folder aside and put it in place at the end; a run that fails leaves nothing.

    Yields an empty folder to build in. A new `out` appears, with its parents, by one rename; in a
    folder that exists, each file appears whole. With `force` that may hold something: files that
    are made are replaced, the others left.

    Raises:
        InputError: `out` is a file or a folder that is not empty (without `force`); no space, or
            no permission.
    """
    partial, target, exists = make_partial(out, force=force)
    try:
        yield partial
        if exists and not force and _entries(target):
            raise _written_meanwhile(out)
        _put_in_place(out, partial, target, exists)
    except OSError as error:
        if error.errno in _FULL:  # other refusals are worded by the code that wrote
            raise output_refusal(out, error) from error
        raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def make_partial(out: Path, *, force: bool) -> tuple[Path, Path, bool]:
    """Make the folder to build `out` in; with it where `out` really is, and whether it exists.

    Raises:
        InputError: as `write_folder_whole`.
    """
    target = real_path(out)
    exists = _check_vacant(out, target, force)
    # on the disk of what it becomes, so that a rename suffices: `out` may be a mount of its own
    beside = target if exists else next(p for p in target.parents if p.exists())
    partial = _partial_path(beside)
    try:
        partial.mkdir()
    except OSError as error:
        raise output_refusal(out, error) from error
    return partial, target, exists


def require_vacant(out: Path, *, force: bool) -> None:
    """Refuse, by an InputError as `write_folder_whole`'s, a folder that could not be written."""
    make_partial(out, force=force)[0].rmdir()


def _check_vacant(out: Path, target: Path, force: bool) -> bool:
    """Whether the folder exists; one that holds something is refused without `force`."""
    try:
        holds = _entries(target)
    except FileNotFoundError:
        return False
    except NotADirectoryError as error:
        found = "is a file" if target.exists() else "lies below a file"
        raise InputError(out, found, "a folder is expected", "Choose another -o.") from error
    except OSError as error:
        raise output_refusal(out, error) from error
    if holds and not force:
        remedy = "Choose another -o or give --force."
        found, expected = "exists and is not empty", "existing files are not overwritten"
        raise FolderTakenError(out, found, expected, remedy)
    return True


def _entries(folder: Path) -> list[Path]:
    """List a folder, but for what is being built in it."""
    return [entry for entry in folder.iterdir() if not entry.name.startswith(PARTIAL_PREFIX)]


def _written_meanwhile(out: Path) -> FolderTakenError:
    found, expected = "another run has written there meanwhile", "its files are not overwritten"
    return FolderTakenError(out, found, expected, "Choose another -o.")


def _put_in_place(out: Path, partial: Path, target: Path, exists: bool) -> None:
    try:
        files = [file for file in sorted(partial.rglob("*")) if not file.is_dir()]
        for file in files:
            _fsync(file)
        if not exists:
            target.parent.mkdir(parents=True, exist_ok=True)
            partial.rename(target)
        else:
            refuse_obstacles(target, [file.relative_to(partial) for file in files])
            for file in files:
                place = target / file.relative_to(partial)
                place.parent.mkdir(parents=True, exist_ok=True)
                file.replace(place)
        _fsync(target)
    except OSError as error:
        if not exists and error.errno in (errno.ENOTEMPTY, errno.EEXIST):
            raise _written_meanwhile(out) from error
        raise output_refusal(error.filename2 or out, error) from error


def refuse_obstacles(folder: Path, made: Iterable[str | Path]) -> None:
    """Refuse, by an InputError, what stands where files are to be `made` in a folder.

    A folder of the name of a file, or a file of the name of a folder.
    """
    remedy = "Move it away or choose another -o."
    for name in map(Path, made):
        with refused_as_input_error(folder / name):
            if (folder / name).is_dir():
                raise InputError(folder / name, "is a folder", "a file goes there", remedy)
            for above in (folder / parent for parent in name.parents):
                if os.path.lexists(above) and not above.is_dir():
                    raise InputError(above, "is a file", "a folder goes there", remedy)


def _fsync(path: Path) -> None:
    """Flush a file's bytes, or a folder's names, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def written_together(*paths: Path) -> Iterator[None]:
    """Restore files if the block inside fails; each may exist before.

    For small files beside a report folder: they are written first, the folder last.
    """
    before = {path: path.read_bytes() if path.is_file() else None for path in paths}
    try:
        yield
    except BaseException:  # an interrupt leaves as little behind as a full disk
        for path, content in before.items():
            with suppress(OSError, InputError):
                if content is None:
                    path.unlink(missing_ok=True)
                elif path.read_bytes() != content:
                    write_whole(path, content)
        raise
