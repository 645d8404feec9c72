"""Options that several commands share, worded once.

What a run is asked for beside its source: tolerances and durations, in users' units.
"""

import math
import re
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer

from verify.errors import InputError
from verify.io.session.keys import Tolerance

JointTolerance = Annotated[
    str | None,
    typer.Option(
        "--tolerance",
        help="Joint errors allowed, degrees: one number, or one a joint: 0.2,0.2,…",
    ),
]
PositionTolerance = Annotated[
    float | None, typer.Option("--position-tolerance", help="Position error allowed, mm.")
]
OrientationTolerance = Annotated[
    float | None,
    typer.Option("--orientation-tolerance", help="Orientation error allowed, degrees."),
]
PagePort = Annotated[
    int, typer.Option(min=0, max=65535, help="The page's port; 0: any that is free.")
]
PageAddress = Annotated[
    str, typer.Option(help="The page's address; another one than this needs a token.")
]
PageToken = Annotated[
    str | None, typer.Option(help="What viewers must show; 16 characters or more.")
]


_SECONDS_PER_UNIT = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}


@dataclass(frozen=True, slots=True)
class Asked:
    """Tolerances as they were typed; None where nothing was."""

    joints_deg: str | None
    position_mm: float | None
    orientation_deg: float | None

    def tolerance(self, joints: int) -> Tolerance:
        """Turn them into metres and radians for an arm with so many joints.

        Raises:
            InputError: not a positive number, or too few of them.
        """
        given = (
            None if self.joints_deg is None else np.deg2rad(_parse_numbers(self.joints_deg, joints))
        )
        for name, value in (
            ("--position-tolerance", self.position_mm),
            ("--orientation-tolerance", self.orientation_deg),
        ):
            if value is not None:
                _require_positive(name, value, "a tolerance")
        position, orientation = self.position_mm, self.orientation_deg
        return Tolerance(
            joints=given,
            position=None if position is None else position * 1e-3,
            orientation=None if orientation is None else float(np.deg2rad(orientation)),
        )


def parse_duration(option: str, text: str) -> float:
    """Read a duration such as 60s, 10m, 1.5h, or a number of seconds.

    Raises:
        InputError: it is none.
    """
    found = re.fullmatch(r"\s*([0-9.]+)\s*([a-z]*)\s*", text)
    try:
        if found is None:
            raise ValueError
        value = float(found[1]) * _SECONDS_PER_UNIT[found[2]]
    except (ValueError, KeyError):
        raise InputError(
            option, f'"{text}" is no duration', "seconds, minutes or hours", "Example: 10m"
        ) from None
    _require_positive(option, value, "a duration")
    return value


def _parse_numbers(text: str, joints: int) -> list[float]:
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(
            "--tolerance", f'"{text}" is not a number of degrees',
            f"one number is asked for, or {joints} with commas between", "Example: 0.2",
        ) from None  # fmt: skip
    for value in values:
        _require_positive("--tolerance", value, "a tolerance")
    if len(values) == 1:
        values = values * joints
    if len(values) != joints:
        raise InputError(
            "--tolerance", f"{len(values)} numbers were given",
            f"the robot has {joints} joints", "Give one number, or one a joint.",
        )  # fmt: skip
    return values


def _require_positive(name: str, value: float, what: str) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(name, f"{value:g} was given", f"{what} is greater than 0", "")
