"""Readings that are not those of the robot in the pictures: refused, with what may be wrong."""

from pathlib import Path

import numpy as np

from verify.calibration.motion_adjust import Adjusted
from verify.calibration.motion_start import Start
from verify.errors import InputError

STRANGE_TURN = np.deg2rad(5.0)  # median; a degree of joint error makes one
STRANGE_PX = 10.0  # rms: a degree of joint error makes a few; these are another robot's readings


def refuse_other_robot(start: Start, folder: Path, robot: str) -> None:
    """Refuse readings that turn the flange otherwise than the LEDs on it turn, or mirrored.

    Args:
        start: base and LEDs in closed form, neither of them held.
        folder: the recording's.
        robot: as session.toml names it.

    Raises:
        InputError: the turns of readings and pictures differ by more than joint errors explain,
            or agree only with those of a mirror image.
    """
    turns = np.linalg.norm(start.solved.residual[start.good, 3:], axis=1)
    off = float(np.median(turns))
    check = (
        f'that "{robot}" is the robot that moved, and the order, signs and unit (degrees) of the '
        "columns in encoders.csv"
    )
    if off > STRANGE_TURN:
        raise InputError(
            folder,
            f"by its readings the flange turns otherwise than its LEDs, {np.rad2deg(off):.0f}° off "
            "(median)",
            f"{np.rad2deg(STRANGE_TURN):.0f}° are the worst that joint errors explain",
            f"Check {check}.",
        )
    if start.solved.mirrored:
        raise InputError(
            folder,
            "what moves together moves like a mirror image of what the readings say",
            "the LEDs themselves must be seen, and the readings be this robot's",
            f"Check {check}; or cover the shiny surface that shows the LEDs.",
        )


def refuse_far_off(adjusted: Adjusted, place: str) -> None:
    """Refuse readings that do not belong to what the pictures show.

    Raises:
        InputError: the LEDs are seen farther from where the readings put them than joint errors
            explain.
    """
    left = adjusted.predicted.residual[adjusted.spotted.used]
    rms = float(np.sqrt(np.mean(np.sum(left**2, axis=1)))) if len(left) else np.inf
    if rms > STRANGE_PX:
        raise InputError(
            place, f"the readings put the LEDs {rms:.0f} px (rms) from where they are seen",
            f"{STRANGE_PX:.0f} px are the worst that joint errors explain",
            "Check the robot's name, the readings' unit (degrees) and order, and the rig.",
        )  # fmt: skip
