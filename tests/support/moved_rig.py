"""Rigs that were moved after calibration, and what they measure."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.drawn_rig import SPOT_SIGMA
from tests.support.scene import facing, move_camera, sight
from verify.core.fiducials import Marker
from verify.core.records import Array, Measurement
from verify.core.rig import Camera, Rig
from verify.measurement.pose import fit_pose


def poses(count: int, rng: np.random.Generator) -> list[Array]:
    found = []
    for _ in range(count):
        x, y, z = *rng.uniform(-0.1, 0.1, 2), rng.uniform(0.55, 0.7)
        pose = facing(x, y, z)
        pose[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.15, 3)).as_matrix() @ pose[:3, :3]
        found.append(pose)
    return found


def seen_by(
    true: tuple[Rig, Marker], believed_to_be: tuple[Rig, Marker], seed: int, count: int = 8
) -> list[Measurement]:
    """Visits seen by the true rig and measured with another."""
    rng = np.random.default_rng(seed)
    measurements = []
    for i, pose in enumerate(poses(count, rng)):
        left, right = sight(*true, pose, SPOT_SIGMA, rng)
        fit = fit_pose(left, right, *believed_to_be, pose)
        status = "measured" if fit.consistent else "outlier"
        measurements.append(Measurement(i, 5.0 * i, status, len(true[1]), fit, left, right))
    return measurements


def turned(camera: Camera, axis: int, angle_deg: float) -> Camera:
    return move_camera(camera, f"mount_r{'xyz'[axis]}_deg", np.deg2rad(angle_deg))


def stretched(rig: Rig, factor: float) -> Rig:
    """The rig with another baseline."""
    sides = [replace(c, pan_center=c.pan_center * factor) for c in (rig.left, rig.right)]
    return replace(rig, left=sides[0], right=sides[1])


def bumped(rig: Rig) -> dict[str, Rig]:
    return {
        "yaw": replace(rig, right=turned(rig.right, 1, 0.05)),
        "pitch": replace(rig, right=turned(rig.right, 0, -0.05)),
        "roll": replace(rig, right=turned(rig.right, 2, 0.15)),
        "baseline": stretched(rig, 1.005),
    }
