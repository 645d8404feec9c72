"""Scenario files: the built-in ones by name, any other by path; decoded strictly."""

import difflib
import math
import re
import tomllib
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec

from verify.errors import InputError
from verify.simulation.scenario import (
    BoardScenario,
    BoardScenarioTable,
    Scenario,
    ScenarioCamera,
    ScenarioTable,
)

ROBOT_FILES = {".toml", ".urdf"}  # what robots.load takes for a file; else it is a name


BOARDS = "boards_"  # begins the names of the built-in scenarios that have boards, not a robot


def names() -> list[str]:
    """List the built-in scenarios that make a session."""
    return [name for name in _built_in() if not name.startswith(BOARDS)]


def _built_in() -> list[str]:
    folder = resources.files("verify.simulation") / "scenarios"
    return sorted(Path(f.name).stem for f in folder.iterdir() if f.name.endswith(".toml"))


def load(name_or_path: str) -> Scenario | BoardScenario:
    """Read a scenario: a built-in one's name, or the path of a TOML file.

    A robot that a file names by a path is looked for beside that file. A file with `[boards]`
    makes board pictures instead of a session.

    Raises:
        InputError: no such scenario, not TOML, a key that is not known, or a value out of range.
    """
    known = _built_in()
    if name_or_path in known:
        text = (
            resources.files("verify.simulation") / "scenarios" / f"{name_or_path}.toml"
        ).read_text()
        return decode(text, f"{name_or_path}.toml")
    path = Path(name_or_path)
    if not path.is_file():
        close = difflib.get_close_matches(name_or_path, known, n=1)
        raise InputError(
            "scenario",
            f'"{name_or_path}" is neither a built-in scenario nor a file',
            f'did you mean "{close[0]}"?' if close else "",
            f"Known: {', '.join(known)}. Or give the path of a scenario file.",
        )
    try:
        scenario = decode(path.read_text(encoding="utf-8"), str(path))
        if isinstance(scenario, Scenario) and Path(scenario.robot).suffix in ROBOT_FILES:
            beside = str(path.parent / scenario.robot)
            return msgspec.structs.replace(scenario, robot=beside)
        return scenario
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"cannot be read ({error})", "a TOML file in UTF-8") from None


def decode(text: str, place: str) -> Scenario | BoardScenario:
    """Turn the text of a scenario file into what it describes; `place` names it in complaints."""
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(place, f"not TOML: {error}", remedy="Mend the file.") from None
    for key, value in _numbers(raw):
        if not math.isfinite(value):
            raise InputError(place, f"{key} is {value}", "a finite number is needed")
    kind: type[Scenario] | type[BoardScenario] = BoardScenario if "boards" in raw else Scenario
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        remedy = _suggestion(str(error), kind)
        raise InputError(place, _reword(str(error)), remedy=remedy) from None


def _numbers(value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Walk through decoded TOML and give each number with its key path."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(inner, f"{path}.{key}" if path else key)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _numbers(inner, f"{path}[{index}]")
    elif isinstance(value, int | float):
        yield path, value


def _reword(message: str) -> str:
    """Say a msgspec complaint in the file's terms: key path first."""
    what, _, where = message.partition(" - at `$")
    where = where.rstrip("`").lstrip(".")
    what = what.replace("Object contains unknown field", "unknown key").replace("Object", "table")
    return f"{where}: {what}" if where else what


def _suggestion(message: str, kind: type[Scenario] | type[BoardScenario]) -> str:
    """Name the known key that is closest to a misspelt one."""
    misspelt = re.search(r"unknown field `(.*?)`", message)
    if not misspelt:
        return ""
    with_boards = kind is BoardScenario
    tables: list[type[ScenarioTable]]
    tables = (
        [*_tables(BoardScenarioTable), ScenarioCamera] if with_boards else _tables(ScenarioTable)
    )
    known = sorted({f for table in tables for f in table.__struct_fields__} | {"kind"})
    close = difflib.get_close_matches(misspelt[1], known, n=1)
    start = f'Did you mean "{close[0]}"? ' if close else ""
    example = "boards_turning" if with_boards else "example"
    return f"{start}The scenario {example}.toml shows every key."


def _tables(root: type[ScenarioTable]) -> list[type[ScenarioTable]]:
    """List every kind of table that a scenario may hold."""
    return root.__subclasses__()
