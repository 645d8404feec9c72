"""A machine word in words, and units as signs."""

from typing import Any

from reports.formatting import DASH

NOT_STATED = "not stated"  # by whoever made the session: a dash would read as lost
UNITS = {
    "deg": "°", "ratio": "", "s": "s", "mm": "mm", "m": "m", "rad": "rad",
    "deg/m": "°/m", "deg/h": "°/h", "ppm": "ppm",
}  # fmt: skip


def said(words: dict[str, str], word: Any) -> str:
    """Look a machine word up; one that is not known is shown as it is, without underscores."""
    if word is None:
        return DASH
    return words.get(str(word), str(word).replace("_", " "))
