"""A folder of board pictures: opened, checked, and streamed pair by pair.

Picture files are listed in natural order, matched left to right by name, decoded.
"""

import re
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from verify.core.fiducials import Board
from verify.core.records import Array, Image
from verify.errors import InputError, one_line
from verify.io import fiducials, series
from verify.io.files import digest, refused_as_input_error, require_folder
from verify.io.series import PAN_COLUMNS
from verify.io.toml import did_you_mean
from verify.io.video import Images, Video, decode_in_step, decode_picture

PICTURE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}
VIDEO_SUFFIXES = {".mkv", ".avi", ".mp4", ".mov", ".webm", ".m4v"}
EXPECTED_LAYOUT = "expected are left/ and right/ with pictures, or two videos left.* and right.*"

MIN_PAN_SPAN = np.deg2rad(1.5)  # of a base that is turned on purpose; ± 45° read as radians

Size = tuple[int, int]
_REMEDY = "Take or copy it again, or delete it together with its partner."
_SIDE = re.compile(r"left|right", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class BoardImages:
    """Two simultaneous pictures of one board, and the pan angles of the bases."""

    frame: int
    pan_left: float  # rad, as read
    pan_right: float
    left: Image  # (h, w) grey or (h, w, 3) BGR
    right: Image


@dataclass(frozen=True, slots=True)
class BoardFolder:
    """A folder of board pictures, checked; the pixels stay on the disk."""

    folder: Path
    board: Board
    image_size: Size  # width, height, px, of both cameras
    pan_left: Array  # (n,), rad, as read; 0 where frames.csv gives none; `alone`: the last
    pan_right: Array  # (n,)
    inputs: dict[str, str]  # what was read, by its path in the folder: "sha256:…"
    warnings: tuple[str, ...]
    left: Images
    right: Images
    alone: tuple[tuple[str, Path], ...] = ()  # side and picture without a partner, after the pairs

    def __len__(self) -> int:
        return len(self.pan_left) - len(self.alone)

    @property
    def doubtful_pan(self) -> str:
        """A note that the pan angles look like radians; "" where they do not."""
        small = _small_angles((self.pan_left, self.pan_right))
        spans = [f"{name} spans {span:.2g}°" for name, span in small]
        return f"{' and '.join(spans)}, as if in radians" if spans else ""

    def name(self, frame: int) -> str:
        """Name a pair or a single picture by its files, or by its number in the videos."""
        if frame >= len(self):
            return self.alone[frame - len(self)][1].name
        if isinstance(self.left, PictureFiles) and isinstance(self.right, PictureFiles):
            left, right = self.left.files[frame].name, self.right.files[frame].name
            return left if left == right else f"{left} and {right}"
        return f"image {frame}"

    def pairs(self) -> Generator[BoardImages]:
        """Stream the pairs in step, a few in memory; InputError: one damaged or of another size."""
        with closing(decode_in_step(self.left, self.right, len(self))) as images:
            for frame, (left, right) in enumerate(images):
                _require_size(self.left, frame, left, self.image_size)
                _require_size(self.right, frame, right, self.image_size)
                pan = float(self.pan_left[frame]), float(self.pan_right[frame])
                yield BoardImages(frame, *pan, left, right)

    def single_pictures(self) -> Generator[tuple[int, str, Image]]:
        """Stream those without a partner: number, side and image; raises InputError as `pairs`."""
        sides = PictureFiles(self.folder, [file for _, file in self.alone])
        for i, image in enumerate(sides.images()):
            _require_size(sides, i, image, self.image_size)
            yield len(self) + i, self.alone[i][0], image


def open_board_folder(folder: Path, board: Board | None = None) -> BoardFolder:
    """Open a folder of board pictures and check all but the pictures after the first.

    It holds left/ and right/ with pictures (or left01.jpg, right01.jpg, … side by side, or two
    videos left.* and right.*); optionally frames.csv, whose pan columns are read, and board.toml,
    which `board` replaces. A rig.toml in it is never read. Warnings name unknown keys of
    board.toml, a contradiction between it and `board`, and pan columns that are missing.

    Raises:
        InputError: one line that names the file, what stands there, what should, and what to do.
    """
    require_folder(folder, EXPECTED_LAYOUT, "Give the folder of the board pictures.")
    board, board_warnings = _choose_board(folder, board)
    left, right, alone = _sides(folder)
    pan, pan_warnings = _pan(folder / "frames.csv", _count(left, right))
    pan_left, pan_right = (np.pad(p, (0, len(alone)), mode="edge") for p in pan)
    return BoardFolder(
        folder=folder,
        board=board,
        image_size=_image_size(left, right),
        pan_left=pan_left,
        pan_right=pan_right,
        inputs=_inputs(folder, left, right, alone),
        warnings=(*board_warnings, *pan_warnings, *_warn_alone(alone)),
        left=left,
        right=right,
        alone=alone,
    )


def _choose_board(folder: Path, given: Board | None) -> tuple[Board, tuple[str, ...]]:
    """Take the given board, else board.toml's; warn where the two differ."""
    path = folder / "board.toml"
    if not path.exists():
        if given is not None:
            return given, ()
        expected = "which board was used is needed: its inner corners and the size of its squares"
        remedy = "Copy the board.toml that `verify board` wrote, or give the board by option."
        raise InputError(folder, "has no board.toml", expected, remedy)
    if given is None:
        return fiducials.read_board(path)
    try:
        written, warnings = fiducials.read_board(path)
    except InputError as error:
        return given, (one_line(f"{error} The board given by option is used."),)
    if written == given:
        return given, warnings
    both = f"{_describe_board(written)}; {_describe_board(given)}, given by option, is used."
    return given, (*warnings, one_line(f"{path}: says {both}"))


def _describe_board(board: Board) -> str:
    parts = [f"{board.columns} x {board.rows} inner corners of {board.square * 1e3:g} mm"]
    if board.square_standard_uncertainty is not None:
        parts.append(f"± {board.square_standard_uncertainty * 1e3:g} mm")
    if board.markers is not None and board.marker is not None:
        parts.append(f"with {board.markers} markers of {board.marker * 1e3:g} mm")
    return " ".join(parts)


def _sides(folder: Path) -> tuple[Images, Images, tuple[tuple[str, Path], ...]]:
    """Find both sides' pictures or videos, whose n-th belong together, and pictures alone."""
    alone: list[tuple[str, Path]] = []
    left, right = (_find_images(folder, side) for side in ("left", "right"))
    if left.path != folder and left.path.resolve() == right.path.resolve():
        raise InputError(right.path, "leads to the left pictures", "each camera has its own")
    if isinstance(left, PictureFiles) and isinstance(right, PictureFiles):
        left.files, right.files, alone = match_pictures(left.files, right.files)
    elif isinstance(left, PictureFiles) or isinstance(right, PictureFiles):
        kinds = ["pictures" if isinstance(s, PictureFiles) else "a video" for s in (left, right)]
        differ = f"has {kinds[0]} on the left and {kinds[1]} on the right"
        raise InputError(folder, differ, EXPECTED_LAYOUT, "Use one form for both.")
    return left, right, tuple(alone)


def _warn_alone(alone: tuple[tuple[str, Path], ...]) -> Iterator[str]:
    for side in ("left", "right"):
        files = [file for own, file in alone if own == side]
        if files:
            more = f" (nor have {len(files) - 1} more)" if len(files) > 1 else ""
            note = f"{files[0]}: has no partner{more}; it counts for the {side} lens alone."
            yield one_line(note)


def _find_images(folder: Path, side: str) -> Images:
    inner = folder / side
    videos = [
        file for file in sorted(folder.glob(f"{side}.*")) if file.suffix.lower() in VIDEO_SUFFIXES
    ]
    if len(videos) + inner.is_dir() > 1:
        also = videos[0].name if inner.is_dir() else videos[1].name
        first = f"{side}/" if inner.is_dir() else videos[0].name
        raise InputError(folder, f"has {first} and {also}", "one of them is expected", "Move one.")
    if videos:
        return Video(videos[0])
    if not inner.is_dir():
        if beside := list_pictures(folder, side):
            return PictureFiles(folder, beside)
        raise InputError(folder, f"has no {side}/", EXPECTED_LAYOUT, "Name the folders so.")
    files = list_pictures(inner)
    if not files:
        kinds = ", ".join(sorted(kind[1:] for kind in PICTURE_SUFFIXES))
        raise InputError(inner, "holds no pictures", f"known are {kinds}", "Put them there.")
    return PictureFiles(inner, files)


def _count(left: Images, right: Images) -> int:
    counts = left.count(), right.count()
    if counts[0] != counts[1]:
        found = f"has {counts[0]} images, {right.path} has {counts[1]}"
        expected = "videos that run in step have as many"
        raise InputError(left.path, found, expected, "Record both together again.")
    if not counts[0]:
        raise InputError(left.path, "has no images", "", "Record it again.")
    return counts[0]


def _pan(path: Path, count: int) -> tuple[tuple[Array, Array], tuple[str, ...]]:
    """Read the pan columns of frames.csv, rad, 0 where it gives none, and warnings."""
    still = np.zeros(count)
    if not path.exists():
        return (still, still), ()
    table, _ = series.open_table(path, torn=False)
    present = [name for name in PAN_COLUMNS if name in table.header]
    columns = table.columns(("frame", *present))
    table.require_counting(columns["frame"], "pictures")
    if len(columns["frame"]) != count:
        found = f"has {len(columns['frame'])} rows"
        raise InputError(path, found, f"there are {count} pairs", "Write one row a pair.")
    left, right = (np.deg2rad(columns[name]) if name in columns else still for name in PAN_COLUMNS)
    small = [
        one_line(f"{path}: {name} spans {span:.2g}°; are these radians?")
        for name, span in _small_angles((left, right))
    ]
    return (left, right), (*_warn_misnamed(path, table.header, present), *small)


def _small_angles(pan: tuple[Array, Array]) -> Iterator[tuple[str, float]]:
    """Columns whose span is above 0 and too small for degrees, and the spans, deg."""
    for name, angles in zip(PAN_COLUMNS, pan, strict=True):
        if 0 < np.ptp(angles) < MIN_PAN_SPAN:
            yield name, float(np.rad2deg(np.ptp(angles)))


def _warn_misnamed(path: Path, header: list[str], present: list[str]) -> Iterator[str]:
    for name in header:
        if "pan" in name.lower() and name not in PAN_COLUMNS:
            yield one_line(f"{path}: column {name} is ignored.{did_you_mean(name, PAN_COLUMNS)}")
    if len(present) == 1:
        missing = PAN_COLUMNS[1 - PAN_COLUMNS.index(present[0])]
        note = f"{path}: has {present[0]} but no {missing}; that base is taken to stand at 0."
        yield one_line(note)


def _image_size(left: Images, right: Images) -> Size:
    """Decode the first pictures: (width, height), the same of both sides, else an InputError."""
    with closing(left.images()) as images:
        height, width = next(images).shape[:2]
    with closing(right.images()) as images:
        _require_size(right, 0, next(images), (width, height))
    return width, height


def _require_size(side: Images, frame: int, image: Image, size: Size) -> None:
    height, width = image.shape[:2]
    if (width, height) == size:
        return
    place = side.files[frame] if isinstance(side, PictureFiles) else f"{side.path}, image {frame}"
    expected = f"the first left one is {size[0]} x {size[1]}"
    remedy = "Take all pictures with both cameras at one resolution."
    raise InputError(place, f"is {width} x {height} px", expected, remedy)


def _inputs(
    folder: Path, left: Images, right: Images, alone: tuple[tuple[str, Path], ...]
) -> dict[str, str]:
    beside = [folder / name for name in ("board.toml", "frames.csv")]
    read = [path for path in beside if path.exists()]
    for side in (left, right):
        flat = isinstance(side, PictureFiles) and side.path == folder
        read += side.files if isinstance(side, PictureFiles) and flat else [side.path]
    read += [file for _, file in alone if file.parent == folder]
    return {str(path.relative_to(folder)): digest(path) for path in read}


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
