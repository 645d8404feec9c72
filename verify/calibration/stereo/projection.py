"""Parameter steps in which each board keeps its place before a camera.

The parameters are those of `parameters`. Images of boards determine least of all a rotation of the
rig against its own baseline; in the rig frame it carries every board along an arc that a straight
step leaves at once. So a board moves with its camera, exactly,

    rig_T_board' = exp(d - J D) (rig_T_camera' camera_T_rig) rig_T_board

with the board's own step d, the step D of the camera's parameters and the first-order motion J D
that carrying the board along already gives it.
"""

from dataclasses import replace

import numpy as np

from verify.calibration.stereo.parameters import (
    BOW,
    PAN_ERRORS,
    PAR_AXIS,
    PAR_CENTER,
    PAR_OFFSET,
    PAR_TURN,
    PAR_ZERO,
    BundleState,
    CornerStack,
    base_rotations,
    camera_columns,
    step_camera,
    step_poses,
)
from verify.core.records import Array
from verify.core.rig import Camera


def step_state(state: BundleState, corners: CornerStack, change: Array, own: Array) -> BundleState:
    """Step the shared parameters by (47,) and each board's own by (b, 14), all at once.

    Its own are the board's pose in rig axes and its errors. To first order the step is straight.
    """
    changes = (change[camera_columns(0)], change[camera_columns(1)])
    errors = state.errors + own[:, 6:]
    cameras = _cameras(state, changes, corners.pan.mean(axis=0))
    boards, beyond = state.boards.copy(), own[:, :6].copy()
    host = np.ones(len(boards), dtype=np.int64)  # the camera that each board moves with
    host[corners.board[corners.camera == 0]] = 0  # the left one, where it saw the board
    for side, (old, new, d) in enumerate(zip(state.cameras, cameras, changes, strict=True)):
        mine = host == side
        before = corners.pan[mine, side] + state.pan_error[mine, side]
        after = corners.pan[mine, side] + errors[mine, PAN_ERRORS][:, side]
        carried = camera_poses(new, after) @ np.linalg.inv(camera_poses(old, before))
        beyond[mine] -= _motion(old, before, after - before, d, boards[mine, :3, 3])
        boards[mine] = carried @ boards[mine]
    return BundleState(*cameras, step_poses(boards, beyond), errors, state.bow + change[BOW])


def _cameras(state: BundleState, changes: tuple[Array, Array], pan: Array) -> tuple[Camera, Camera]:
    """Step both cameras; the right one moves with the left one, at the mean readings (2,)."""
    left, right = (step_camera(c, d) for c, d in zip(state.cameras, changes, strict=True))
    at_left, at_right = pan[:1], pan[1:]
    before = camera_poses(state.right, at_right)
    carried = camera_poses(left, at_left) @ np.linalg.inv(camera_poses(state.left, at_left))
    still = np.zeros(1)
    straight = _motion(state.right, at_right, still, changes[1], before[:, :3, 3])
    with_left = _motion(state.left, at_left, still, changes[0], before[:, :3, 3])
    wanted = step_poses(carried @ before, straight - with_left)
    turntable = camera_poses(right, at_right) @ np.linalg.inv(right.mount)
    return left, replace(right, mount=(np.linalg.inv(turntable) @ wanted)[0])


def camera_poses(camera: Camera, pan: Array) -> Array:
    """Place a camera for readings (b,), rad: rig_T_camera (b, 4, 4)."""
    turned = np.tile(np.eye(4), (len(pan), 1, 1))
    turned[:, :3, :3] = base_rotations(camera, pan)
    turned[:, :3, 3] = camera.pan_center
    return turned @ camera.mount


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
