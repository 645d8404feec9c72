"""Joint readings of another program: which column is which joint, and whether the unit is right."""

import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import robots
from verify.core.records import Array
from verify.errors import InputError
from verify.io.toml import listed

MAX_BEYOND = np.deg2rad(5.0)  # beyond a limit: an encoder may be off, and its arm at its end
DEGREES, RADIANS = "deg", "rad"
ANGLE_UNITS = {DEGREES: np.pi / 180, RADIANS: 1.0}  # rad

_NUMBERED = re.compile(r"(?P<stem>.*?)(?P<number>\d+)(?P<end>\D*)$")


def match_joint_names(
    place: str | Path, names: Sequence[str], arm: robots.Arm, given: Sequence[str] = ()
) -> tuple[str, ...]:
    """Find the name of each of the arm's joints, in its order, among the names of a recording.

    `given` are the user's own, in the arm's order. Else the URDF's names, alone or behind a
    prefix, and then names that count from 1 or from 0, like joint_1 … joint_6.

    Raises:
        InputError: not every joint has one name; lists the names that there are.
    """
    if given:
        return _given_names(place, names, arm, given)
    if isinstance(arm, robots.UrdfArm) and (own := _by_ending(names, arm.joint_names)):
        return own
    if (counted := _counted(names, arm.dof)) is not None:
        return counted
    wanted = f"{arm.name} has {arm.dof} joints"
    if isinstance(arm, robots.UrdfArm):
        wanted += f": {', '.join(arm.joint_names)}"
    remedy = "Give their names in the robot's order: --joint-names NAME1,NAME2,…"
    raise InputError(place, f"has the joints {listed(names)}", wanted, remedy)


def _given_names(
    place: str | Path, names: Sequence[str], arm: robots.Arm, given: Sequence[str]
) -> tuple[str, ...]:
    if len(given) != arm.dof or len(set(given)) != arm.dof:
        expected = f"{arm.name} has {arm.dof} joints, each with a name of its own"
        raise InputError("--joint-names", f"names {len(set(given))}", expected)
    if missing := [name for name in given if name not in names]:
        found = f'"{missing[0]}" does not stand in {place}'
        raise InputError("--joint-names", found, f"it has {listed(names)}")
    return tuple(given)


def _by_ending(names: Sequence[str], wanted: Sequence[str]) -> tuple[str, ...]:
    """Names that are the URDF's, or end with them behind one common prefix; () if any is not."""
    if set(wanted) <= set(names):
        return tuple(wanted)
    prefixes = {name[: -len(wanted[0])] for name in names if name.endswith(wanted[0])}
    whole = [p for p in prefixes if all(f"{p}{joint}" in names for joint in wanted)]
    return tuple(f"{whole[0]}{joint}" for joint in wanted) if len(whole) == 1 else ()


def _counted(names: Sequence[str], joints: int) -> tuple[str, ...] | None:
    """The one family of names that counts the joints from 1 or from 0."""
    families: dict[tuple[str, str], dict[int, str]] = defaultdict(dict)
    for name in names:
        if parts := _NUMBERED.fullmatch(name):
            families[parts["stem"], parts["end"]][int(parts["number"])] = name
    found = [
        tuple(family[number] for number in sorted(family))
        for family in families.values()
        if sorted(family) in (list(range(joints)), list(range(1, joints + 1)))
    ]
    return found[0] if len(found) == 1 else None


class JointRange:
    """The least and the greatest reading of each joint so far, in the recording's own unit."""

    def __init__(self, joints: int) -> None:
        self.least = np.full(joints, np.inf)  # (n,)
        self.greatest = np.full(joints, -np.inf)

    def add(self, values: Array) -> None:
        """Take in one reading (n,) or several (m, n)."""
        rows = values.reshape(-1, len(self.least))
        self.least = np.minimum(self.least, rows.min(axis=0))
        self.greatest = np.maximum(self.greatest, rows.max(axis=0))

    def _beyond(self, arm: robots.Arm, unit: str) -> Array:
        """How far the readings in this unit lie beyond the arm's limits, (n,), rad."""
        scale = ANGLE_UNITS[unit]
        return np.maximum(arm.lower - self.least * scale, self.greatest * scale - arm.upper)

    def require_within(
        self, place: str | Path, arm: robots.Arm, names: Sequence[str], unit: str,
        option: str = "--angles",
    ) -> None:  # fmt: skip
        """Refuse readings beyond the arm's limits; the InputError names a unit that would fit.

        `option` is the one that states the unit.
        """
        beyond = self._beyond(arm, unit)
        joint = int(np.argmax(beyond))
        if beyond[joint] <= MAX_BEYOND:
            return
        in_degrees = np.rad2deg(ANGLE_UNITS[unit])
        least, most = (float(v[joint] * in_degrees) for v in (self.least, self.greatest))
        low, high = np.rad2deg([arm.lower[joint], arm.upper[joint]]).tolist()
        found = f"{names[joint]} in {unit} runs from {least:.5g}° to {most:.5g}°"
        expected = f"joint {joint + 1} of {arm.name} turns from {low:.5g}° to {high:.5g}°"
        other = RADIANS if unit == DEGREES else DEGREES
        remedy = "Check the robot, the order of the joints and the unit."
        if (self._beyond(arm, other) <= MAX_BEYOND).all():
            remedy = f"All readings fit in {other}: if that is their unit, give {option} {other}."
        raise InputError(place, found, expected, remedy)
