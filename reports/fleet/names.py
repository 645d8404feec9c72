"""Names of sessions that fit: without the folders that all of them share."""

from collections.abc import Callable
from typing import Any

from reports.document import formatting as fmt
from reports.results import Results

KEYS = {
    "points": "session", "recent": "session", "worst": "session", "changes": "session",
    "failures": "session", "joints": "latest_session",
}  # fmt: skip


def common_folder(results: Results) -> str:
    """The folder that holds all sessions that the tables name; empty where there is none."""
    return "/".join(_shared(results))


def shortener(results: Results) -> Callable[[Any], str]:
    """Make the function that writes a session's name below the common folder."""
    skipped = len(_shared(results))

    def shorten(name: Any) -> str:
        return "/".join(fmt.text_or_dash(name).split("/")[skipped:]) or fmt.text_or_dash(name)

    return shorten


def _shared(results: Results) -> list[str]:
    """The leading parts that the folders of all named sessions have in common."""
    folders = {
        tuple(str(name).split("/")[:-1])
        for table, key in KEYS.items()
        for name in results.table(table).get(key, ())
        if isinstance(name, str)
    }
    shared: list[str] = []
    for parts in zip(*folders, strict=False):
        if len(set(parts)) > 1:
            break
        shared.append(parts[0])
    return shared
