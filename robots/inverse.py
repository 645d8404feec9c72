"""All joint angles that bring the flange to a pose, by the closed form of the arm's family.

A new family is a module and a line in FAMILIES.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots import parallel_axes, spherical_wrist
from robots.arm import Arm, DhArm
from robots.closed_form import SHOULDER, WRIST, Family, Flags
from robots.transforms import Array

FAMILIES: dict[str, Family] = {"spherical_wrist": spherical_wrist, "parallel_axes": parallel_axes}


CHUNK_POSES = 2048  # poses at a time: their rows stay in the processor's second cache
# where a free joint looks for an angle at which the elbow closes: either way, ever wider, rad
POSE_SHIFTS = [sign * 0.001 * 1.5**k for k in range(20) for sign in (1, -1)]  # up to 2.2
FULL_TURN = 2 * np.pi
TOL_LIMIT = 1e-9  # rad: rounding must not put an arm standing at its limit outside


@dataclass(frozen=True, eq=False)
class Branches:
    """The eight answers, in fixed order: branch = 4 · shoulder + 2 · elbow + wrist.

    shoulder 0 faces the wrist, 1 faces away; elbow 0 bends by a positive angle, 1 by a negative one
    (the angle between the links' lines, 0 when stretched); wrist 0 has sin θ5 >= 0, 1 has <= 0.
    """

    q: Array  # (..., 8, 6), rad, NaN where no answer exists; DH angles in (-pi, pi]
    degenerate: Flags  # (..., 8): 1 wrist straight, 2 wrist on axis 1, 4 elbow stretched or folded


def inverse(arm: DhArm, base_T_flange: Array, hold: Array | None = None) -> Branches:
    """Find every way to reach a pose (..., 4, 4), m; limits are not looked at.

    Where a singularity frees a joint, it keeps its angle in `hold`, (6,) or (..., 6), rad, 0 by
    default, and both branches that meet there hold the same joints: θ1 with the wrist on axis 1
    (within 1e-12 m), and with |sin θ5| below 5e-10, θ4 of a spherical wrist or θ6 of parallel axes.
    With parallel axes the elbow may not close there; if no branch does, the nearest angle tried at
    which one does is taken. Next to a singularity the pose is still reached to rounding; a joint
    found there differs from another true answer by rounding over the vanishing factor (|sin θ5|,
    distance from axis 1 in m, |sin| of the elbow). One case is lost: parallel axes with the elbow
    stretched or folded to rounding and |sin θ5| below 1e-5 but not 0, where rounding decides if the
    elbow closes.
    """
    if arm.linkage is not None:
        hold = None if hold is None else arm.axis_angles(np.asarray(hold, dtype=float))
        found = inverse(arm.unlinked, base_T_flange, hold)
        return Branches(arm.joint_angles_of(found.q), found.degenerate)
    poses = np.asarray(base_T_flange, dtype=float)
    shape = poses.shape[:-2]
    poses = poses.reshape(-1, 16)
    held = arm.theta(np.zeros(6) if hold is None else np.asarray(hold, dtype=float))
    held = np.broadcast_to(held, (*shape, 6)).reshape(-1, 6)
    q = np.empty((len(poses), 8, 6))
    degenerate = np.empty((len(poses), 8), dtype=np.uint8)
    for start in range(0, len(poses), CHUNK_POSES):
        part = slice(start, start + CHUNK_POSES)
        q[part], degenerate[part] = _solve_chunk(arm, poses[part], held[part])
    for shift in POSE_SHIFTS:
        stuck = np.isnan(q[..., 0]).all(axis=1) & (degenerate & (WRIST | SHOULDER)).any(axis=1)
        if not stuck.any():
            break
        q[stuck], degenerate[stuck] = _solve_chunk(arm, poses[stuck], held[stuck] + shift)
    return Branches(q.reshape(*shape, 8, 6), degenerate.reshape(*shape, 8))


def _solve_chunk(arm: DhArm, poses: Array, held: Array) -> tuple[Array, Flags]:
    """Joint angles (m, 8, 6) and flags (m, 8) of poses (m, 16), free joints at DH angles (m, 6)."""
    rows = np.ascontiguousarray(poses.T)
    theta, exists, flags = FAMILIES[arm.family].solve(arm, rows, held.T)
    turns = np.ceil((theta - np.pi) / (2 * np.pi))  # wrap into (-pi, pi]
    turns *= 2 * np.pi
    theta -= turns
    for row, sign, offset in zip(theta, arm.sign, arm.offset, strict=True):
        if offset:
            row -= offset
        if sign < 0:
            np.negative(row, out=row)
    if not exists.all():
        np.copyto(theta, np.nan, where=~exists)
    flags = np.broadcast_to(flags, theta.shape[1:])
    return theta.reshape(6, 8, -1).T, flags.reshape(8, -1).T


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
    return q - FULL_TURN * np.round((q - q_near) / FULL_TURN)


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
