"""Which arms are known, and how a name or a path becomes one."""

import difflib
import re
from importlib import metadata
from pathlib import Path

from robots import definition, urdf
from robots.arm import Arm
from robots.errors import RobotError

MAX_BYTES = 10_000_000  # of a robot file; the largest known URDF has 0.2 MB
HERE = Path(__file__).parent
EXAMPLES = {  # the fixed arms among example-robot-data's robots
    "kinova": "kinova_description/robots/kinova.urdf",
    "panda": "panda_description/urdf/panda.urdf",
    "talos_left_arm": "talos_data/robots/talos_left_arm.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "z1": "z1_description/urdf/z1.urdf",
}


def names() -> list[str]:
    """List the arms that come with a robot file of ours, all with a closed form."""
    return sorted(path.stem for path in HERE.glob("*.toml"))


def example_names() -> list[str]:
    """List the arms that example-robot-data brings as URDF."""
    return sorted(EXAMPLES)


def load(
    name_or_path: str,
    *,
    base: str | None = None,
    tip: str | None = None,
) -> Arm:
    """Load an arm by its name, or by the path of a robot file (.toml) or a URDF (.urdf).

    For a URDF: `base` is the link to count from, by default its first; `tip` the link that is the
    flange, by default the last of its chain.

    Raises:
        RobotError: no such arm, or its file cannot be used.
    """
    path = Path(name_or_path)
    if path.suffix in {".urdf", ".toml"}:
        _require_plain_file(path)
    if path.suffix == ".urdf":
        return urdf.read(path, base, tip, path.stem, f"URDF {path.name}")
    known = [*names(), *example_names()]
    name = {_plain(name): name for name in known}.get(_plain(name_or_path))  # UR5, rv-3sd melfa
    if name in EXAMPLES:
        relative = EXAMPLES[name]
        source = f"example-robot-data {metadata.version('example-robot-data')}, {relative}"
        return urdf.read(example(relative), base, tip, name, source)
    if base or tip:
        remedy = "Leave out [robot_frames], or base and tip."
        raise RobotError(name_or_path, "base and tip named", "only a URDF has links", remedy)
    if path.suffix == ".toml":
        return definition.read(path)
    if name is not None:
        return definition.read(HERE / f"{name}.toml")
    near = difflib.get_close_matches(name_or_path.lower(), known, n=1)
    found = "is not known" + (f', did you mean "{near[0]}"?' if near else "")
    remedy = "Or give the path of a robot file (.toml) or a URDF (.urdf)."
    raise RobotError(f'robot "{name_or_path}"', found, f"known are {', '.join(known)}", remedy)


def _plain(name: str) -> str:
    """A name without case, spaces, dashes and underscores."""
    return re.sub(r"[\s_-]", "", name).lower()


def _require_plain_file(path: Path) -> None:
    """Raise RobotError unless there is a plain file of a robot's size."""
    try:
        size = path.stat().st_size
    except (OSError, ValueError) as error:  # a zero byte in the name
        found = getattr(error, "strerror", None) or str(error)
        raise RobotError(path, found, "", "Check the path, or name a known robot.") from error
    if not path.is_file():
        raise RobotError(path, "is not a plain file", "a robot file is expected", "Name the file.")
    if size > MAX_BYTES:
        expected = f"a robot file has at most {MAX_BYTES}"
        raise RobotError(path, f"has {size} bytes", expected, "Name the right file.")


def example(relative: str) -> Path:
    """Locate a file of example-robot-data, which since version 6 is a package without a module."""
    share = "cmeel.prefix/share/example-robot-data/robots"
    located = metadata.distribution("example-robot-data").locate_file(f"{share}/{relative}")
    return Path(str(located))
