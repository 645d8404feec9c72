"""The contract between what measures and what reports, and the folder that keeps it.

A results folder holds `results.json` (summary, setup and a list of the other files with their
hashes), one Parquet file a table and one PNG an image. The same results give the same bytes.
"""

import errno
import hashlib
import io
import json
import math
import re
import tempfile
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq


class ReportError(Exception):
    """The results cannot be read or written: place (file, key), found, expected and remedy."""

    def __init__(self, place: str | Path, found: str, expected: str, remedy: str) -> None:
        self.place, self.found, self.expected, self.remedy = str(place), found, expected, remedy
        super().__init__(one_line(f"{place}: {found}; {expected}. {remedy}"))


def one_line(text: str) -> str:
    """Show line breaks, control characters and what no font can draw by their escapes."""
    return "".join(c if _is_printable(c) else c.encode("unicode_escape").decode() for c in text)


def _is_printable(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) == "Zs"  # any space


FORMAT_VERSION = 1  # of results.json; a change that older readers cannot follow raises it
MANIFEST = "results.json"
MAX_BYTES = 1_000_000_000  # of a file of the results
REBUILD_COMMANDS = {  # what wrote a results folder, by the kind and the method in its summary
    ("run", None): "`verify run` on the session",
    ("calibration", None): "`verify calibrate boards` on the pictures",
    ("calibration", "check"): "`verify calibrate check` with -o",
    ("registration", "motion"): "`verify calibrate register` on the session",
    ("registration", "fixture"): "`verify calibrate register` on the pictures",
    ("registration", "sweeps"): "`verify calibrate register` on the session",
    ("grab", None): "`verify grab`",
    ("identification", None): "`verify identify` on the sessions",
    ("plan", None): "`verify plan` on the robot and the rig",
}
# of a table or image: it becomes a file name, so no dots or slashes
NAME_PATTERN = re.compile(r"[a-z0-9_]+")
NO_NAME = "is no name for a table or an image"
NAME_RULE = "lower-case letters, digits and underscores make one"
PNG = b"\x89PNG\r\n\x1a\n"  # the signature every PNG file starts with


@dataclass(frozen=True)
class Results:
    """All that a report says: nothing in it is computed from anything else.

    `summary` is summary.json, `setup` the rig, the marker and the robot's table, `tables` hold
    frames, spots, resolved errors, clock curve and uncertainty budget, `images` PNG bytes. `films`
    are MP4 bytes by file name: they lie beside the report, and no results folder holds them.
    """

    summary: dict[str, Any]
    setup: dict[str, Any]
    tables: dict[str, pd.DataFrame]
    images: dict[str, bytes] = field(default_factory=dict)
    films: dict[str, bytes] = field(default_factory=dict)

    def table(self, name: str) -> pd.DataFrame:
        """Take a table by its name; an empty one where there is none."""
        return self.tables.get(name, pd.DataFrame())


def write(results: Results, folder: Path) -> None:
    """Write a results folder; files appear whole, the manifest last; other files are left alone.

    Raises:
        ReportError: a name is no file name, or the folder cannot be written.
    """
    files = packed(results, folder)
    try:
        _write_files(files, folder)
    except OSError as problem:
        raise ReportError(
            folder,
            f"cannot be written ({problem.strerror})",
            "a folder that may be written is needed",
            "Choose another place.",
        ) from problem


def packed(results: Results, folder: Path) -> dict[str, bytes]:
    """Pack results for a folder: files by name, manifest last; ReportError: a name is none."""
    files: dict[str, bytes] = {}
    tables = {}
    for name, table in sorted(results.tables.items()):
        tables[name] = _add_file(files, folder, name, ".parquet", _parquet(table))
    images = {}
    for name, image in sorted(results.images.items()):
        images[name] = _add_file(files, folder, name, ".png", image)
    manifest = {
        "format": FORMAT_VERSION,
        "summary": to_json_value(results.summary),
        "setup": to_json_value(results.setup),
        "tables": tables,
        "images": images,
    }
    text = json.dumps(manifest, ensure_ascii=True, allow_nan=False)
    files[MANIFEST] = msgspec.json.format(text.encode(), indent=1) + b"\n"
    return files


def rebuild_command(folder: Path) -> str:
    """Say which command makes a results folder anew, as far as what is left of it tells.

    A manifest that cannot be read has the same summary beside the folder, in summary.json.
    """
    for place, key in ((folder / MANIFEST, "summary"), (folder.parent / "summary.json", None)):
        try:
            content = json.loads(_read_plain(place))
            summary = content if key is None else content[key]
            kind = summary.get("kind", "run"), summary.get("method")
        except (OSError, ValueError, RecursionError, AttributeError, KeyError, TypeError):
            continue
        command = REBUILD_COMMANDS.get(kind) or REBUILD_COMMANDS.get((kind[0], None))
        if command:
            return f"Run {command} again."
    return "Run the command again that wrote it."


def read(folder: Path, only: Collection[str] | None = None) -> Results:
    """Read a results folder, all of it or `only` some tables; ReportError: not what was written."""
    manifest = _manifest(folder)
    listed, pictures = manifest["tables"].items(), manifest["images"].items()
    tables = {n: _table(folder, n, entry) for n, entry in listed if only is None or n in only}
    images = {n: _image(folder, n, entry) for n, entry in pictures if only is None}
    return Results(manifest["summary"], manifest["setup"], tables, images)


def to_json_value(value: Any) -> Any:
    """Turn numbers of any library into JSON's own; what is not finite becomes null.

    Bytes of a file's name that are not UTF-8 become escapes.
    """
    if isinstance(value, Mapping):
        return {to_json_value(str(key)): to_json_value(item) for key, item in value.items()}
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):  # NumPy's arrays and its bool
        return to_json_value(value.tolist())
    if isinstance(value, Sequence):
        return [to_json_value(item) for item in value]
    return to_json_value(str(value))  # dates, paths, versions


def _add_file(
    files: dict[str, bytes], folder: Path, name: str, ending: str, content: bytes
) -> dict[str, str]:
    if not NAME_PATTERN.fullmatch(name):
        raise ReportError(folder, f"{name!r} {NO_NAME}", NAME_RULE, "Rename it.")
    files[name + ending] = content
    return {"sha256": hashlib.sha256(content).hexdigest()}


def _parquet(table: pd.DataFrame) -> bytes:
    # as Table.from_pandas, which spends most of its time on metadata that are not wanted here
    columns = [_column(column) for _, column in table.items()]
    arrow = pa.Table.from_arrays(columns, names=[str(name) for name in table.columns])
    buffer = io.BytesIO()
    # measured figures seldom repeat themselves: a dictionary of them only takes room
    repeating = [kind.name for kind in arrow.schema if not pa.types.is_floating(kind.type)]
    pq.write_table(arrow, buffer, compression="zstd", use_dictionary=repeating)
    return buffer.getvalue()


def _column(column: "pd.Series[Any]") -> pa.Array:
    numpys = isinstance(column.dtype, np.dtype)  # quicker than through pandas
    return pa.array(column.to_numpy() if numpys else column, from_pandas=True)


def _write_files(files: dict[str, bytes], folder: Path) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as staging:
        for name, content in files.items():
            (Path(staging) / name).write_bytes(content)
        folder.mkdir(exist_ok=True)
        for name in files:  # the manifest is the last of them
            (Path(staging) / name).replace(folder / name)


def _manifest(folder: Path) -> dict[str, Any]:
    place = folder / MANIFEST
    try:
        manifest = json.loads(_read_plain(place))
    except FileNotFoundError as problem:
        raise ReportError(
            folder,
            f"there is no {MANIFEST} in it",
            "a results folder that `verify run` or `verify calibrate` wrote is expected",
            "Name the folder of its report.",
        ) from problem
    except OSError as problem:
        found = f"cannot be read ({problem.strerror})"
        raise _damaged(folder, MANIFEST, found, "a readable file is needed") from problem
    except (ValueError, RecursionError) as problem:
        expected = "it is damaged or cut short"
        raise _damaged(folder, MANIFEST, "it is not JSON", expected) from problem
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT_VERSION:
        stated = manifest.get("format") if isinstance(manifest, dict) else None
        raise ReportError(
            place,
            f"its format is {json.dumps(stated)}",
            f"this version reads format {FORMAT_VERSION}",
            f"Use the version of verify that wrote it. {rebuild_command(folder)}",
        )
    for key in ("summary", "setup", "tables", "images"):
        if not isinstance(manifest.get(key), dict):
            raise _damaged(folder, MANIFEST, f"{key} is missing", "it must be an object")
    return manifest


def _damaged(folder: Path, file: str, found: str, expected: str) -> ReportError:
    return ReportError(folder / file, found, expected, rebuild_command(folder))


def _read_plain(file: Path) -> bytes:
    """Read a file; OSError for a pipe or a device, and for what is too large to be results."""
    if file.exists() and not file.is_file():
        raise OSError(errno.EINVAL, "it is no plain file")
    if file.stat().st_size > MAX_BYTES:
        raise OSError(errno.EFBIG, f"it has more than {MAX_BYTES} bytes")
    return file.read_bytes()


def _read_entry(folder: Path, name: str, ending: str, entry: object) -> bytes:
    if not NAME_PATTERN.fullmatch(name) or not isinstance(entry, dict):
        raise _damaged(folder, MANIFEST, f"{name!r} {NO_NAME}", NAME_RULE)
    try:
        content = _read_plain(folder / (name + ending))
    except OSError as problem:
        found, expected = f"cannot be read ({problem.strerror})", f"{MANIFEST} lists it as part"
        raise _damaged(folder, name + ending, found, f"{expected} of the results") from problem
    if hashlib.sha256(content).hexdigest() != entry.get("sha256"):
        expected = f"{MANIFEST} holds another hash"
        raise _damaged(folder, name + ending, "its content is not what was written", expected)
    return content


def _table(folder: Path, name: str, entry: object) -> pd.DataFrame:
    content = _read_entry(folder, name, ".parquet", entry)
    try:
        # pq.read_table starts threads all the same, and waits for ever where one cannot start
        read = pq.ParquetFile(io.BytesIO(content)).read(use_threads=False)
        table: pd.DataFrame = read.to_pandas(use_threads=False)
    except (pa.ArrowException, OSError, ValueError) as problem:
        if isinstance(problem, MemoryError) or "thread" in str(problem):  # one could not start
            raise
        found, expected = "it is not a Parquet file", "a table is expected"
        raise _damaged(folder, f"{name}.parquet", found, expected) from problem
    return table


def _image(folder: Path, name: str, entry: object) -> bytes:
    content = _read_entry(folder, name, ".png", entry)
    if not content.startswith(PNG):
        raise _damaged(folder, f"{name}.png", "it is not a PNG file", "an image is expected")
    return content
