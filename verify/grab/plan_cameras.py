"""An arm's planner among a rig's cameras, on fixed or on turning bases."""

from dataclasses import replace

import numpy as np

from robots import Arm
from robots.transforms import carry, invert
from verify.grab.cell_file import Cell
from verify.grab.plan import Planner, planner
from verify.grab.workspace import camera_places
from verify.records import Array
from verify.rig import Camera, Rig


def among_cameras(arm: Arm, cell: Cell, rig: Rig, *, turning: bool) -> Planner:
    """Put an arm into its cell, with the rig's cameras to keep away from.

    The optical centre of a turning camera goes round its base's axis: the arm keeps away from the
    whole circle, as it does from a point, by a clearance that is the circle's radius greater.

    Args:
        arm: see `planner`.
        cell: from grab.toml.
        rig: the cameras, and the robot's place.
        turning: the bases turn; else they stand as the rig says.

    Raises:
        InputError: see `planner`.
    """
    cameras = (rig.left, rig.right)
    if not turning:
        placed = [camera.rig_T_camera(camera.pan) for camera in cameras]
        return planner(arm, cell, camera_places(invert(rig.rig_T_base), placed))
    circles = [_circle(camera) for camera in cameras]
    wider = cell.moving.camera_clearance + max(radius for _, radius in circles)
    kept = replace(cell, moving=replace(cell.moving, camera_clearance=wider))
    middles = np.array([middle for middle, _ in circles])
    return planner(arm, kept, carry(invert(rig.rig_T_base), middles))


def _circle(camera: Camera) -> tuple[Array, float]:
    """Where a turning camera's optical centre goes: the circle's middle, rig, m, and its radius."""
    from_axis, axis = camera.mount[:3, 3], camera.pan_axis
    along = float(axis @ from_axis)
    return camera.pan_center + along * axis, float(np.linalg.norm(from_axis - along * axis))
