"""One joint's axis in the rig from the flange's poses while that joint alone turns.

All points of the flange run on circles about one line. The line, the flange's pose at angle zero
and one angle a pair are fitted together to the measured poses in their covariance: the circle-point
fit of the textbooks with all points at once, and without the DH table.
"""

from dataclasses import dataclass

import numpy as np

from robots.transforms import difference, rotation_exp, rotation_log
from verify.analysis.least_squares import autocorrelation
from verify.core.records import Array

MAX_ITERATIONS = 30
TOL_STEP = 1e-10  # m and rad: far below what poses are known to
N_LINE_PARAMETERS = 4  # a direction's two components and a point's two


@dataclass(frozen=True, slots=True)
class SweepAxis:
    """A line in the rig, and the turn about it.

    Its four parameters are small: two of the direction along `across`, and two of the point along
    the same two directions.
    """

    direction: Array  # (3,), unit vector in the rig, along which the joint's angle grows
    point: Array  # (3,), m, on the axis, nearest the middle of the flange's path
    across: Array  # (2, 3), unit vectors at right angles to the direction
    covariance: Array  # (4, 4), rad and m: direction, then point, along `across`
    by_pose: Array  # (4, 6 n), how the measured poses move the axis
    angle: Array  # (n,), rad, turned about the axis; the mean is the encoder's
    angle_covariance: Array  # (n, n)
    angle_by_pose: Array  # (n, 6 n)
    residual: Array  # (n, 6), m and rad, measured pose less fitted
    noise: float  # by what the poses' stated uncertainty was multiplied, >= 1
    chi2: float
    degrees_of_freedom: int


def fit_axis(poses: Array, covariance: Array, q: Array) -> SweepAxis:
    """Find the line about which poses turn.

    Args:
        poses: (n, 4, 4), rig_T_flange, n >= 6.
        covariance: (n, 6, 6), m and rad, perturbation on the left in rig axes.
        q: (n,), rad, the joint's encoder; starts the fit, orients the axis, and its mean is the
            zero that the angles need.

    Raises:
        ValueError: fewer than six poses.
    """
    n = len(poses)
    if n < N_LINE_PARAMETERS + 2:
        raise ValueError(f"needs six poses or more, got {n}")
    white = np.array([np.linalg.inv(np.linalg.cholesky(c)) for c in covariance])
    direction, point, start, angle = _start_line(poses, q)
    for _ in range(MAX_ITERATIONS):
        fitted = _turn_about(direction, point, angle) @ start
        residual = difference(poses, fitted)
        across = _perpendiculars(direction)
        design = _design(direction, point, angle, fitted, across)
        rows = np.einsum("nij,njk->nik", white, design).reshape(6 * n, -1)
        wanted = np.einsum("nij,nj->ni", white, residual).reshape(-1)
        # the angles' zero is not in the poses: their mean stays the encoder's
        mean = np.concatenate([np.zeros(N_LINE_PARAMETERS + 6), np.ones(n)])
        rows = np.concatenate([rows, mean[None]])
        wanted = np.append(wanted, n * float(np.mean(q) - np.mean(angle)))
        solution = np.linalg.pinv(rows)
        step = solution @ wanted
        direction = direction + step[:2] @ across
        direction /= np.linalg.norm(direction)
        point = point + step[2:4] @ across
        start = start.copy()
        start[:3, 3] += step[4:7]
        start[:3, :3] = rotation_exp(step[7:10]) @ start[:3, :3]
        angle = angle + step[N_LINE_PARAMETERS + 6 :]
        if np.max(np.abs(step)) < TOL_STEP:
            break
    return _axis(poses, white, direction, point, start, angle)


def _start_line(poses: Array, q: Array) -> tuple[Array, Array, Array, Array]:
    """A start: the rotation vectors between poses, and the line they leave in place."""
    first = int(np.argmin(q))
    turn = rotation_log(poses[:, :3, :3] @ poses[first, :3, :3].T)
    weight = q - q[first]
    direction = weight @ turn / max(float(np.linalg.norm(weight @ turn)), 1e-12)
    # p_k - p_0 = (I - R_k)(c - p_0) for every pose: least squares for the point c
    left = np.eye(3) - poses[:, :3, :3] @ poses[first, :3, :3].T
    shift = poses[:, :3, 3] - poses[first, :3, 3]
    arm = np.linalg.lstsq(left.reshape(-1, 3), shift.reshape(-1), rcond=1e-6)[0]
    along = arm - direction * (direction @ arm)
    angle = turn @ direction
    start = poses[first].copy()
    back = rotation_exp(direction * (float(np.mean(angle)) - float(np.mean(q))))
    point = poses[first, :3, 3] + along
    start[:3, :3] = back @ start[:3, :3]
    start[:3, 3] = point + back @ (start[:3, 3] - point)
    return direction, point, start, angle - angle.mean() + q.mean()


def _turn_about(direction: Array, point: Array, angle: Array) -> Array:
    """The motion about the line by each angle, (n, 4, 4)."""
    turn = np.tile(np.eye(4), (len(angle), 1, 1))
    turn[:, :3, :3] = rotation_exp(angle[:, None] * direction)
    turn[:, :3, 3] = point - turn[:, :3, :3] @ point
    return turn


def _perpendiculars(direction: Array) -> Array:
    """Two unit vectors at right angles to a direction and to each other, (2, 3)."""
    return np.asarray(np.linalg.svd(direction[None])[2][1:], dtype=np.float64)


def _design(direction: Array, point: Array, angle: Array, fitted: Array, across: Array) -> Array:
    """Derivative of the poses by line, start pose and angles, (n, 6, 10 + n)."""
    n = len(angle)
    turn = rotation_exp(angle[:, None] * direction)
    arm = fitted[:, :3, 3] - point
    design = np.zeros((n, 6, N_LINE_PARAMETERS + 6 + n))
    for i, v in enumerate(across):
        tilt = np.cross(direction, v)  # turns the direction towards v
        moved = tilt - turn @ tilt
        design[:, :3, i] = np.cross(moved, arm)
        design[:, 3:, i] = moved
        design[:, :3, 2 + i] = v - turn @ v
    design[:, :3, N_LINE_PARAMETERS : N_LINE_PARAMETERS + 3] = turn
    design[:, 3:, N_LINE_PARAMETERS + 3 : N_LINE_PARAMETERS + 6] = turn
    # turning the start pose moves its rotation alone: the translation is its own parameter
    each = np.arange(n)
    design[each, :3, N_LINE_PARAMETERS + 6 + each] = np.cross(direction, arm)
    design[each, 3:, N_LINE_PARAMETERS + 6 + each] = direction
    return design


def _axis(
    poses: Array,
    white: Array,
    direction: Array,
    point: Array,
    start: Array,
    angle: Array,
) -> SweepAxis:
    n = len(poses)
    # a point by the path's middle: far from it the direction's doubt would move the point
    middle = poses[:, :3, 3].mean(axis=0)
    point = point + direction * (direction @ (middle - point))
    fitted = _turn_about(direction, point, angle) @ start
    residual = difference(poses, fitted)
    across = _perpendiculars(direction)
    design = _design(direction, point, angle, fitted, across)
    rows = np.einsum("nij,njk->nik", white, design).reshape(6 * n, -1)
    mean = np.concatenate([np.zeros(N_LINE_PARAMETERS + 6), np.ones(n)])
    solution = np.linalg.pinv(np.concatenate([rows, mean[None]]))[:, :-1]
    left = np.einsum("nij,nj->ni", white, residual)
    degrees = 6 * n - (N_LINE_PARAMETERS + 6 + n - 1)
    chi2 = float(np.sum(left**2))
    scatter = max(1.0, chi2 / degrees) * float(np.mean(autocorrelation(left)))
    covariance = solution @ solution.T * scatter
    by_pose = np.einsum("knj,nji->kni", solution.reshape(-1, n, 6), white).reshape(-1, 6 * n)
    return SweepAxis(
        direction=direction,
        point=point,
        across=across,
        covariance=covariance[:N_LINE_PARAMETERS, :N_LINE_PARAMETERS],
        by_pose=by_pose[:N_LINE_PARAMETERS],
        angle=angle,
        angle_covariance=covariance[N_LINE_PARAMETERS + 6 :, N_LINE_PARAMETERS + 6 :],
        angle_by_pose=by_pose[N_LINE_PARAMETERS + 6 :],
        residual=residual,
        noise=float(np.sqrt(scatter)),
        chi2=chi2,
        degrees_of_freedom=degrees,
    )
