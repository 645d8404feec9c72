"""Scenario files: the built-in ones by name, any other by path; decoded strictly."""

import difflib
from pathlib import Path

import msgspec

from verify.errors import InputError
from verify.io import toml
from verify.io.session.folder import ROBOT_FILES
from verify.simulation.scenario import BoardScenario, MultiJoint, Scenario

FOLDER = Path(__file__).with_name("scenarios")
BOARDS = "boards_"  # begins the names of the built-in scenarios that have boards, not a robot


def names() -> list[str]:
    """List the built-in scenarios that make a session."""
    return [name for name in _built_in() if not name.startswith(BOARDS)]


def scenario_of(robot: str) -> str | None:
    """Name the built-in scenario in which all joints of this robot move; None: there is none."""
    for name in names():
        scenario = load(name)
        if (
            isinstance(scenario, Scenario)
            and scenario.robot == robot
            and isinstance(scenario.motion, MultiJoint)
        ):
            return name
    return None


def _built_in() -> list[str]:
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load(name_or_path: str) -> Scenario | BoardScenario:
    """Read a scenario: a built-in one's name, or the path of a TOML file.

    A robot that a file names by a path is looked for beside that file. A file with `[boards]`
    makes board pictures instead of a session.

    Raises:
        InputError: no such scenario, not TOML, a key that is not known, or a value out of range.
    """
    built_in = _built_in()
    path = FOLDER / f"{name_or_path}.toml" if name_or_path in built_in else Path(name_or_path)
    if not path.is_file():
        close = difflib.get_close_matches(name_or_path, built_in, n=1)
        raise InputError(
            "scenario",
            f'"{name_or_path}" is neither a built-in scenario nor a file',
            f'did you mean "{close[0]}"?' if close else "",
            f"Known: {', '.join(built_in)}. Or give the path of a scenario file.",
        )
    boards = "boards" in toml.parse(path)
    kind: type[Scenario] | type[BoardScenario] = BoardScenario if boards else Scenario
    try:
        scenario, _ = toml.decode(path, kind)
    except InputError as error:
        example = "boards_turning" if boards else "example"
        remedy = f"{error.remedy} The scenario {example}.toml shows every key."
        raise InputError(error.place, error.found, error.expected, remedy) from error
    if isinstance(scenario, Scenario) and Path(scenario.robot).suffix in ROBOT_FILES:
        return msgspec.structs.replace(scenario, robot=str(path.parent / scenario.robot))
    return scenario
