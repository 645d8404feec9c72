"""Find every session under folders or URLs that fsspec knows, and fetch remote ones to a worker."""

import errno
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any

from verify.errors import InputError, one_line
from verify.fleet.batch.records import UNREADABLE, SessionFailure, SessionLocation, printable_path
from verify.io.files import PARTIAL_PREFIX, require_folder, system_refusal
from verify.io.session.folder import SESSION_FILE

EXCLUDED_FILES = ("truth.csv",)  # by a measurement: it is not fetched either


def is_url(place: str) -> bool:
    """Tell `s3://bucket/folder` from a path."""
    return "://" in place


def list_sessions(url: str) -> Iterator[SessionLocation]:
    """List the sessions under a URL, none inside another; InputError: not known, or refused."""
    system, root = _filesystem(url)
    with _storage_errors(url):
        files = system.find(root)
    paths = map(PurePosixPath, files)
    folders = sorted(str(path.parent) for path in paths if path.name == SESSION_FILE)
    last = None
    for folder in folders:
        if last is not None and PurePosixPath(folder).is_relative_to(last):
            continue
        last = folder
        place = str(system.unstrip_protocol(folder))
        yield SessionLocation(printable_path(place), place)


@contextmanager
def local_copy(folder: str) -> Iterator[Path]:
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
        system, root = _filesystem(folder)
        with _storage_errors(folder):
            for file in _files(system, root):
                target = copy / PurePosixPath(file).relative_to(root)
                target.parent.mkdir(parents=True, exist_ok=True)
                system.get_file(file, str(target))
        try:
            yield copy
        except InputError as problem:
            words = (problem.place, problem.found, problem.expected, problem.remedy)
            raise InputError(*(text.replace(str(copy), folder) for text in words)) from problem


def file_versions(folder: str) -> dict[str, str]:
    """Take from the storage itself what changes when a file does (its ETag, its time), by file.

    Raises:
        InputError: the storage refuses.
    """
    system, root = _filesystem(folder)
    with _storage_errors(folder):
        return {
            str(PurePosixPath(file).relative_to(root)): f"storage:{system.ukey(file)}"
            for file in _files(system, root)
        }


def _files(system: Any, root: str) -> list[str]:
    files = sorted(str(file) for file in system.find(root))
    inside = [
        f for f in files if PurePosixPath(f).is_relative_to(root) and ".." not in f.split("/")
    ]
    return [f for f in inside if PurePosixPath(f).name not in EXCLUDED_FILES]


def cluster_package(name: str, place: str) -> ModuleType:
    """Import a package of verify-robot[cluster]; InputError about the place: it is not there."""
    try:
        return import_module(name)
    except ImportError as error:
        remedy = "Install verify-robot[cluster]."
        raise InputError(place, f"needs the package {name}", "", remedy) from error


def _filesystem(url: str) -> tuple[Any, str]:
    fsspec = cluster_package("fsspec", url)
    with _storage_errors(url):
        system, path = fsspec.core.url_to_fs(url)
    return system, path.rstrip("/")


@contextmanager
def _storage_errors(url: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # each storage has errors of its own
        found = f"cannot be reached ({type(error).__name__}: {error})"
        remedy = "Check the address, the rights, and the storage's package."
        raise InputError(url, found, "", remedy) from error


FolderIdentity = tuple[int, int]  # device and inode: the same folder by whatever name


def find_sessions(
    roots: Sequence[str], out: Path
) -> tuple[list[SessionLocation], list[SessionFailure]]:
    """Find every session below folders or URLs, and what could not be looked into, by name.

    A folder that holds session.toml is one; nothing is looked for inside it, nor in `out`. Symlinks
    are followed, each folder is taken once, by the first name that leads to it.

    Raises:
        InputError: a root does not exist, is no folder or is `out`; no session is there.
    """
    found: list[SessionLocation] = []
    failures: list[SessionFailure] = []
    results: set[FolderIdentity] = set()
    with suppress(OSError):  # not there yet
        results.add(_identity(str(out)))
    visited = set(results)
    for root in roots:
        if not is_url(root) and _identity(_root(root)) in results:
            found_text = "is the folder of the results as well"
            expected = "results go beside the sessions, or into a folder below theirs"
            raise InputError(root, found_text, expected, "Give another folder with -o.")
        for one in list_sessions(root) if is_url(root) else _walk(_root(root), visited):
            if isinstance(one, SessionLocation):
                found.append(one)
            else:
                failures.append(one)
    if not found and not failures:
        raise InputError(
            ", ".join(roots),
            "holds no session",
            f"a folder with {SESSION_FILE} is one",
            "Name the folder above your sessions.",
        )
    return sorted(set(found)), sorted(set(failures))


def _root(text: str) -> str:
    require_folder(Path(text), "a folder is expected", "Name the folder above.")
    return str(Path(text))


def _identity(folder: str) -> FolderIdentity:
    status = os.stat(folder)  # noqa: PTH116  # ten thousand of them: no Path objects
    return status.st_dev, status.st_ino


def _walk(root: str, visited: set[FolderIdentity]) -> Iterator[SessionLocation | SessionFailure]:
    """Go down from a root; skip the folders in `visited`."""
    # a symlink to a folder above the root leads in a circle as well
    over = frozenset(_identity(str(folder)) for folder in Path(root).resolve().parents)
    waiting: list[tuple[str, frozenset[FolderIdentity]]] = [(root, over)]
    while waiting:
        folder, above = waiting.pop()
        try:
            identity = _identity(folder)
            if identity in above:
                raise OSError(errno.ELOOP, "")
            if identity in visited:
                continue
            visited.add(identity)
            inside, is_session = _subfolders(folder)
        except OSError as error:
            yield _unreadable_folder(folder, error)
            continue
        if is_session:
            yield SessionLocation(printable_path(folder), str(Path(folder).absolute()))
            continue
        chain = above | {identity}
        for path, problem in inside:
            if problem is None:
                waiting.append((path, chain))
            else:
                yield _unreadable_folder(path, problem)


def _subfolders(folder: str) -> tuple[list[tuple[str, OSError | None]], bool]:
    """List the folders in a folder, last name first, and whether it is a session."""
    inside: list[tuple[str, OSError | None]] = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name == SESSION_FILE:
                return [], True
            if entry.name.startswith(PARTIAL_PREFIX):
                continue
            try:
                if entry.is_dir():
                    inside.append((entry.path, None))
            except OSError as error:  # a symlink to itself
                inside.append((entry.path, error))
    return sorted(inside, key=lambda one: one[0], reverse=True), False


def _unreadable_folder(folder: str, error: OSError) -> SessionFailure:
    if error.errno == errno.ELOOP:
        why = InputError(
            folder,
            "is a symlink that leads in a circle",
            "",
            "Nothing is looked for behind it; remove it if it is a mistake.",
        )
    else:
        why = system_refusal(folder, error)
    return SessionFailure(printable_path(folder), UNREADABLE, printable_path(one_line(str(why))))
