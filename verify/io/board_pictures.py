"""Board pictures as users keep them: any names, several formats, partners found by their names."""

import re
from collections.abc import Callable, Generator
from pathlib import Path

import cv2
import numpy as np

from verify.core.records import Image
from verify.errors import InputError
from verify.io.files import read_bytes, system_refusal
from verify.io.video import Images, png_intact

PICTURE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}

_FLAGS = (
    cv2.IMREAD_ANYCOLOR
    | cv2.IMREAD_ANYDEPTH
    | cv2.IMREAD_IGNORE_ORIENTATION  # a calibration holds for the sensor's own rows and columns
)
_REMEDY = "Take or copy it again, or delete it together with its partner."
_SIDE = re.compile(r"left|right", re.IGNORECASE)


class PictureFiles(Images):
    """The pictures of one camera, in the order given."""

    def __init__(self, path: Path, files: list[Path]) -> None:
        super().__init__(path)
        self.files = files

    def count(self, torn: bool = False) -> int:  # noqa: ARG002  # every file is whole or refused
        """Count the pictures."""
        return len(self.files)

    def images(self) -> Generator[Image]:
        """Decode the pictures: (h, w) grey or (h, w, 3) BGR.

        Raises:
            InputError: one is damaged, no picture, or deeper than 8 bits.
        """
        for file in self.files:
            yield decode(file)


def decode(file: Path) -> Image:
    """Decode one picture: (h, w) grey where the file is grey, else (h, w, 3) BGR.

    Raises:
        InputError: it cannot be read, is damaged, no picture, or deeper than 8 bits.
    """
    data = read_bytes(file)
    image = None
    if file.suffix.lower() != ".png" or png_intact(data):  # libpng fills a hole without a word
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), _FLAGS)
    if image is None:
        raise InputError(file, "is damaged or no picture", "", _REMEDY)
    if image.dtype != np.uint8:
        found = f"has {8 * image.dtype.itemsize} bits a sample"
        raise InputError(file, found, "8 are expected", "Convert it, or set the camera to 8 bits.")
    return np.asarray(image, dtype=np.uint8)


def list_pictures(folder: Path, start: str = "") -> list[Path]:
    """List the pictures of a folder whose names begin with `start`, 2 before 10.

    Raises:
        InputError: the system refuses the folder.
    """
    try:
        files = [
            file
            for file in folder.iterdir()
            if file.suffix.lower() in PICTURE_SUFFIXES
            and file.name.lower().startswith(start)
            and not file.name.startswith(".")
            and file.is_file()
        ]
    except OSError as error:
        raise system_refusal(folder, error) from error
    return sorted(files, key=_natural)


def match_pictures(left: list[Path], right: list[Path]) -> tuple[list[Path], list[Path]]:
    """Bring the pictures of both sides into step.

    Partners have equal names, or names that are equal without the words left and right, or the
    same last number; the first of these rules that fits any names is held to. Where none does,
    the n-th left one belongs to the n-th right one.

    Raises:
        InputError: a picture without a partner; names it.
    """
    for rule in (_stem, _name_without_side, _number):
        lefts, rights = _index_by(left, rule), _index_by(right, rule)
        if lefts is None or rights is None or not lefts.keys() & rights.keys():
            continue
        for ours, theirs, others in ((lefts, rights, right), (rights, lefts, left)):
            alone = [file for key, file in ours.items() if key not in theirs]
            if alone:
                more = f" (nor have {len(alone) - 1} more)" if len(alone) > 1 else ""
                found = f"has no partner among {len(others)} pictures of the other side{more}"
                expected = f"partners bear one name or number, like {_example(lefts, rights)}"
                raise InputError(alone[0], found, expected, "Add the missing one or delete it.")
        return left, [rights[rule(file)] for file in left]
    if len(left) != len(right):
        found = f"has {len(left)} pictures, {right[0].parent} has {len(right)}"
        expected = "one is expected for each, and their names do not tell which is missing"
        remedy = "Give partners one number, as in left01.jpg and right01.jpg."
        raise InputError(left[0].parent, found, expected, remedy)
    return left, right


def _index_by(files: list[Path], rule: Callable[[Path], str]) -> dict[str, Path] | None:
    """Look files up by what a rule makes of their names; None where that does not tell them."""
    keyed = {rule(file): file for file in files}
    return keyed if len(keyed) == len(files) and "" not in keyed else None


def _example(lefts: dict[str, Path], rights: dict[str, Path]) -> str:
    key = next(key for key in lefts if key in rights)
    return f"{lefts[key].name} and {rights[key].name}"


def _stem(file: Path) -> str:
    return file.stem


def _name_without_side(file: Path) -> str:
    return _SIDE.sub("", file.stem)


def _number(file: Path) -> str:
    numbers = re.findall(r"\d+", file.stem)
    return str(int(numbers[-1])) if numbers else ""


def _natural(file: Path) -> tuple[list[tuple[int, str]], str]:
    """Sort digits by their value: img2 before img10."""
    parts = re.findall(r"\d+|\D+", file.name.lower())
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in parts], file.name
