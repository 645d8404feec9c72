"""An arm whose links are off all over: one fault of many coefficients, for any arm.

A real arm is seldom built as its table says, and no single length or twist then explains it. What
many of them do together would pass for offsets, waves and drifts of the joints, so it is tried as
a whole: every link may be displaced against the next axis in the four ways that matter.
"""

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.judgement.faults import Fault
from verify.judgement.faults_common import base_motion
from verify.judgement.model import Model
from verify.records import Array

SMALLEST = 1e-3  # of the largest singular value: what registration leaves of a gauge is rounding


def geometry_fault(model: Model, arm: robots.Arm) -> Fault:
    """All links together; what the session's own registration takes in is left out."""
    rows = model.white.rows(link_displacements(arm, model.comparison.q))
    rows = rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    taken = [model.fitted]
    if model.through_encoders:  # registered by another motion: as if it had been this one
        pose = model.comparison.base_T_jacobian
        body = np.zeros((len(pose), 6, 6))
        body[:, :3, :3] = body[:, 3:, 3:] = pose[:, :3, :3]
        taken.append(model.white.rows(np.concatenate([base_motion(pose), body], axis=2)))
    beside = np.concatenate(taken, axis=1)
    basis, size, _ = np.linalg.svd(
        beside / np.maximum(np.linalg.norm(beside, axis=0), 1e-300), full_matrices=False
    )
    basis = basis[:, size > 1e-9]
    columns, size, _ = np.linalg.svd(rows - basis @ (basis.T @ rows), full_matrices=False)
    return Fault("geometry", None, "", columns[:, size > SMALLEST * size[0]])


def link_displacements(arm: robots.Arm, q: Array) -> Array:
    """Twist of the flange (m, 6, 4 (n - 1)) when links 1 to n - 1 are displaced, at angles (m, n).

    Each along and about two directions square to the next axis: along it a link may slide, and
    about it turn, as that joint's zero does. Axes by products of exponentials from q = 0.
    """
    rest = np.zeros(arm.dof)
    tip = robots.forward(arm, rest)[:3, 3]
    columns = robots.jacobian(arm, rest)
    axes = columns[3:].T
    points = tip - np.cross(columns[:3].T, axes)  # of each axis, nearest to the flange
    flange = robots.forward(arm, q)[:, :3, 3]
    turn, shift = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    effects = []
    for j in range(arm.dof - 1):
        own = Rotation.from_rotvec(q[:, [j]] * axes[j]).as_matrix()
        shift = shift + turn @ points[j] - (turn @ own) @ points[j]
        turn = turn @ own
        place = turn @ points[j + 1] + shift
        across = np.linalg.svd(axes[[j + 1]])[2][1:]  # two directions square to the next axis
        for direction in across:
            way = turn @ direction
            effects.append(np.concatenate([way, np.zeros_like(way)], axis=1))
            effects.append(np.concatenate([np.cross(way, flange - place), way], axis=1))
    return np.stack(effects, axis=2)
