"""Letters in drawings on paper: one font, what it lacks, and how wide a text is in it.

The font is one that matplotlib brings along, so that the same results give the same bytes on every
machine.
"""

from functools import cache
from pathlib import Path

from matplotlib import get_data_path
from matplotlib.ft2font import FT2Font, LoadFlags

from reports.results import one_line

FONTS = Path(get_data_path()) / "fonts" / "ttf"
FAMILY = "DejaVu Sans"
MAX_LABEL_LETTERS = 34  # letters of a user's word beside a plot; longer ones would push it aside
LINE_PITCH = 1.2  # from one line of a text to the next, times the letters' size


def printable(text: str, most: int = MAX_LABEL_LETTERS) -> str:
    """A user's word, lines of `most` letters, those that the font lacks replaced."""
    return "\n".join(_printable_line(line, most) for line in text.split("\n"))


def text_width(text: str, size: float) -> float:
    """How wide a text is, its longest line, at letters of this size; in the size's unit."""
    return max(sum(_advance(letter) for letter in line) for line in text.split("\n")) * size


def text_height(text: str, size: float) -> float:
    """How high a text with all its lines is."""
    return LINE_PITCH * size * (text.count("\n") + 1)


def _printable_line(text: str, most: int) -> str:
    text = one_line(text)
    if len(text) > most:
        text = text[: most - 1] + "…"
    return "".join(c if ord(c) in _letters() else "\ufffd" for c in text)


@cache
def _font() -> FT2Font:
    return FT2Font(FONTS / "DejaVuSans.ttf")


@cache
def _letters() -> frozenset[int]:
    return frozenset(_font().get_charmap())


@cache
def _advance(letter: str) -> float:
    glyph = _font().load_char(ord(letter), LoadFlags.NO_SCALE)
    return float(glyph.horiAdvance / _font().units_per_EM)
