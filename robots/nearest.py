"""The joint angles that reach a pose and lie nearest to given ones."""

import math

import numpy as np
from numpy.typing import NDArray

from robots.arm import Arm, DhArm, UrdfArm
from robots.inverse import FAMILIES, inverse, near, near_within
from robots.kinematics import forward, jacobian
from robots.transforms import Array, difference

TOL_POSE = 1e-10  # m and rad: an iteration stops here, far below what any camera sees
MAX_STEPS = 200  # a start within the basin needs under ten; the rest is for slow self-motion
DAMPING = 0.5  # of the error squared: quadratic convergence, and no leap through a singularity
TOL_SELF_MOTION = 1e-9  # rad: self-motion towards the start has ended
MAX_ERROR_HOMEWARD = 1e-2  # m and rad: so near the pose, self-motion may turn towards the start
TOL_SINGULAR = 1e-9  # m and rad a rad: a motion that shifts the flange by less is self-motion


def nearest(
    arm: Arm, base_T_flange: Array, q_near: Array, *, limits: bool = False
) -> tuple[Array, NDArray[np.bool_]]:
    """Find the joint angles for a pose that lie nearest to q_near (2-norm, each joint unwrapped).

    Of poses (..., 4, 4), m; q_near, (n,) or (..., n), rad, is also what a joint that a singularity
    frees keeps. `limits`: within the arm's limits alone. A DH arm's are the nearest of all
    branches, and so are those of a URDF whose six joints have a closed form. Any other URDF's are
    found by damped least squares that start at q_near and, where joints are redundant, settle in
    the nearest point of the self-motion; another branch that is nearer can be missed. Returns
    q (..., n), NaN where not reached, and whether the pose was reached (...).
    """
    poses = np.asarray(base_T_flange, dtype=float)
    seeds = np.broadcast_to(np.asarray(q_near, dtype=float), (*poses.shape[:-2], arm.dof))
    if isinstance(arm, DhArm):
        single = seeds.size == arm.dof and arm.linkage is None and not limits
        found = _nearest_of_one(arm, poses, seeds) if single else None
        return found or _nearest_branch(arm, poses, seeds, limits)
    assert isinstance(arm, UrdfArm)
    q, reached = np.full(seeds.shape, np.nan), np.zeros(seeds.shape[:-1], dtype=np.bool_)
    if arm.closed_form and arm.dof == 6 and not arm.closed_form.searched:
        q, reached = _nearest_branch(arm, poses, seeds, limits)
        if arm.closed_form.exact:
            return q, reached
    # a chain that is only near a family may close where the family's own does not
    for place in np.ndindex(reached.shape):
        if not reached[place]:
            q[place] = _damped_least_squares(arm, poses[place], seeds[place], limits)
    return q, np.isfinite(q).all(axis=-1)


def _nearest_of_one(arm: DhArm, pose: Array, seed: Array) -> tuple[Array, NDArray[np.bool_]] | None:
    """The nearest branch of one pose in plain floats; None where a singularity is met."""
    start = arm.theta(seed).ravel().tolist()
    way, least = [math.nan] * arm.dof, math.inf
    for _, theta, exists, flags in FAMILIES[arm.family].solve(arm, pose.ravel().tolist(), start):
        if flags:
            return None
        turns = [math.remainder(a - b, math.tau) for a, b in zip(theta, start, strict=True)]
        distance = math.hypot(*turns)
        if exists and distance < least:
            way, least = turns, distance
    reached = np.full(seed.shape[:-1], least < math.inf)
    return seed + arm.sign * np.array(way), reached


def _nearest_branch(
    arm: Arm, poses: Array, seeds: Array, limits: bool
) -> tuple[Array, NDArray[np.bool_]]:
    branches, rivals = inverse(arm, poses, hold=seeds).q, seeds[..., None, :]
    q = near_within(arm, branches, rivals) if limits else near(branches, rivals)
    away = q - rivals
    distance = (away * away).sum(axis=-1)
    distance[np.isnan(distance)] = np.inf
    best = distance.argmin(axis=-1).ravel()
    rows = q.reshape(best.size, q.shape[-2], arm.dof)
    chosen = rows[np.arange(best.size), best].reshape(seeds.shape)
    return chosen, np.isfinite(chosen[..., 0])


def _damped_least_squares(arm: UrdfArm, pose: Array, seed: Array, limits: bool) -> Array:
    """Solve for one pose by damped least squares; NaN if it is not reached."""
    q = np.clip(seed, arm.lower, arm.upper) if limits else seed.copy()
    best = np.full(arm.dof, np.nan)
    pull, before = 1.0, np.inf
    for _ in range(MAX_STEPS):
        error = difference(pose, forward(arm, q))
        size = float(np.linalg.norm(error))
        step, drift = _step(arm, q, error, seed - q, limits)
        # going home waits until the pose is near, and slows where it spoils the pose: next to a
        # singularity the two would never end
        pull = pull / 2 if size > before else pull
        before = size
        drift = drift * pull * (size < MAX_ERROR_HOMEWARD)
        if np.abs(error).max() < TOL_POSE:
            best = q
            if np.linalg.norm(drift) < TOL_SELF_MOTION:
                break
        q = q + step + drift
        if limits:
            q = np.clip(q, arm.lower, arm.upper)
    return best


def _step(arm: UrdfArm, q: Array, error: Array, home: Array, limits: bool) -> tuple[Array, Array]:
    """One step that reduces the error, and the share of the way home that leaves the flange still.

    With limits, a joint that stands at one and would pass it is held, and the others step anew.
    """
    moves = jacobian(arm, q)
    free = np.ones(arm.dof, dtype=bool)
    while True:
        u, s, vt = np.linalg.svd(moves * free)
        damping = DAMPING * float(error @ error)
        gain = np.divide(s, s * s + damping, out=np.zeros_like(s), where=s > TOL_SINGULAR)
        step = free * (vt[: len(s)].T @ (gain * (u.T[: len(s)] @ error)))
        still = vt[np.count_nonzero(s > TOL_SINGULAR) :]
        drift = free * (still.T @ (still @ (home * free)))
        after = q + step + drift
        blocked = free & (
            (after < arm.lower) & (q <= arm.lower) | (after > arm.upper) & (q >= arm.upper)
        )
        if not limits or not blocked.any():
            return step, drift
        free &= ~blocked
