"""Measured pose to joint angles: closed-form inverse, the branch nearest the readings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import robots
from verify.comparison import Comparison
from verify.records import Array

# A direction that moves a joint less than this share of the most moved one is rounding.
MOVED = 1e-6


@dataclass(frozen=True, slots=True)
class Joints:
    """n pairs, j joints. Angles in rad, the robot file's own."""

    q: Array  # (n, j), measured; nan where the LEDs or a self-motion leave a joint open
    error: Array  # (n, j), readings less measured
    covariance: Array  # (n, j, j), of the error, from pair to pair
    covariance_measured: Array  # (n, j, j), of the measured angle
    inverse: Array  # (n, j, 6), d q / d pose
    reached: NDArray[np.bool_]  # (n,), the arm can stand in the measured pose
    coupling: tuple[robots.Coupling | None, ...]  # joints that a singularity near by couples

    @property
    def single(self) -> Array:
        """Errors that may enter a single joint's statistics: coupled ones are nan; (n, j)."""
        error = self.error.copy()
        for i, coupling in enumerate(self.coupling):
            if coupling is not None:
                error[i, list(coupling.joints)] = np.nan
        return error


def solve_joints(comparison: Comparison, arm: robots.Arm) -> Joints:
    """Find the joint angles of every measured pose, and how well each is known."""
    n, dof = comparison.q.shape
    q, reached = robots.nearest(arm, comparison.base_T_measured, comparison.q)
    jacobian = comparison.jacobian.copy()
    if reached.any():
        jacobian[reached] = robots.jacobian(arm, q[reached])
    inverse = np.asarray(np.linalg.pinv(jacobian, rcond=1e-9), dtype=np.float64)
    # an exact singularity is flagged, not fatal
    open_joints = np.array(
        [_open(inverse[i], jacobian[i], comparison.determined[i]) for i in range(n)], dtype=bool
    ).reshape(n, dof)
    q = np.where(reached[:, None] & ~open_joints, q, np.nan)
    error = comparison.q - q
    turned = np.swapaxes(inverse, 1, 2)
    return Joints(
        q=q,
        error=np.arctan2(np.sin(error), np.cos(error)),
        covariance=inverse @ comparison.covariance @ turned,
        covariance_measured=inverse @ comparison.covariance_measured @ turned,
        inverse=inverse,
        reached=reached,
        coupling=tuple(
            found if there else None
            for found, there in zip(robots.couplings(arm, comparison.q), reached, strict=True)
        ),
    )


def _open(inverse: Array, jacobian: Array, determined: Array) -> NDArray[np.bool_]:
    """Joints that the undetermined directions, or the arm's self-motion, move; (j,)."""
    dof = jacobian.shape[1]
    moved = np.zeros(dof)
    if determined.shape[1] < 6:
        hidden = np.linalg.svd(determined, full_matrices=True)[0][:, determined.shape[1] :]
        moved += np.linalg.norm(inverse @ hidden, axis=1)
    if dof > 6:
        _, _, right = np.linalg.svd(jacobian, full_matrices=True)
        moved += np.linalg.norm(right[6:], axis=0)
    largest = float(moved.max())
    return moved > MOVED * largest if largest > 0 else np.zeros(dof, dtype=bool)
