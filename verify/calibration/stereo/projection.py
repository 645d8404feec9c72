"""Steps in which the boards go with the cameras that see them.

Turning the whole rig against its own baseline is what pictures of boards tell least of. In the
rig's frame such a turn sweeps every board along an arc, and a straight step leaves the arc at
once. A board that keeps its place before its camera stays in that camera's picture however far
the camera is moved; only what the step wants beyond that is then added, straight.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from verify.calibration.stereo.parameters import (
    N_CAMERA_PARAMETERS,
    PAR_AXIS,
    PAR_CENTER,
    PAR_OFFSET,
    PAR_TURN,
    PAR_ZERO,
    BundleState,
    CornerStack,
    base_rotations,
    step_camera,
    step_poses,
)
from verify.core.records import Array
from verify.core.rig import Camera


def step_state(state: BundleState, corners: CornerStack, change: Array, own: Array) -> BundleState:
    """Step all unknowns at once.

    Args:
        state: where to step from.
        corners: what was seen; says by which camera.
        change: (44,), of the rig's parameters.
        own: (b, 8), of each board's pose in rig axes and of the bases' departures from their
            readings, as a straight step has them.

    Returns:
        The state a step on: to first order the straight one.
    """
    changes = (change[:N_CAMERA_PARAMETERS], change[N_CAMERA_PARAMETERS:])
    errors = state.pan_error + own[:, 6:]
    cameras = _cameras(state, changes, corners.pan.mean(axis=0))
    boards, beyond = state.boards.copy(), own[:, :6].copy()
    host = _hosts(corners, len(boards))
    for side, (old, new, d) in enumerate(zip(state.cameras, cameras, changes, strict=True)):
        mine = host == side
        before = corners.pan[mine, side] + state.pan_error[mine, side]
        after = corners.pan[mine, side] + errors[mine, side]
        there = camera_poses(new, after) @ np.linalg.inv(camera_poses(old, before))
        beyond[mine] -= _motion(old, before, after - before, d, boards[mine, :3, 3])
        boards[mine] = there @ boards[mine]
    return BundleState(*cameras, step_poses(boards, beyond), errors)


def _cameras(state: BundleState, changes: tuple[Array, Array], pan: Array) -> tuple[Camera, Camera]:
    """Step both cameras; the right one goes with the left one, at their middle readings (2,)."""
    left, right = (step_camera(c, d) for c, d in zip(state.cameras, changes, strict=True))
    at_left, at_right = pan[:1], pan[1:]
    before = camera_poses(state.right, at_right)
    there = camera_poses(left, at_left) @ np.linalg.inv(camera_poses(state.left, at_left))
    still = np.zeros(1)
    straight = _motion(state.right, at_right, still, changes[1], before[:, :3, 3])
    with_left = _motion(state.left, at_left, still, changes[0], before[:, :3, 3])
    wanted = step_poses(there @ before, straight - with_left)
    turntable = camera_poses(right, at_right) @ np.linalg.inv(right.mount)
    return left, replace(right, mount=(np.linalg.inv(turntable) @ wanted)[0])


def _hosts(corners: CornerStack, count: int) -> NDArray[np.int64]:
    """The camera that each board goes with: the left one, if it saw the board."""
    host = np.ones(count, dtype=np.int64)
    host[corners.board[corners.camera == 0]] = 0
    return host


def camera_poses(camera: Camera, pan: Array) -> Array:
    """Place a camera for readings (b,), rad: rig_T_camera (b, 4, 4)."""
    turned = np.tile(np.eye(4), (len(pan), 1, 1))
    turned[:, :3, :3] = base_rotations(camera, pan)
    turned[:, :3, 3] = camera.pan_center
    placed_there: Array = turned @ camera.mount
    return placed_there


def _motion(camera: Camera, pan: Array, turned_on: Array, change: Array, points: Array) -> Array:
    """How a step of a camera carries points (b, 3) that go with it, to first order, (b, 6)."""
    placed_there = camera_poses(camera, pan)
    turned = placed_there[:, :3, :3] @ camera.mount[:3, :3].T
    about_center = change[PAR_AXIS] - turned @ change[PAR_AXIS]
    about_center = about_center + (change[PAR_ZERO] + turned_on)[:, None] * camera.pan_axis
    about_camera = turned @ change[PAR_TURN]
    shift = (
        change[PAR_CENTER]
        + turned @ change[PAR_OFFSET]
        + _cross(about_center, points - camera.pan_center)
        + _cross(about_camera, points - placed_there[:, :3, 3])
    )
    return np.concatenate([shift, about_center + about_camera], axis=1)


def _cross(turn: Array, arm: Array) -> Array:
    """Cross products of vectors (b, 3)."""
    (x, y, z), (u, v, w) = turn.T, arm.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
