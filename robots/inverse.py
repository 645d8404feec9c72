"""All joint angles that bring the flange to a pose, by the closed form of the arm's family.

A new family is a module and a line in FAMILIES.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots import intersecting_axes, offset_wrist, parallel_axes, spherical_wrist
from robots.arm import Arm, DhArm, TableForm, UrdfArm
from robots.closed_form import SHOULDER, WRIST, Family
from robots.kinematics import forward, link_frames
from robots.transforms import Array, difference, invert, turn_z

FAMILIES: dict[str, Family] = {
    "spherical_wrist": spherical_wrist,
    "parallel_axes": parallel_axes,
    "intersecting_axes": intersecting_axes,
}
TABLE_FAMILIES = ("spherical_wrist", "parallel_axes")  # of robot files; a URDF can be of any

Flags = NDArray[np.uint8]

CHUNK_POSES = 2048  # poses at a time: their rows stay in the processor's second cache
# where a free joint looks for an angle at which the elbow closes: either way, ever wider, rad
POSE_SHIFTS = [sign * 0.001 * 1.5**k for k in range(20) for sign in (1, -1)]  # up to 2.2
FULL_TURN = 2 * np.pi
MAX_REFINEMENTS = 12  # Newton steps: two bring a deviation of 1e-5 to rounding
MAX_ANSWERS = 16  # of six joints
CHUNK_SEARCHED = 256  # poses at a time
TOL_SAME = 1e-6  # rad: two answers of a search are one
TOL_REFINED = 1e-13  # m and rad: an answer this near takes no further step
MAX_REFINED = 1e-10  # m and rad: an answer that stays farther off is none
DAMPING = 1e-16  # of J Jᵀ, m² and 1: no leap at a singularity
TOL_LIMIT = 1e-9  # rad: rounding must not put an arm standing at its limit outside


@dataclass(frozen=True, eq=False)
class Branches:
    """The eight answers, in fixed order: branch = 4 · shoulder + 2 · elbow + wrist.

    shoulder 0 faces the wrist, 1 faces away; elbow 0 bends by a positive angle, 1 by a negative one
    (the angle between the links' lines, 0 when stretched); wrist 0 has sin θ5 >= 0, 1 has <= 0.
    """

    q: Array  # (..., 8, n), rad, NaN where no answer exists; DH angles in (-pi, pi], or a URDF's
    degenerate: Flags  # (..., 8): 1 wrist straight, 2 wrist on axis 1, 4 elbow stretched or folded


def inverse(arm: Arm, base_T_flange: Array, hold: Array | None = None) -> Branches:
    """Find every way to reach a pose (..., 4, 4), m; limits are not looked at.

    An arm by URDF needs a `closed_form`; the seventh of seven joints is taken from `hold`. Where
    that is searched, sixteen places take the answers in no order, and none is degenerate.

    Where a singularity frees a joint, it keeps its angle in `hold`, (6,) or (..., 6), rad, 0 by
    default, and both branches that meet there hold the same joints: θ1 with the wrist on axis 1
    (within 1e-12 m), and with |sin θ5| below 5e-10, θ4 of a spherical wrist or θ6 of parallel axes.
    With parallel axes the elbow may not close there; if no branch does, the nearest angle tried at
    which one does is taken. Next to a singularity the pose is still reached to rounding; a joint
    found there differs from another true answer by rounding over the vanishing factor (|sin θ5|,
    distance from axis 1 in m, |sin| of the elbow). One case is lost: parallel axes with the elbow
    stretched or folded to rounding and |sin θ5| below 1e-5 but not 0, where rounding decides if the
    elbow closes.

    Raises:
        ValueError: the arm has no closed form.
    """
    if arm.linkage is not None:
        hold = None if hold is None else arm.axis_angles(np.asarray(hold, dtype=float))
        found = inverse(arm.unlinked, base_T_flange, hold)
        return Branches(arm.joint_angles_of(found.q), found.degenerate)
    poses = np.asarray(base_T_flange, dtype=float)
    if isinstance(arm, UrdfArm):
        return _inverse_by_table(arm, poses, np.zeros(arm.dof) if hold is None else hold)
    assert isinstance(arm, DhArm)
    shape = poses.shape[:-2]
    poses = poses.reshape(-1, 16)
    held = arm.theta(np.zeros(6) if hold is None else np.asarray(hold, dtype=float))
    held = np.broadcast_to(held, (*shape, 6)).reshape(-1, 6)
    q, degenerate = _solve(arm, poses, held)
    for shift in POSE_SHIFTS:
        if not np.count_nonzero(degenerate):
            break
        stuck = np.isnan(q[..., 0]).all(axis=1) & (degenerate & (WRIST | SHOULDER)).any(axis=1)
        if not stuck.any():
            break
        q[stuck], degenerate[stuck] = _solve(arm, poses[stuck], held[stuck] + shift)
    return Branches(q.reshape(*shape, 8, 6), degenerate.reshape(*shape, 8))


def _inverse_by_table(arm: UrdfArm, poses: Array, hold: Array) -> Branches:
    """Answers (..., 8, n) of an unlinked arm, by the table that its axes make."""
    form = arm.closed_form
    if form is None:
        raise ValueError(f"{arm.name} has no closed form")
    hold = np.broadcast_to(np.asarray(hold, dtype=float), (*poses.shape[:-2], arm.dof))
    moved = poses @ invert(arm.rest_frames[-1])
    if arm.dof == 7:  # undo the last joint
        axis = arm.rest_frames[6]
        moved = moved @ axis @ turn_z(-hold[..., 6]) @ invert(axis)
    ordered, held = moved, hold[..., :6]
    if form.reverse:
        ordered, held = invert(moved), held[..., ::-1]
    table_T_tip = invert(form.base_T_table) @ ordered @ form.base_T_tip
    if form.searched:
        return _inverse_by_search(arm, form, table_T_tip, poses, hold)
    found = inverse(form.table, table_T_tip, held)
    q = np.empty((*found.q.shape[:-1], arm.dof))
    q[..., :6] = found.q[..., ::-1] if form.reverse else found.q
    q[..., :6] -= FULL_TURN * np.ceil((q[..., :6] - np.pi) / FULL_TURN)
    q[..., 6:] = np.where(np.isnan(q[..., :1]), np.nan, hold[..., None, 6:])
    if not form.exact:
        exists = np.isfinite(q[..., 0])
        q[exists] = _refined(
            arm, q[exists], np.broadcast_to(poses[..., None, :, :], (*exists.shape, 4, 4))[exists]
        )
    return Branches(q, found.degenerate)


def _inverse_by_search(
    arm: UrdfArm, form: TableForm, table_T_tip: Array, poses: Array, hold: Array
) -> Branches:
    """Answers (..., 16, n), sorted by no branch, of an arm whose last equation is searched."""
    shape = poses.shape[:-2]
    poses, hold = poses.reshape(-1, 4, 4), hold.reshape(-1, arm.dof)
    table_T_tip = table_T_tip.reshape(-1, 4, 4)
    answers = np.full((len(poses), MAX_ANSWERS, arm.dof), np.nan)
    for start in range(0, len(poses), CHUNK_SEARCHED):
        rows, theta = offset_wrist.starts(form.table, table_T_tip[start : start + CHUNK_SEARCHED])
        rows += start
        q = hold[rows].copy()
        angles = form.table.joint_angles(theta)
        q[:, :6] = angles[:, ::-1] if form.reverse else angles
        q = _refined(arm, q, poses[rows])
        q[:, :6] -= FULL_TURN * np.ceil((q[:, :6] - np.pi) / FULL_TURN)
        reached = np.isfinite(q[:, 0])
        for row in np.unique(rows[reached]):
            mine = q[reached & (rows == row)]
            apart = np.abs(near(mine[:, None], mine[None]) - mine[None]).max(axis=-1)
            again = np.tril(apart < TOL_SAME, -1).any(axis=1)
            kept = mine[~again][:MAX_ANSWERS]
            answers[row, : len(kept)] = kept
    flags = np.zeros(answers.shape[:2], dtype=np.uint8)
    return Branches(
        answers.reshape(*shape, MAX_ANSWERS, arm.dof), flags.reshape(*shape, MAX_ANSWERS)
    )


def form_pose(arm: UrdfArm, q: Array) -> Array:
    """Place the flange (m, 4, 4), m, of joint angles (m, n), rad, by the table, not by the file."""
    form = arm.closed_form
    assert form is not None
    angles = q[:, 5::-1] if form.reverse else q[:, :6]
    moved = form.base_T_table @ forward(form.table, angles) @ invert(form.base_T_tip)
    moved = invert(moved) if form.reverse else moved
    if arm.dof == 7:
        axis = arm.rest_frames[6]
        moved = moved @ axis @ turn_z(q[:, 6]) @ invert(axis)
    return np.asarray(moved @ arm.rest_frames[-1])


def _refined(arm: UrdfArm, q: Array, poses: Array) -> Array:
    """Bring answers (k, n) to poses (k, 4, 4) of the file's own chain by Newton; NaN if in vain."""
    q, size = q.copy(), np.full(len(q), np.inf)
    rows = np.arange(len(q))  # those on the way
    for _ in range(MAX_REFINEMENTS):
        frames = link_frames(arm, q[rows])
        error = difference(poses[rows], frames[:, -1])
        size[rows] = np.abs(error).max(axis=-1)
        far = size[rows] > TOL_REFINED
        rows, frames, error = rows[far], frames[far], error[far]
        if not len(rows):
            break
        tip = frames[:, -1, None, :3, 3]
        axis, origin = frames[:, :6, :3, 2], frames[:, :6, :3, 3]
        moves = np.concatenate([np.cross(axis, tip - origin), axis], axis=-1)  # J transposed
        squared = np.swapaxes(moves, -1, -2) @ moves + DAMPING * np.eye(6)
        q[rows, :6] += (moves @ np.linalg.solve(squared, error[..., None]))[..., 0]
    q[size > MAX_REFINED] = np.nan
    return q


def _solve(arm: DhArm, poses: Array, held: Array) -> tuple[Array, Flags]:
    """Joint angles (m, 8, 6) and flags (m, 8) of poses (m, 16), free joints at DH angles (m, 6)."""
    q, flags = np.empty((len(poses), 8, 6)), np.empty((len(poses), 8), dtype=np.uint8)
    solve = FAMILIES[arm.family].solve
    if len(poses) == 1:  # in plain floats
        answers = sorted(solve(arm, poses[0].tolist(), held[0].tolist()))
        _, theta, exists, bits = zip(*answers, strict=True)
        q[0], flags[0] = _joint_angles(arm, np.array(theta).T, np.array(exists)), bits
        return q, flags
    for start in range(0, len(poses), CHUNK_POSES):
        part = slice(start, start + CHUNK_POSES)
        for answer in solve(arm, list(np.ascontiguousarray(poses[part].T)), list(held[part].T)):
            q[part, answer.branch] = _joint_angles(arm, np.array(answer.theta), answer.exists)
            flags[part, answer.branch] = answer.flags
    return q, flags


def _joint_angles(arm: DhArm, theta: Array, exists: NDArray[np.bool_]) -> Array:
    """Joint angles (k, 6) of DH angles (6, k), which are brought into (-pi, pi], in place."""
    theta -= FULL_TURN * np.ceil((theta - np.pi) / FULL_TURN)
    if not exists.all():
        np.copyto(theta, np.nan, where=~exists)
    return arm.joint_angles(theta.T)


def within_limits(arm: Arm, q: Array) -> NDArray[np.bool_]:
    """Say which joint angles (..., n), taken as they are, lie within the limits; NaN does not."""
    inside: NDArray[np.bool_] = np.all(
        (q >= arm.lower - TOL_LIMIT) & (q <= arm.upper + TOL_LIMIT), axis=-1
    )
    return inside


def turns(arm: Arm, q: Array) -> Array:
    """List the joint angles (k, n) within limits that are those of q, whole turns apart.

    A joint that spans two turns doubles the answers of `inverse`; one outside its limits may come
    inside by a turn, or drop out. q is (n,) or (b, n), rad; rows with NaN are left out. The answer
    goes row by row of q, smaller angles first.
    """
    found: list[tuple[float, ...]] = []
    for row in np.asarray(q, dtype=float).reshape(-1, arm.dof):
        if np.isfinite(row).all():
            found.extend(itertools.product(*map(_whole_turns, row, arm.lower, arm.upper)))
    return np.array(found, dtype=float).reshape(-1, arm.dof)


def near(q: Array, q_near: Array) -> Array:
    """Shift each joint of q by whole turns to within half a turn of q_near; shapes broadcast."""
    return q - FULL_TURN * np.rint((q - q_near) / FULL_TURN)


def near_within(arm: Arm, q: Array, q_near: Array) -> Array:
    """Like `near`, but among the turns within limits; NaN rows where a joint has none."""
    shifted = near(q, q_near)
    # least turns that lift it to the lower limit, and most turns up to the upper one
    up = np.ceil((arm.lower - TOL_LIMIT - shifted) / FULL_TURN)
    down = np.floor((arm.upper + TOL_LIMIT - shifted) / FULL_TURN)
    inside = shifted + FULL_TURN * np.clip(0, up, np.maximum(up, down))
    return np.where(within_limits(arm, inside)[..., None], inside, np.nan)


def _whole_turns(angle: float, lower: float, upper: float) -> list[float]:
    first = int(np.ceil((lower - TOL_LIMIT - angle) / FULL_TURN))
    last = int(np.floor((upper + TOL_LIMIT - angle) / FULL_TURN))
    return [float(angle + FULL_TURN * turn) for turn in range(first, last + 1)]
