"""Files that are written together: where one of them fails, none of them stays."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from verify.errors import InputError
from verify.writing import write_whole


@contextmanager
def undone_on_failure(*paths: Path) -> Iterator[None]:
    """Put files back as they were if what is done inside fails.

    For small files that stand beside a report folder: write them first, the folder last.

    Args:
        paths: files that are written inside; each may exist before.

    Raises:
        BaseException: whatever was raised inside, once the files are back.
    """
    before = {path: path.read_bytes() if path.is_file() else None for path in paths}
    try:
        yield
    except BaseException:  # an interrupt leaves as little behind as a full disk
        for path, content in before.items():
            with suppress(OSError, InputError):
                _put_back(path, content)
        raise


def _put_back(path: Path, content: bytes | None) -> None:
    if content is None:
        path.unlink(missing_ok=True)
    elif path.read_bytes() != content:
        write_whole(path, content)
