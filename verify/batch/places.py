"""Sessions behind URLs: listed, told apart, and fetched to the worker that measures them."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from verify.batch.records import Found, named
from verify.errors import InputError

NEVER_READ = ("truth.csv",)  # by a measurement: it is not fetched either


def is_url(place: str) -> bool:
    """Tell `s3://bucket/folder` from a path."""
    return "://" in place


def listed(url: str) -> Iterator[Found]:
    """List the sessions under a URL; none inside another.

    Raises:
        InputError: nobody knows the protocol, or the storage refuses.
    """
    system, root = _system(url)
    try:
        files = system.find(root)
    except Exception as error:  # each storage has errors of its own
        raise _refused(url, error) from error
    folders = sorted(
        str(PurePosixPath(file).parent)
        for file in files
        if PurePosixPath(file).name == "session.toml"
    )
    last = None
    for folder in folders:
        if last is not None and PurePosixPath(folder).is_relative_to(last):
            continue
        last = folder
        place = str(system.unstrip_protocol(folder))
        yield Found(named(place), place)


@contextmanager
def at_hand(folder: str) -> Iterator[Path]:
    """Have a session's folder on this machine: itself, or a copy as long as it is needed.

    Raises:
        InputError: it cannot be fetched.
    """
    if not is_url(folder):
        yield Path(folder)
        return
    with tempfile.TemporaryDirectory(prefix="verify-session-") as place:
        copy = Path(place) / "session"
        copy.mkdir()
        try:
            system, root = _system(folder)
            for file in _files(system, root):
                target = copy / PurePosixPath(file).relative_to(root)
                target.parent.mkdir(parents=True, exist_ok=True)
                system.get_file(file, str(target))
        except InputError:
            raise
        except Exception as error:  # each storage has errors of its own
            raise _refused(folder, error) from error
        try:
            yield copy
        except InputError as problem:
            raise _as_if_at(folder, problem, str(copy)) from problem


def _as_if_at(folder: str, problem: InputError, copy: str) -> InputError:
    """Say what is wrong with a copy as of what it was copied from."""
    words = (problem.place, problem.found, problem.expected, problem.remedy)
    return InputError(*(text.replace(copy, folder) for text in words))


def states(folder: str) -> dict[str, str]:
    """Take from the storage itself what changes when a file does (its ETag, its time), by file.

    Raises:
        InputError: the storage refuses.
    """
    try:
        system, root = _system(folder)
        return {
            str(PurePosixPath(file).relative_to(root)): f"storage:{system.ukey(file)}"
            for file in _files(system, root)
        }
    except InputError:
        raise
    except Exception as error:  # each storage has errors of its own
        raise _refused(folder, error) from error


def _files(system: Any, root: str) -> list[str]:
    files = sorted(str(file) for file in system.find(root))
    inside = [
        f for f in files if PurePosixPath(f).is_relative_to(root) and ".." not in f.split("/")
    ]
    return [f for f in inside if PurePosixPath(f).name not in NEVER_READ]


def _system(url: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError as error:
        raise InputError(
            url, "needs the package fsspec", "", "Install verify-robot[cluster]."
        ) from error
    try:
        system, path = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise _refused(url, error) from error
    return system, path.rstrip("/")


def _refused(url: str, error: Exception) -> InputError:
    found = f"cannot be reached ({type(error).__name__}: {error})"
    return InputError(url, found, "", "Check the address, the rights, and the storage's package.")
