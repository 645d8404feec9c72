"""Robot-world and hand-eye calibration in closed form.

    A_i X = Y B_i,   i = 1 … n

    A_i   (4, 4)   the body as the cameras measure it, rig_T_body         given
    B_i   (4, 4)   the flange by the encoders, base_T_flange              given
    X     (4, 4)   body_T_flange: 3 turns, 3 translations                 found
    Y     (4, 4)   rig_T_base: 3 turns, 3 translations                    found

Source: Shah, "Solving the Robot-World/Hand-Eye Calibration Problem Using the Kronecker Product",
J. Mechanisms and Robotics 5(3), 2013: vec(R_X) and vec(R_Y) are the first right and left singular
vectors of the sum of R_B ⊗ R_A; the translations follow by least squares.
"""

from dataclasses import dataclass, replace

import numpy as np

from robots.transforms import difference
from verify.core.records import Array, Flags, rigid_transform

MIN_POSES = 3  # poses: two relative motions about different axes


@dataclass(frozen=True, slots=True)
class HandEye:
    """The two unknown poses of a closed loop, and how well all others fit them."""

    x: Array  # (4, 4)
    y: Array  # (4, 4)
    residual: Array  # (n, 6), A X less Y B: m and rad, in the axes of A and Y
    mirrored: bool  # the poses fit a mirror image: A was observed in a mirror


def solve_hand_eye(a: Array, b: Array) -> HandEye:
    """Solve A X = Y B for X = body_T_flange and Y = rig_T_base.

    At the same n instants, a (n, 4, 4) is rig_T_body, the body in a fixed camera, m, and b (n, 4,
    4) base_T_flange, the flange by the encoders.

    Raises:
        ValueError: fewer than three poses, or not as many of one as of the other.
    """
    if len(a) < MIN_POSES or a.shape != b.shape:
        raise ValueError(f"needs {MIN_POSES} poses or more, twice; got {len(a)} and {len(b)}")
    turns_a, turns_b = a[:, :3, :3], b[:, :3, :3]
    kronecker = np.einsum("nij,nkl->ikjl", turns_b, turns_a).reshape(9, 9)
    u, _, vt = np.linalg.svd(kronecker)
    likes = (v.reshape(3, 3).T for v in (vt[0], u[:, 0]))  # vec stacks columns
    x_turn, y_turn = (nearest_rotation(like * np.sign(np.linalg.det(like))) for like in likes)
    places, misfit = _translations(a, b, y_turn)
    # the turns fit X and Y as well as -X and -Y, a mirror image; the translations decide
    mirrored = _translations(a, b, -y_turn)[1] < misfit
    x, y = rigid_transform(x_turn, places[:3]), rigid_transform(y_turn, places[3:])
    return HandEye(x, y, difference(a @ x, y @ b), mirrored)


def solve_robustly(a: Array, b: Array, worst: float) -> tuple[HandEye, Flags]:
    """Solve again without poses whose residual is `worst` times the median, until none is.

    Returns the solution with residuals for all n poses, and which poses it rests on, (n,).
    """
    good = np.ones(len(a), dtype=bool)
    while True:
        solved = solve_hand_eye(a[good], b[good])
        off = difference(a @ solved.x, solved.y @ b)
        size = np.stack([np.linalg.norm(part, axis=1) for part in (off[:, :3], off[:, 3:])])
        limit = worst * np.median(size[:, good], axis=1, keepdims=True)
        kept = good & (size <= limit).all(axis=0)
        if kept.sum() in (good.sum(), *range(MIN_POSES)):
            return replace(solved, residual=off), good
        good = kept


def nearest_rotation(matrix: Array) -> Array:
    """Find the rotation nearest to a matrix (3, 3), by the Frobenius norm."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def _translations(a: Array, b: Array, y_rotation: Array) -> tuple[Array, float]:
    """Least squares of R_A t_X - t_Y = R_Y t_B - t_A: both (6,), and the residual's size."""
    rows = np.concatenate([a[:, :3, :3], np.tile(-np.eye(3), (len(a), 1, 1))], axis=2)
    wanted = b[:, :3, 3] @ y_rotation.T - a[:, :3, 3]
    design, target = rows.reshape(-1, 6), wanted.reshape(-1)
    solution = np.linalg.lstsq(design, target, rcond=None)[0]
    return solution, float(np.linalg.norm(target - design @ solution))
