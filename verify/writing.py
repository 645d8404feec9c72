"""Files and folders that appear whole or not at all, whatever stops the program midway."""

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from verify.errors import InputError
from verify.files import output_refusal

_PARTIAL = ".verify-partial-"  # begins the name of what is being built
_FULL = (errno.ENOSPC, errno.EDQUOT)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that its name never shows half of it, not even after a power cut.

    Built under another name in the same folder, flushed to the disk, then renamed. A file that
    was there is replaced.

    Raises:
        InputError: no space, no permission, no such folder; what was there is untouched.
    """
    partial = path.with_name(f"{_PARTIAL}{secrets.token_hex(8)}")
    try:
        handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(handle, rest) :]
            os.fsync(handle)
        finally:
            os.close(handle)
        partial.replace(path)
        _flush(path.parent)
    except OSError as error:
        raise output_refusal(path, error) from error
    finally:
        with suppress(OSError):  # gone since the rename, or the folder itself refuses
            partial.unlink()


@contextmanager
def folder_written_whole(out: str | Path, force: bool = False) -> Iterator[Path]:
    """Build a folder aside and put it in place at the end; a run that fails leaves nothing.

    Args:
        out: where the result goes; its parents are made when it does.
        force: with a folder that is not empty, replace the files that are made, leave the others.

    Yields:
        An empty folder to build in. A new `out` appears by one rename; in a folder that exists,
        each file appears whole.

    Raises:
        InputError: `out` is a file or a folder that is not empty (without `force`); no space, or
            no permission.
    """
    out = Path(out)
    target = out.resolve()
    exists = _check_vacant(out, target, force)
    # on the disk of what it becomes, so that a rename suffices: `out` may be a mount of its own
    beside = target if exists else next(p for p in target.parents if p.exists())
    partial = beside / f"{_PARTIAL}{secrets.token_hex(8)}"
    try:
        partial.mkdir()
    except OSError as error:
        raise output_refusal(out, error) from error
    try:
        yield partial
        _put_in_place(out, partial, target, exists)
    except OSError as error:
        if error.errno in _FULL:  # whatever wrote in there; other refusals are the writer's to word
            raise output_refusal(out, error) from error
        raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _check_vacant(out: Path, target: Path, force: bool) -> bool:
    """Tell whether the folder exists; refuse it if it holds something and force is not given."""
    try:
        holds = [entry for entry in target.iterdir() if not entry.name.startswith(_PARTIAL)]
    except FileNotFoundError:
        return False
    except NotADirectoryError as error:
        found = "is a file" if target.exists() else "lies below a file"
        raise InputError(out, found, "a folder is expected", "Choose another -o.") from error
    except OSError as error:
        raise output_refusal(out, error) from error
    if holds and not force:
        remedy = "Choose another -o or give --force."
        raise InputError(out, "is not empty", "nothing is overwritten unasked", remedy)
    return True


def _put_in_place(out: Path, partial: Path, target: Path, exists: bool) -> None:
    try:
        files = [file for file in sorted(partial.rglob("*")) if not file.is_dir()]
        for file in files:
            _flush(file)
        if not exists:
            target.parent.mkdir(parents=True, exist_ok=True)
            partial.rename(target)
        else:
            for file in files:
                place = target / file.relative_to(partial)
                place.parent.mkdir(parents=True, exist_ok=True)
                file.replace(place)
        _flush(target)
    except OSError as error:
        raise output_refusal(error.filename2 or out, error) from error


def _flush(path: Path) -> None:
    """Have the disk hold a file's bytes, or a folder's names, before going on."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
