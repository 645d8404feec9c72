"""Ways to break a file: what stands in it, and what it is.

A mutation takes a file and a generator of random numbers, breaks the file in place, and says how.
"""

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

NUMBER = re.compile(rb"(?<![\w.\"])-?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.\"])")
HOSTILE = (b"nan", b"-inf", b"1e300", b"-1e300", b"9" * 5000, b"0", b"-1", b"true", b'""',
           b'"\\u0000"', b"[]", b"{}", b"")  # fmt: skip
SLIPS = (1e3, 1e-3, 1e6, 1e-6, np.pi / 180, 180 / np.pi, -1.0)  # of a unit or a sign
MAX_RUN = 64  # bytes that are cut out or repeated

Mutation = Callable[[Path, np.random.Generator], str]


def replace_number(file: Path, rng: np.random.Generator) -> str:
    """One number becomes something hostile."""
    value = HOSTILE[rng.integers(len(HOSTILE))]
    return _substitute(file, rng, lambda _: value)


def slip_unit(file: Path, rng: np.random.Generator) -> str:
    """One number is written in another unit, or with the other sign."""
    factor = float(rng.choice(SLIPS))
    return _substitute(file, rng, lambda found: repr(float(found) * factor).encode())


def slip_column(file: Path, rng: np.random.Generator) -> str:
    """All numbers after one name, or in one column, are in another unit."""
    factor = float(rng.choice(SLIPS))
    lines = file.read_bytes().split(b"\n")
    if file.suffix != ".csv":
        at = int(rng.integers(len(lines)))
        lines[at] = NUMBER.sub(lambda m: repr(float(m[0]) * factor).encode(), lines[at])
        file.write_bytes(b"\n".join(lines))
        return f"line {at + 1} times {factor:g}"
    column = int(rng.integers(lines[0].count(b",") + 1))
    for at, line in enumerate(lines[1:], 1):
        cells = line.split(b",")
        if column < len(cells) and NUMBER.fullmatch(cells[column]):
            cells[column] = repr(float(cells[column]) * factor).encode()
            lines[at] = b",".join(cells)
    file.write_bytes(b"\n".join(lines))
    return f"column {column + 1} times {factor:g}"


def change_line(file: Path, rng: np.random.Generator) -> str:
    """A line goes, stands twice, or changes places with the next."""
    lines = file.read_bytes().split(b"\n")
    at, how = int(rng.integers(len(lines))), ("deleted", "doubled", "exchanged")[rng.integers(3)]
    lines[at : at + 2] = {
        "deleted": lines[at + 1 : at + 2],
        "doubled": [lines[at], *lines[at : at + 2]],
        "exchanged": lines[at : at + 2][::-1],
    }[how]
    file.write_bytes(b"\n".join(lines))
    return f"line {at + 1} {how}"


def change_word(file: Path, rng: np.random.Generator) -> str:
    """A letter of a key, a name or a path changes."""
    data = bytearray(file.read_bytes())
    letters = [i for i in range(min(len(data), 20_000)) if chr(data[i]).isalpha()]
    if letters:
        at = int(rng.choice(letters))
        data[at] = int(rng.choice(list(b"xQ/\\\"'=\n\x00\xff")))
        file.write_bytes(data)
        return f"letter {at} is {data[at]:#x}"
    return "nothing"


def flip_bits(file: Path, rng: np.random.Generator) -> str:
    """Some bits flip."""
    data = bytearray(file.read_bytes())
    places = rng.integers(len(data), size=int(rng.integers(1, 20)))
    for at in places:
        data[at] ^= 1 << int(rng.integers(8))
    file.write_bytes(data)
    return f"bits at {sorted(places.tolist())}"


def truncate(file: Path, rng: np.random.Generator) -> str:
    """The end is missing."""
    length = int(rng.integers(file.stat().st_size))
    os.truncate(file, length)
    return f"cut to {length} bytes"


def repeat_bytes(file: Path, rng: np.random.Generator) -> str:
    """Some bytes stand a thousand times."""
    data = file.read_bytes()
    at = int(rng.integers(len(data)))
    file.write_bytes(data[:at] + data[at : at + MAX_RUN] * 1000 + data[at + MAX_RUN :])
    return f"bytes at {at} a thousand times"


def replace_file(file: Path, rng: np.random.Generator) -> str:
    """Something else stands there: nothing, a folder, a link, a pipe, a device, a huge file."""
    kinds = ("nothing", "empty", "folder", "link to itself", "pipe", "device", "huge", "noise")
    kind = kinds[rng.integers(len(kinds))]
    file.unlink()
    if kind == "empty":
        file.touch()
    elif kind == "folder":
        file.mkdir()
    elif kind == "link to itself":
        file.symlink_to(file.name)
    elif kind == "pipe":
        os.mkfifo(file)
    elif kind == "device":
        file.symlink_to("/dev/zero")
    elif kind == "huge":
        file.touch()
        os.truncate(file, 20_000_000_000)  # no block of it stands on the disk
    elif kind == "noise":
        file.write_bytes(rng.bytes(5000))
    return kind


TEXT: tuple[Mutation, ...] = (
    replace_number, replace_number, slip_unit, slip_column, change_line, change_word, repeat_bytes,
)  # fmt: skip
ANY: tuple[Mutation, ...] = (flip_bits, truncate, replace_file)


def mutate(file: Path, rng: np.random.Generator) -> str:
    """Break a file in one way; say how."""
    text = file.suffix in {".toml", ".csv", ".json", ".urdf"}
    choices = (*TEXT, *ANY) if text else ANY
    return choices[rng.integers(len(choices))](file, rng)


def _substitute(file: Path, rng: np.random.Generator, new: Callable[[bytes], bytes]) -> str:
    data = file.read_bytes()
    found = list(NUMBER.finditer(data))
    if not found:
        return "nothing"
    match = found[rng.integers(len(found))]
    value = new(match[0])
    file.write_bytes(data[: match.start()] + value + data[match.end() :])
    line = data.count(b"\n", 0, match.start()) + 1
    return f"line {line}: {match[0].decode()} is {value[:20].decode()}"
