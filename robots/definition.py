"""An arm's TOML file, read once and checked: six joints in standard DH, and their source."""

import difflib
import hashlib
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from robots.arm import DhArm
from robots.errors import RobotError
from robots.inverse import FAMILIES, TABLE_FAMILIES
from robots.transforms import Array

HEAD = {"format", "name", "family", "description", "source", "joint"}
NUMBER_KEYS = {"a_mm": None, "d_mm": None, "alpha_deg": None, "offset_deg": 0.0, "sign": 1.0}
RATE_KEYS = {  # optional: what moves the arm needs them, what watches it does not
    "speed": "speed_deg_s",
    "acceleration": "acceleration_deg_s2",
    "jerk": "jerk_deg_s3",
}
MAX_NUMBER = 1e6  # mm, deg, deg/s²…: more is a slip of the unit
DEEP_KEY = re.compile(rb"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){20}""")  # slow to parse
WHOLE = re.compile(r"[+-]?\d{1,3}")
JOINT = {*NUMBER_KEYS, *RATE_KEYS.values(), "limits_deg", "linkage"}


def read(path: Path) -> DhArm:
    """Read a robot file.

    Raises:
        RobotError: the file is missing, is not TOML, has a wrong, missing or unknown key, or its
            table does not fit its family.
    """
    content, table = _parse(path)
    _check_keys(path, "", table, HEAD)
    if table.get("format") != 1:
        raise RobotError(f"{path}, format", _show_value(table, "format"), "this version reads 1")
    words = {key: _text(path, table, key) for key in ("name", "family", "description", "source")}
    joints = _joints(path, table)
    columns = {key: np.array([joint[key] for joint in joints], dtype=float) for key in NUMBER_KEYS}
    lower, upper = np.radians([joint["limits_deg"] for joint in joints]).T
    arm = DhArm(
        name=words["name"],
        description=words["description"],
        source=words["source"],
        fingerprint=hashlib.sha256(content).hexdigest(),
        lower=lower,
        upper=upper,
        a=columns["a_mm"] / 1000,
        d=columns["d_mm"] / 1000,
        alpha=np.radians(columns["alpha_deg"]),
        sign=columns["sign"],
        offset=np.radians(columns["offset_deg"]),
        family=words["family"],
        linkage=linkage_matrix(
            path, [f"q{j + 1}" for j in range(6)], [j.get("linkage", {}) for j in table["joint"]]
        ),
        **{name: _rates(path, table["joint"], key) for name, key in RATE_KEYS.items()},
    )
    _check_family(path, arm)
    return arm


def _parse(path: Path) -> tuple[bytes, dict[str, Any]]:
    try:
        content = path.read_bytes()
        if DEEP_KEY.search(content):
            raise RobotError(path, "is nested too deeply", "", "Write it as docs/arms.md shows.")
        return content, tomllib.loads(content.decode("utf-8-sig"))  # with Windows' mark, too
    except OSError as error:
        remedy = "Check the path, or give the name of a known robot."
        raise RobotError(path, error.strerror or "cannot be read", "", remedy) from error
    except UnicodeDecodeError as error:
        found = f"byte {error.start} is not UTF-8"
        raise RobotError(path, found, "", "Save it as UTF-8.") from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits; nested tables
        raise RobotError(path, f"not valid TOML: {error}", "", "Correct that line.") from error


def _check_keys(path: Path, where: str, table: dict[str, Any], known: set[str]) -> None:
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            remedy = f'Did you mean "{near[0]}"?' if near else "Remove it."
            expected = f"known keys are {', '.join(sorted(known))}"
            raise RobotError(f"{path}, {where}{key}", "unknown key", expected, remedy)


def _text(path: Path, table: dict[str, Any], key: str) -> str:
    value = table.get(key)
    if not isinstance(value, str) or not value.strip():
        expected, remedy = "a text in quotes is needed", f'Write {key} = "…".'
        raise RobotError(f"{path}, {key}", _show_value(table, key), expected, remedy)
    return value


def _joints(path: Path, table: dict[str, Any]) -> list[dict[str, Any]]:
    joints = table.get("joint")
    if not isinstance(joints, list) or not all(isinstance(joint, dict) for joint in joints):
        found = _show_value(table, "joint")
        raise RobotError(f"{path}, joint", found, "six tables", "Write [[joint]] six times.")
    if len(joints) != 6:
        expected = "a DH table has 6"
        raise RobotError(f"{path}, joint", f"{len(joints)} joints", expected, "Give it as a URDF.")
    return [_joint(path, f"joint {i}, ", joint) for i, joint in enumerate(joints, start=1)]


def _joint(path: Path, where: str, table: dict[str, Any]) -> dict[str, Any]:
    _check_keys(path, where, table, JOINT)
    joint: dict[str, Any] = {}
    for key, default in NUMBER_KEYS.items():
        joint[key] = value = table.get(key, default)
        if not _is_number(value):
            expected = f"a number is needed, at most {MAX_NUMBER:g}"
            raise RobotError(f"{path}, {where}{key}", _show_value(table, key), expected)
    if abs(joint["sign"]) != 1:
        raise RobotError(f"{path}, {where}sign", _show_value(table, "sign"), "1 or -1 is needed")
    joint["limits_deg"] = limits = table.get("limits_deg")
    numbers = limits if isinstance(limits, list) and all(map(_is_number, limits)) else []
    if len(numbers) != 2 or not numbers[0] < numbers[1]:
        found = _show_value(table, "limits_deg")
        expected = "two numbers are needed, the lower one first"
        remedy = "Write limits_deg = [-170.0, 170.0], for instance."
        raise RobotError(f"{path}, {where}limits_deg", found, expected, remedy)
    return joint


def _rates(path: Path, joints: list[dict[str, Any]], key: str) -> Array | None:
    """Read one rate of every joint, a second; None where none states it."""
    if not any(key in joint for joint in joints):
        return None
    for number, joint in enumerate(joints, start=1):
        if not _is_number(joint.get(key)) or joint[key] <= 0:
            expected = "a number above 0 is needed, for all joints or for none"
            raise RobotError(f"{path}, joint {number}, {key}", _show_value(joint, key), expected)
    return np.radians([joint[key] for joint in joints])


def linkage_matrix(path: Path, names: list[str], rows: list[Any]) -> Array | None:
    """Read how axes turn with earlier joints, {"q2": 1} in row 3: (n, n); None where none does.

    Raises:
        RobotError: an axis turns with what is no joint before it, or not by whole turns, so that a
            turn of that joint would not bring the flange back.
    """
    linkage = np.eye(len(names))
    for row, given in enumerate(rows):
        before = names[:row]
        if not isinstance(given, dict) or not all(
            name in before and WHOLE.fullmatch(str(factor)) for name, factor in given.items()
        ):
            expected = f"whole numbers for joints before it ({', '.join(before)}) are needed"
            remedy = "Write linkage = {q2 = 1} where link 3 turns by q3 + q2, for instance."
            raise RobotError(f"{path}, joint {row + 1}, linkage", f"{given!r}", expected, remedy)
        linkage[row, [names.index(name) for name in given]] = [float(f) for f in given.values()]
    return None if np.array_equal(linkage, np.eye(len(names))) else linkage


def _check_family(path: Path, arm: DhArm) -> None:
    if arm.family not in TABLE_FAMILIES:
        near = difflib.get_close_matches(arm.family, TABLE_FAMILIES, n=1)
        expected = f"known families are {', '.join(TABLE_FAMILIES)}"
        remedy = f'Did you mean "{near[0]}"?' if near else "An arm of another kind can be a URDF."
        raise RobotError(f"{path}, family", f'"{arm.family}"', expected, remedy)
    misfit = FAMILIES[arm.family].misfit(arm)
    if misfit:
        joint, key, found, expected = misfit
        remedy = "Correct the number, or give the arm as a URDF."
        because = f"{expected} in the family {arm.family}"
        raise RobotError(f"{path}, joint {joint}, {key}", f"{found:g}", because, remedy)


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= MAX_NUMBER


def _show_value(table: dict[str, Any], key: str) -> str:
    return f"{table[key]!r}" if key in table else "missing"
