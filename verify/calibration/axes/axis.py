"""One joint's axis in the rig, and its turn without the encoder, from poses of a sweep.

The circle-point fit of the analysis with all points of the flange at once and one free angle a
pair: encoders only start it and set the angles' mean. No table of the arm enters.
"""

from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.least_squares import autocorrelation
from verify.analysis.sweeps import axis as sweep
from verify.core.records import Array

MIN_POSES = 6  # an axis has four unknowns, and each pair one of its own


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
    noise: float  # by what the poses' stated uncertainty was multiplied, >= 1


def fit_axis(poses: Array, covariance: Array, q: Array) -> SweepAxis:
    """Find the line about which n >= 6 poses (n, 4, 4), rig_T_flange, turn.

    The covariance (n, 6, 6) is in m and rad, its perturbation on the left in rig axes. The joint's
    encoder q (n,), rad, starts the fit and orients the axis; its mean is the zero that the angles
    need.

    Raises:
        ValueError: fewer than six poses.
    """
    n = len(poses)
    if n < MIN_POSES:
        raise ValueError(f"needs six poses or more, got {n}")
    swept = sweep.SweepData(poses, covariance, np.zeros((n, 6, 0)), q, np.zeros(n))
    # a free angle a pair, less the mean of all, which the start pose holds
    terms = np.linalg.svd(np.ones((1, n)))[2][1:].T
    state = sweep.fit_circles(swept, terms).state
    # a point by the path's middle: far from it the direction's doubt would move the point
    shift = state.direction @ (poses[:, :3, 3].mean(axis=0) - state.point)
    found = sweep.fit_circles(
        swept, terms, replace(state, point=state.point + shift * state.direction)
    )
    state = found.state
    degrees = 6 * n - (sweep.N_FREE + n - 1)
    chi2 = float(np.sum(found.residual**2))
    scatter = max(1.0, chi2 / degrees) * float(np.mean(autocorrelation(found.residual)))
    covariance = found.solved.covariance
    gain = (covariance @ found.rows.T).reshape(-1, n, 6)
    by_pose = np.einsum("knj,nji->kni", gain, found.white).reshape(-1, 6 * n)
    return SweepAxis(
        direction=state.direction,
        point=state.point,
        across=sweep.perpendiculars(state.direction),
        covariance=covariance[: sweep.N_LINE, : sweep.N_LINE] * scatter,
        by_pose=by_pose[: sweep.N_LINE],
        angle=sweep.sweep_angle(swept, terms, state),
        angle_covariance=terms @ covariance[sweep.N_FREE :, sweep.N_FREE :] @ terms.T * scatter,
        angle_by_pose=-terms @ by_pose[sweep.N_FREE :],
        noise=float(np.sqrt(scatter)),
    )
