"""Poses that cannot be what the file says: metres for millimetres, a scalar that comes last."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.clock import ClockEstimate, estimate_clock
from verify.errors import InputError
from verify.instrument import noise_of, see_poses
from verify.poses_file import Poses
from verify.readings import Readings
from verify.session import Instrument, Session
from verify.track import Track

# Two poses are called the same arm in the same place within this; a gross fault stays below it,
# a wrong unit or order does not.
CLOSE = (0.05, np.deg2rad(8.0))  # m, rad
POINTS_CLOSE = 0.1  # m: of a position alone the readings' own turn moves the point, too


def refuse_misread(
    session: Session,
    instrument: Instrument,
    track: Track,
    readings: Readings,
    clock: ClockEstimate,
) -> None:
    """Refuse poses that agree with the readings in another unit or order, and not as written.

    Args:
        session: whose robot was measured.
        instrument: its poses as written.
        track: the same, as taken.
        readings: the robot's own.
        clock: theirs, as the poses as written show it.

    Raises:
        InputError: positions in metres, or quaternions whose scalar comes last.
    """
    if _agree(session, track, readings, clock.offset):
        return
    for poses, found, expected, remedy in _otherwise(instrument.poses):
        other = replace(instrument, poses=poses)
        tried = see_poses(session, other, readings, noise_of(other)).track
        offset = clock.offset
        if session.clock is None:
            offset = estimate_clock(tried, session.arm, readings).offset
        if _agree(session, tried, readings, offset):
            raise InputError(session.left.path, found, expected, remedy)


def _otherwise(poses: Poses) -> list[tuple[Poses, str, str, str]]:
    """The usual mistakes: the poses as they would be without, and what to say of it."""
    found = [
        (
            replace(poses, position=poses.position * 1e3),
            "the positions agree with the readings as metres and not as millimetres",
            "millimetres are asked for (x_mm, y_mm, z_mm)",
            "Multiply them by 1000.",
        )
    ]
    if poses.rotation is not None:
        as_written = np.roll(Rotation.from_matrix(poses.rotation).as_quat(), 1, axis=1)
        found.append(
            (
                replace(poses, rotation=Rotation.from_quat(as_written).as_matrix()),
                "the quaternions agree with the readings if their scalar comes last",
                "the columns qw, qx, qy, qz name each number",
                "Put the names in the order in which the numbers stand.",
            )
        )
    return found


def _agree(session: Session, track: Track, readings: Readings, offset: float) -> bool:
    """Whether half the poses lie close to where the readings put them."""
    known = readings.known(track.t - offset)
    if not known.any():
        return False
    poses = robots.forward(session.arm, readings.at((track.t - offset)[known]))
    measured = track.base_T_flange[known]
    distance = np.linalg.norm(poses[:, :3, 3] - measured[:, :3, 3], axis=1)
    if track.known_dof.min() < 6:
        return bool(np.mean(distance < POINTS_CLOSE) >= 0.5)
    turn = poses[:, :3, :3] @ np.swapaxes(measured[:, :3, :3], 1, 2)
    near = (distance < CLOSE[0]) & (Rotation.from_matrix(turn).magnitude() < CLOSE[1])
    return bool(np.mean(near) >= 0.5)
