"""Distance of a calibration from a known rig, and its covariance."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.scene import move_camera
from verify.calibration.stereo.records import Calibration, covariance_in_si
from verify.core.records import Array
from verify.core.rig import Rig

STEP = 1e-6  # SI units and pixels: small against curvature, large against rounding
RANK = 1e-9  # eigenvalues of a correlation below this are a direction that is held


def left_T_right(rig: Rig) -> Array:
    """The right camera's pose in the left one, bases at the readings of the file."""
    left, right = (c.rig_T_camera(c.pan) for c in (rig.left, rig.right))
    relation: Array = np.linalg.inv(left) @ right
    return relation


def departure(rig: Rig, other: Rig) -> Array:
    """Lenses (fx, fy, cx, cy, k1, k2, p1, p2, k3 a side) and relation (m, rad), rig less other."""
    parts = []
    for one, two in ((rig.left, other.left), (rig.right, other.right)):
        parts.append((one.matrix - two.matrix)[[0, 1, 0, 1], [0, 1, 2, 2]])
        parts.append(one.distortion - two.distortion)
    one, two = left_T_right(rig), left_T_right(other)
    parts.append(one[:3, 3] - two[:3, 3])
    parts.append(Rotation.from_matrix(one[:3, :3] @ two[:3, :3].T).as_rotvec())
    return np.concatenate(parts)


def departure_covariance(found: Calibration) -> Array:
    """Covariance (24, 24) of `departure`, from the one in the rig file."""
    covariance = found.rig.covariance
    columns = [
        departure(moved(found.rig, name, STEP), moved(found.rig, name, -STEP)) / (2 * STEP)
        for name in covariance.parameters
    ]
    jacobian = np.stack(columns, axis=1)
    full: Array = jacobian @ covariance_in_si(covariance) @ jacobian.T
    return full


def moved(rig: Rig, name: str, step: float) -> Rig:
    """Move one parameter of the file."""
    side, _, key = name.partition(".")
    if side == "left":
        return replace(rig, left=move_camera(rig.left, key, step))
    return replace(rig, right=move_camera(rig.right, key, step))


def squared_distance(error: Array, covariance: Array) -> tuple[float, int]:
    """d² of an error (p,) whose covariance (p, p) may be singular, and its degrees of freedom."""
    sigma = np.sqrt(np.diag(covariance))
    stated = sigma > 0
    scaled = covariance[np.ix_(stated, stated)] / np.outer(sigma[stated], sigma[stated])
    size, directions = np.linalg.eigh(scaled)
    kept = size > RANK
    z = (directions.T @ (error[stated] / sigma[stated]))[kept] / np.sqrt(size[kept])
    return float(z @ z), int(kept.sum())
