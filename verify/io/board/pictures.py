"""Picture files of a board: listed in natural order, matched left to right by name, decoded."""

import re
from collections.abc import Callable, Generator
from pathlib import Path

from verify.core.records import Image
from verify.errors import InputError
from verify.io.files import refused_as_input_error
from verify.io.video import Images, decode_picture

PICTURE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}

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
        """Decode them: (h, w) grey or (h, w, 3) BGR; InputError: damaged or deeper than 8 bits."""
        for file in self.files:
            yield decode_picture(file, "picture", _REMEDY)


def list_pictures(folder: Path, start: str = "") -> list[Path]:
    """Pictures of a folder that begin with `start`, 2 before 10; InputError: the system refuses."""
    with refused_as_input_error(folder):
        files = [
            file
            for file in folder.iterdir()
            if file.suffix.lower() in PICTURE_SUFFIXES
            and file.name.lower().startswith(start)
            and not file.name.startswith(".")
            and file.is_file()
        ]
    return sorted(files, key=_natural)


def match_pictures(
    left: list[Path], right: list[Path]
) -> tuple[list[Path], list[Path], list[tuple[str, Path]]]:
    """Order the pictures of left and right so that the n-th of both belong together.

    Partners have equal names, or names that are equal without the words left and right, or the
    same last number; the first rule that fits any names is used for all. Where none fits, the
    given order counts. Those without a partner come last, each with its side.

    Raises:
        InputError: the names match nowhere, and one side has more.
    """
    for rule in (lambda file: file.stem, lambda file: _SIDE.sub("", file.stem), _number):
        lefts, rights = _index_by(left, rule), _index_by(right, rule)
        if lefts is None or rights is None or not lefts.keys() & rights.keys():
            continue
        both = [key for key in lefts if key in rights]
        alone = [("left", file) for key, file in lefts.items() if key not in rights]
        alone += [("right", file) for key, file in rights.items() if key not in lefts]
        return [lefts[key] for key in both], [rights[key] for key in both], alone
    if len(left) != len(right):
        found = f"has {len(left)} pictures, {right[0].parent} has {len(right)}"
        expected = "one is expected for each, and their names do not tell which is missing"
        remedy = "Give partners one number, as in left01.jpg and right01.jpg."
        raise InputError(left[0].parent, found, expected, remedy)
    return left, right, []


def _index_by(files: list[Path], rule: Callable[[Path], str]) -> dict[str, Path] | None:
    """Files by the key that a rule makes of their names; None where keys are equal or empty."""
    keyed = {rule(file): file for file in files}
    return keyed if len(keyed) == len(files) and "" not in keyed else None


def _number(file: Path) -> str:
    numbers = re.findall(r"\d+", file.stem)
    return str(int(numbers[-1])) if numbers else ""


def _natural(file: Path) -> tuple[list[tuple[int, str]], str]:
    """Sort digits by their value: img2 before img10."""
    parts = re.findall(r"\d+|\D+", file.name.lower())
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in parts], file.name
