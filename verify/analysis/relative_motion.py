"""Relative motions, measured against the encoders': a test that no registration enters.

Between two poses the flange makes a screw motion. How far it turns and how far it advances along
the screw's axis are the same in whatever frame the poses are given and wherever on the flange the
LEDs sit (Chen, A screw motion approach to uniqueness analysis of head-eye geometry, CVPR 1991). So
where the base stands and how the LEDs are mounted cancel; cameras, clock and arm do not.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from verify.analysis.model import DETECTION_SIGMA, JointErrorModel
from verify.core.records import Array, Index
from verify.core.statistics import chi2_sf

MIN_TURN, MAX_TURN = np.deg2rad([10.0, 170.0])  # outside, a screw's axis is hardly known
MIN_MOTIONS = 5  # relative motions
MAX_MOTIONS = 400  # of them; their errors are told in one matrix
PARTNER_SHIFTS = (2, 3, 4, 5, 7)  # a pair's partner comes this part of the session later
TOL_ROUNDING = 1e-5  # of what either pose gives: the rest has cancelled but for rounding
MAX_OFFSET = np.deg2rad(20.0)  # of an offset that first order may speak of


@dataclass(frozen=True, slots=True)
class RelativeMotion:
    """m relative motions, no pair of pictures in two of them; arm with j joints."""

    early: Index  # (m,), rows of the comparison
    late: Index
    turn: Array  # (m,), rad, by the encoders
    error: Array  # (m, 2), encoders' less measured: turn, rad, and advance, m
    uncertainty: Array  # (m, 2), standard
    chi2: float
    degrees: int
    p_value: float  # that noise and stated doubts alone would give as much
    detectable: Array  # (j,), rad, of a constant offset of that joint by this test; inf: none


def compare_relative_motions(model: JointErrorModel) -> RelativeMotion | None:
    """Compare a session's relative motions; None where too few turn far enough.

    Pairs whose pose is not wholly determined are left out.
    """
    comparison = model.comparison
    whole = np.flatnonzero([known.shape[1] == 6 for known in comparison.determined])
    early, late = _partners(comparison.base_T_encoder[whole], whole)
    if len(early) < MIN_MOTIONS:
        return None
    encoder, measured = comparison.base_T_encoder, comparison.base_T_measured
    told = screw_motion(encoder[early], encoder[late])
    error = told - screw_motion(measured[early], measured[late])
    # where the Jacobian is taken too: what a base or a tool does cancels there to rounding
    where = comparison.base_T_jacobian
    by_early, by_late = screw_derivatives(where[early], where[late])
    own = sum(
        by @ comparison.covariance[rows] @ np.swapaxes(by, 1, 2)
        for by, rows in ((by_early, early), (by_late, late))
    )
    shared = by_early @ model.prior_columns[early] + by_late @ model.prior_columns[late]
    flat = error.reshape(-1)
    columns = shared.reshape(len(flat), -1)
    total = block_diag(*np.asarray(own)) + columns @ columns.T  # of all turns and advances
    weight = np.asarray(np.linalg.inv(total), dtype=np.float64)
    chi2 = float(flat @ weight @ flat)
    spread = np.einsum("naa->na", own) + np.sum(shared**2, axis=2)
    begin, end = by_early @ comparison.jacobian[early], by_late @ comparison.jacobian[late]
    return RelativeMotion(
        early=early,
        late=late,
        turn=told[:, 0],
        error=error,
        uncertainty=np.sqrt(spread),
        chi2=chi2,
        degrees=len(flat),
        p_value=float(chi2_sf(chi2, len(flat))),
        detectable=_detectable(begin, end, weight),
    )


def screw_motion(a_T_early: Array, a_T_late: Array) -> Array:
    """Turn (rad, 0 to pi) and advance along the axis (m) between poses (m, 4, 4), (m, 2)."""
    _, angle, axis, _, moved = _relative_pose(a_T_early, a_T_late)
    return np.column_stack([angle, np.sum(axis * moved, axis=1)])


def _relative_pose(a_T_early: Array, a_T_late: Array) -> tuple[Array, Array, Array, Array, Array]:
    """How an early pose becomes the late one, about a's origin.

    The turn (m, 3, 3), its angle (m,) and axis (m, 3); where it takes the early pose's origin,
    (m, 3), and how far from there the late one's is, (m, 3).
    """
    turn = a_T_late[:, :3, :3] @ np.swapaxes(a_T_early[:, :3, :3], 1, 2)
    vector = Rotation.from_matrix(turn).as_rotvec()
    angle = np.linalg.norm(vector, axis=1)
    axis = vector / np.where(angle > 0, angle, 1.0)[:, None]
    turned = (turn @ a_T_early[:, :3, 3, None])[:, :, 0]
    return turn, angle, axis, turned, a_T_late[:, :3, 3] - turned


def screw_derivatives(a_T_early: Array, a_T_late: Array) -> tuple[Array, Array]:
    """How turn and advance change with either pose, (m, 2, 6) each.

    Poses are moved by twists in a's axes at the flange (m, rad). A further turn by a small d turns
    the axis by half of it: by cot(angle / 2) / 2 of d's part across and by d x axis / 2.
    """
    turn, angle, axis, turned, moved = _relative_pose(a_T_early, a_T_late)
    across = moved - axis * np.sum(axis * moved, axis=1, keepdims=True)
    by_late = np.zeros((len(axis), 2, 6))
    by_late[:, 0, 3:] = by_late[:, 1, :3] = axis
    by_late[:, 1, 3:] = across / (2 * np.tan(angle / 2))[:, None]
    by_late[:, 1, 3:] += np.cross(axis, moved / 2 + turned)
    # the early pose's turn is undone first, so that it is carried along
    by_early = -by_late
    by_early[:, :, 3:] = by_early[:, :, 3:] @ turn
    return by_early, by_late


def _partners(base_T_flange: Array, rows: Index) -> tuple[Index, Index]:
    """Pairs of rows, none in two of them, that turn far enough: of a few ways the richest."""
    best, early, late = -1.0, rows[:0], rows[:0]
    for shift in (len(rows) // part for part in PARTNER_SHIFTS if len(rows) >= part):
        first = np.flatnonzero(np.arange(len(rows) - shift) // shift % 2 == 0)
        turn = screw_motion(base_T_flange[first], base_T_flange[first + shift])[:, 0]
        useful = (turn > MIN_TURN) & (turn < MAX_TURN)
        worth = float(np.sum(np.sin(turn[useful] / 2) ** 2))
        if worth > best:
            best, early, late = worth, rows[first[useful]], rows[first[useful] + shift]
    thinned = np.linspace(0, len(early) - 1, min(len(early), MAX_MOTIONS)).round().astype(np.int64)
    return early[thinned], late[thinned]


def _detectable(begin: Array, end: Array, weight: Array) -> Array:
    """Smallest constant offset of each joint that this test would notice, (j,), rad; inf: none."""
    columns = (begin + end).reshape(len(weight), -1)
    single = np.sqrt(np.sum(begin**2 + end**2, axis=(0, 1)))
    told = np.einsum("rj,rs,sj->j", columns, weight, columns)
    hidden = np.linalg.norm(columns, axis=0) < TOL_ROUNDING * single
    detectable = DETECTION_SIGMA / np.sqrt(np.where(hidden, 1.0, told))
    return np.where(hidden | (detectable > MAX_OFFSET), np.inf, detectable)
