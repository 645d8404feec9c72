"""A results folder that cannot be used: place, found, expected, what to do."""

import unicodedata
from pathlib import Path


class ReportError(Exception):
    """The results cannot be read or written; said in one line.

    Args:
        place: the file (and the key in it) at fault.
        found: what stands there.
        expected: what would be right.
        remedy: what the user can do about it.
    """

    def __init__(self, place: str | Path, found: str, expected: str, remedy: str) -> None:
        self.place, self.found, self.expected, self.remedy = str(place), found, expected, remedy
        super().__init__(one_line(f"{place}: {found}; {expected}. {remedy}"))


def one_line(text: str) -> str:
    """Show line breaks, control characters and what no font can draw by their escapes."""
    return "".join(c if _drawn(c) else c.encode("unicode_escape").decode() for c in text)


def _drawn(character: str) -> bool:
    return (
        character.isprintable() or unicodedata.category(character) == "Zs"
    )  # spaces of all widths
