"""Every session under some folders, on a disk or behind URLs that fsspec knows."""

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from verify.batch.places import is_url, listed
from verify.batch.records import UNREADABLE, Failure, Found, named
from verify.errors import InputError, one_line
from verify.files import system_refusal

SESSION_FILE = "session.toml"
HALF_WRITTEN = ".verify-partial-"  # begins the name of what is being built by `verify.writing`

Identity = tuple[int, int]  # device and inode: the same folder by whatever name


def find(roots: Sequence[str], out: Path) -> tuple[list[Found], list[Failure]]:
    """Find every session.

    A folder that holds session.toml is one; nothing is looked for inside it. Symlinks are
    followed, each folder is taken once, by the first name that leads to it.

    Args:
        roots: folders or URLs, as they were typed.
        out: where the batch writes; it is passed over.

    Returns:
        Sessions and what could not be looked into, each by name.

    Raises:
        InputError: a root does not exist or is no folder; no session is there.
    """
    found: list[Found] = []
    failures: list[Failure] = []
    seen: set[Identity] = set()
    with suppress(OSError):  # not there yet
        seen.add(_identity(str(out)))
    for root in roots:
        for one in listed(root) if is_url(root) else _walk(_root(root), seen):
            if isinstance(one, Found):
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
    path = Path(text)
    try:
        if not path.is_dir():
            found = "is a file" if path.exists() else "does not exist"
            raise InputError(path, found, "a folder is expected", "Name the folder above.")
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        refused = error if isinstance(error, OSError) else OSError(str(error))
        raise system_refusal(path, refused) from error
    return str(path)


def _identity(folder: str) -> Identity:
    status = os.stat(folder)  # noqa: PTH116  # ten thousand of them: no Path objects
    return status.st_dev, status.st_ino


def _walk(root: str, seen: set[Identity]) -> Iterator[Found | Failure]:
    """Go down from a root; `seen` are folders that were met before."""
    # a symlink to a folder above the root leads in a circle as well
    over = frozenset(_identity(str(folder)) for folder in Path(root).resolve().parents)
    waiting: list[tuple[str, frozenset[Identity]]] = [(root, over)]
    while waiting:
        folder, above = waiting.pop()
        try:
            identity = _identity(folder)
            if identity in above:
                raise OSError(errno.ELOOP, "")
            if identity in seen:
                continue
            seen.add(identity)
            inside, is_session = _inside(folder)
        except OSError as error:
            yield _refused(folder, error)
            continue
        if is_session:
            yield Found(named(folder), str(Path(folder).absolute()))
            continue
        chain = above | {identity}
        for path, problem in inside:
            if problem is None:
                waiting.append((path, chain))
            else:
                yield _refused(path, problem)


def _inside(folder: str) -> tuple[list[tuple[str, OSError | None]], bool]:
    """List the folders in a folder, last name first, and whether it is a session."""
    inside: list[tuple[str, OSError | None]] = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name == SESSION_FILE:
                return [], True
            if entry.name.startswith(HALF_WRITTEN):
                continue
            try:
                if entry.is_dir():
                    inside.append((entry.path, None))
            except OSError as error:  # a symlink to itself
                inside.append((entry.path, error))
    return sorted(inside, key=lambda one: one[0], reverse=True), False


def _refused(folder: str, error: OSError) -> Failure:
    if error.errno == errno.ELOOP:
        why = InputError(
            folder,
            "is a symlink that leads in a circle",
            "",
            "Nothing is looked for behind it; remove it if it is a mistake.",
        )
    else:
        why = system_refusal(folder, error)
    return Failure(named(folder), UNREADABLE, named(one_line(str(why))))
