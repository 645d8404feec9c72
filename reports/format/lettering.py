"""Letters in drawings on paper: one font, what it lacks, and how wide a text is in it.

The font is one that matplotlib brings along, so that the same results give the same bytes on every
machine; matplotlib itself, which takes long to load, is not.
"""

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from PIL import ImageFont

from reports.results import one_line

_PACKAGES = find_spec("matplotlib")
assert _PACKAGES is not None
assert _PACKAGES.origin is not None
FONTS = Path(_PACKAGES.origin).parent / "mpl-data" / "fonts" / "ttf"
FAMILY = "DejaVu Sans"
UNITS_PER_EM = 2048  # of its widths: at letters of that size they are whole pixels
COMPARED_SIZE = 32  # px, at which no letter looks like the box that stands for those it lacks
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
    return "".join(letter if _has(letter) else "\ufffd" for letter in text)


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(FONTS / "DejaVuSans.ttf", size, layout_engine=ImageFont.Layout.BASIC)


@cache
def _has(letter: str) -> bool:
    return bytes(_font(COMPARED_SIZE).getmask(letter)) != _box()


@cache
def _box() -> bytes:
    return bytes(_font(COMPARED_SIZE).getmask("\uffff"))


@cache
def _advance(letter: str) -> float:
    return _font(UNITS_PER_EM).getlength(letter) / UNITS_PER_EM
