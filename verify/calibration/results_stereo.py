"""How the two cameras stand to each other, with uncertainties carried over from the rig's."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from verify.calibration.covariance import in_si
from verify.calibration.quality_derivatives import by_parameters
from verify.records import Array
from verify.rig import Rig

MM, DEG = 1e3, 180 / np.pi


def stereo(rig: Rig, pan: Array) -> dict[str, Any]:
    """Baseline, convergence, and the right camera's place in the left one, at two pan readings."""

    def relation(moved: Rig) -> Array:
        left = moved.left.rig_T_camera(float(pan[0]))
        left_T_right = np.linalg.inv(left) @ moved.right.rig_T_camera(float(pan[1]))
        position = left_T_right[:3, 3]
        turn = Rotation.from_matrix(left_T_right[:3, :3]).as_rotvec()
        convergence = np.arctan2(-left_T_right[0, 2], left_T_right[2, 2])  # axes that meet: > 0
        return np.array([np.linalg.norm(position), convergence, *position, *turn])

    value, u = _with_uncertainty(rig, relation(rig), by_parameters(relation, rig, _names(rig)))
    return {
        "baseline_mm": value[0] * MM,
        "baseline_standard_uncertainty_mm": u[0] * MM,
        "convergence_deg": value[1] * DEG,
        "convergence_standard_uncertainty_deg": u[1] * DEG,
        "position_mm": (value[2:5] * MM).tolist(),
        "position_standard_uncertainty_mm": (u[2:5] * MM).tolist(),
        "rotation_vector_deg": (value[5:8] * DEG).tolist(),
        "rotation_vector_standard_uncertainty_deg": (u[5:8] * DEG).tolist(),
    }


def turning(rig: Rig) -> dict[str, Any]:
    """Angle between the axes that the two bases turn about."""

    def between(moved: Rig) -> Array:
        across = np.linalg.norm(np.cross(moved.left.pan_axis, moved.right.pan_axis))
        return np.array([np.arctan2(across, abs(moved.left.pan_axis @ moved.right.pan_axis))])

    value, u = _with_uncertainty(rig, between(rig), by_parameters(between, rig, _names(rig)))
    return {"axes_angle_deg": value[0] * DEG, "axes_angle_standard_uncertainty_deg": u[0] * DEG}


def _names(rig: Rig) -> tuple[str, ...]:
    given = () if rig.covariance is None else rig.covariance.parameters
    return tuple(name for name in given if name.startswith(("left.", "right.")))


def _with_uncertainty(rig: Rig, value: Array, slope: Array) -> tuple[Array, Array]:
    """Standard uncertainty of values (m,) from their derivative (p, m) by the rig's parameters."""
    if rig.covariance is None:
        return value, np.full(len(value), np.nan)
    cameras = [
        i for i, n in enumerate(rig.covariance.parameters) if n.startswith(("left.", "right."))
    ]
    full = in_si(rig.covariance)[np.ix_(cameras, cameras)]
    return value, np.sqrt(np.einsum("pm,pq,qm->m", slope, full, slope))
