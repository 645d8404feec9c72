"""A station file to begin with: every key explained, for a robot and a driver of its encoders."""

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path

import robots
from verify.errors import InputError
from verify.io.files import restated
from verify.io.session.folder import ROBOT_FILES
from verify.io.toml import did_you_mean
from verify.live.station import file
from verify.live.station.devices import ENCODER_KEYS

SIM_ROBOT = "rv_3sd_melfa"  # of the file as it stands
# keys that a driver needs, and what it would take for granted and is as a rule otherwise
_SWITCHED_ON = {"driver", "port", "columns", "time_unit", "path", "joint_names", "nodes", "topic"}
_HEAD = "As it stands every device is simulated, and it runs. Replace"


@dataclass(frozen=True, slots=True)
class StationTemplate:
    """A station file, and what to do with it in a sentence with {path}."""

    text: str
    note: str


def joint_names(arm: robots.Arm | int) -> tuple[str, ...]:
    """Names of an arm's joints: its URDF's, else joint_1 to joint_N."""
    if isinstance(arm, robots.UrdfArm):
        return arm.joint_names
    dof = arm if isinstance(arm, int) else arm.dof
    return tuple(f"joint_{joint}" for joint in range(1, dof + 1))


def station_template(
    robot: str, driver: str | None, scenario: str | None, folder: Path
) -> StationTemplate:
    """Make a station file; without a driver its encoders are simulated.

    Args:
        robot: a name, or the path of a robot file or URDF.
        driver: one of the keys of ENCODER_KEYS.
        scenario: the built-in one that simulates this robot's cameras; None: there is none.
        folder: of the station file, from which it names files.

    Raises:
        InputError: no such robot or driver, or nothing simulates this robot's encoders.
    """
    if driver is not None and driver not in ENCODER_KEYS:
        known = tuple(ENCODER_KEYS)
        remedy = f"Name one of them.{did_you_mean(driver, known)}"
        raise InputError("--driver", f'is "{driver}"', f"known are {', '.join(known)}", remedy)
    with restated(robots.RobotError, place="--robot"):
        arm = robots.load(robot)
    text = file.template()
    if robot != SIM_ROBOT:
        named = os.path.relpath(robot, folder) if Path(robot).suffix in ROBOT_FILES else robot
        comment = "# a name from `verify robots`, or the path of a robot file or URDF"
        text = _with(text, "robot", named, comment)
    if driver not in (None, "sim"):
        text = _with_driver(text, str(driver), arm)
    if scenario is not None:
        text = re.sub(r'(?m)^scenario = "\w+"', f'scenario = "{scenario}"', text)
        if driver in (None, "sim"):
            note = "{path} runs as it is, with simulated devices: verify run {path} --for 20s"
            return StationTemplate(text, note)
        note = "{path}: name the encoders' address in it, then try it: verify doctor {path}"
        head = "As it stands its cameras are simulated, and its encoders are not. Replace"
        return StationTemplate(text.replace(_HEAD, head, 1), note)
    if driver in (None, "sim"):
        expected = "only the robots of the built-in scenarios are"
        remedy = "Add --driver, such as --driver rtde."
        raise InputError("--robot", f'"{robot}" is not simulated', expected, remedy)
    note = "{path}: name cameras, rig, marker and address in it, then try it: verify doctor {path}"
    return StationTemplate(_with_own_cameras(text), note)


def _with_driver(text: str, driver: str, arm: robots.Arm) -> str:
    """Switch one driver's block on in [encoders], and leave the others' out."""
    begin = text.index("[encoders]")
    end = text.index("\n# ------", begin)
    common, *blocks = text[begin:end].strip().split("\n\n")
    chosen = next(block for block in blocks if block.startswith(f'# driver = "{driver}"'))
    lines = common.splitlines()
    kept = [line for line in lines if not line.startswith(("driver", "rate_hz", " "))]
    numbers = range(1, arm.dof + 1)
    lists = {
        "joint_names": joint_names(arm),
        "nodes": [f"ns=2;s=Axis{joint}.Position" for joint in numbers],
        "columns": ["t", *(f"q{joint}" for joint in numbers)],
    }
    switched_on = []
    for line in chosen.splitlines():
        key, _, value = line.removeprefix("# ").partition(" = ")
        value, _, comment = value.partition("#")
        comment = f"# {comment.strip()}" if comment else ""
        if key in lists or key in _SWITCHED_ON:
            switched_on.append(_line(key, lists.get(key, json.loads(value)), comment))
        else:
            kept.append(line)
    kept[1:1] = switched_on
    return text[:begin] + "\n".join(kept) + "\n" + text[end:]


def _line(key: str, value: object, comment: str) -> str:
    """Write a key as the file does; what JSON says of texts and lists of texts is TOML."""
    return (f"{key} = {json.dumps(value)}".ljust(33) + f" {comment}").rstrip()


def _with(text: str, key: str, value: object, comment: str) -> str:
    """Replace the first line that states a key."""
    line = _line(key, value, comment)
    return re.sub(rf"(?m)^{key} = .*", lambda _: line, text, count=1)


def _with_own_cameras(text: str) -> str:
    """Have cameras, rig and marker that are not simulated."""
    for key in ("rig", "marker"):
        text = _with(text, key, f"{key}.toml", "# from `verify calibrate`: docs/calibration.md")
    for number in (0, 1):
        text = text.replace('source = "sim"    ', f"source = {number}        ", 1)
        text = text.replace('source = "sim"\n', f"source = {number}\n", 1) if number else text
    text = re.sub(r"(?ms)^# -+ simulation\n.*", "", text)
    head = "Nothing in it is simulated: the cameras are calibrated first. Replace"
    return text.replace(_HEAD, head, 1)
