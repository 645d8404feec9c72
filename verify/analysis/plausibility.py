"""Refuse readings and poses in other units, another sense or order than their file states.

Radians for degrees, metres for millimetres, a column reversed: what is wrong as written and agrees
once it is converted is refused, with the remedy.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.instrument import measure_poses, stated_noise
from verify.analysis.measured import session_clock
from verify.analysis.mistakes import pose_mistakes
from verify.core.readings import Readings
from verify.errors import InputError
from verify.io.session.poses import Instrument
from verify.io.session.session import Session
from verify.measurement.track import Track

FULL_TURN = 2 * np.pi
# Two poses count as the same arm in the same place within this; a gross fault stays below it,
# angles in the wrong unit or coordinates in the wrong unit or order do not.
MAX_POSE_DIFFERENCE = (0.05, np.deg2rad(8.0))  # m, rad
MAX_POINT_DIFFERENCE = 0.1  # m: of a position alone the readings' own turn moves the point, too
MIN_AGREEING = 0.9  # of the poses: where a flange points down, half may agree by chance


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
    if _poses_agree(session.arm, track, readings, clock.offset):
        return
    radians = Readings(readings.t, as_written)
    offset = session_clock(session, track, radians).offset
    if _poses_agree(session.arm, track, radians, offset):
        raise InputError(
            session.folder / "encoders.csv",
            "the q columns agree with what was measured as radians and not as degrees",
            "degrees are expected (q1_deg, …)",
            "Multiply them by 180/π, or export again in degrees.",
        )


def refuse_misread(
    session: Session, instrument: Instrument, track: Track, readings: Readings, clock: ClockEstimate
) -> None:
    """Refuse positions alone that agree with the readings in another unit or sense.

    The track is of the poses as written, and the clock as these show it.

    Raises:
        InputError: positions in metres, or a column reversed.
    """
    places_alone = bool(track.known_dof.min() < 6)
    if not places_alone or _poses_agree(
        session.arm, track, readings, clock.offset, places_alone=True
    ):
        return
    poses = instrument.poses
    for name, remedy, without in pose_mistakes(poses.transforms, alone=True):
        other = replace(instrument, poses=replace(poses, position=without[:, :3, 3]))
        tried = measure_poses(session, other, readings, stated_noise(other)).track
        offset = session_clock(session, tried, readings).offset
        if _poses_agree(session.arm, tried, readings, offset, places_alone=True):
            found = f"the poses do not agree with the readings; {name} fits"
            raise InputError(session.left.path, found, "millimetres, as the columns say", remedy)


def _poses_agree(
    arm: robots.Arm, track: Track, readings: Readings, offset: float, *, places_alone: bool = False
) -> bool:
    """Whether the poses, or their places alone, lie close to where the readings put them."""
    known = readings.available(track.t - offset)
    if not known.any():
        return False
    poses = robots.forward(arm, readings.at((track.t - offset)[known]))
    measured = track.base_T_flange[known]
    distance = np.linalg.norm(poses[:, :3, 3] - measured[:, :3, 3], axis=1)
    if places_alone:
        return bool(np.mean(distance < MAX_POINT_DIFFERENCE) >= MIN_AGREEING)
    turn = poses[:, :3, :3] @ np.swapaxes(measured[:, :3, :3], 1, 2)
    near = (distance < MAX_POSE_DIFFERENCE[0]) & (
        Rotation.from_matrix(turn).magnitude() < MAX_POSE_DIFFERENCE[1]
    )
    return bool(np.mean(near) >= MIN_AGREEING)
