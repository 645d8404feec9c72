"""Readings that cannot be what the file says: degrees that are radians."""

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.clock import ClockEstimate, estimate_clock
from verify.errors import InputError
from verify.readings import Readings
from verify.records import Array
from verify.session import Session
from verify.track import Track

FULL_TURN = 2 * np.pi
# Two poses are called the same arm in the same place within this; a gross fault stays below it,
# angles in the wrong unit do not.
CLOSE = (0.05, np.deg2rad(8.0))  # m, rad


def refuse_radians(
    session: Session, track: Track, readings: Readings, clock: ClockEstimate
) -> None:
    """Refuse readings that agree with the pictures as radians and not as degrees.

    Raises:
        InputError: encoders.csv holds radians in its _deg columns.
    """
    as_written = np.rad2deg(readings.q)  # the numbers in the file
    if float(np.abs(as_written).max()) > FULL_TURN:
        return
    if _agree(track, session.arm, readings, clock.offset):
        return
    radians = Readings(readings.t, as_written)
    offset = clock.offset
    if session.clock is None:
        offset = estimate_clock(track, session.arm, radians).offset
    if _agree(track, session.arm, radians, offset):
        raise InputError(
            session.folder / "encoders.csv",
            "the q columns agree with what was measured as radians and not as degrees",
            "degrees are asked for (q1_deg, …)",
            "Multiply them by 180/π, or export again in degrees.",
        )


def _agree(track: Track, arm: robots.Arm, readings: Readings, offset: float) -> bool:
    """Whether half the pairs lie close to where the readings put them."""
    known = readings.known(track.t - offset)
    if not known.any():
        return False
    poses = robots.forward(arm, readings.at((track.t - offset)[known]))
    measured: Array = track.base_T_flange[known]
    distance = np.linalg.norm(poses[:, :3, 3] - measured[:, :3, 3], axis=1)
    turn = poses[:, :3, :3] @ np.swapaxes(measured[:, :3, :3], 1, 2)
    angle = Rotation.from_matrix(turn).magnitude()
    return bool(np.mean((distance < CLOSE[0]) & (angle < CLOSE[1])) >= 0.5)
