"""All joint angles that bring the flange to a pose: the closed form of the arm's family."""

from dataclasses import dataclass

import numpy as np

from robots.arm import DhArm
from robots.closed_form import SHOULDER, WRIST, Flags
from robots.families import FAMILIES
from robots.transforms import Array

CHUNK = 2048  # poses at a time: their rows stay in the processor's second cache
# where a free joint looks for an angle at which the elbow closes: either way, ever wider, rad
SHIFTS = [sign * 0.001 * 1.5**k for k in range(20) for sign in (1, -1)]  # up to 2.2


@dataclass(frozen=True, eq=False)
class Branches:
    """The eight answers, in fixed order: branch = 4 · shoulder + 2 · elbow + wrist.

    shoulder 0 faces the wrist, 1 faces away; elbow 0 bends by a positive angle, 1 by a negative one
    (the angle between the links' lines, 0 when stretched); wrist 0 has sin θ5 >= 0, 1 has <= 0.
    """

    q: Array  # (..., 8, 6), rad, NaN where no answer exists; DH angles in (-pi, pi]
    degenerate: Flags  # (..., 8): 1 wrist straight, 2 wrist on axis 1, 4 elbow stretched or folded


def inverse(arm: DhArm, base_T_flange: Array, hold: Array | None = None) -> Branches:
    """Find every way to reach a pose; limits are not looked at.

    Where a singularity frees a joint, it keeps its angle in `hold`, and both branches that meet
    there hold the same joints: θ1 with the wrist on axis 1 (within 1e-12 m), and with |sin θ5|
    below 5e-10, θ4 of a spherical wrist or θ6 of parallel axes. With parallel axes the elbow may
    not close there; if no branch does, the nearest angle tried at which one does is taken. Next to
    a singularity the pose is still reached to rounding; a joint found there differs from another
    true answer by rounding over the vanishing factor (|sin θ5|, distance from axis 1 in m, |sin| of
    the elbow). One case is lost: parallel axes with the elbow stretched or folded to rounding and
    |sin θ5| below 1e-5 but not 0, where rounding decides if the elbow closes.

    Args:
        arm: of a family with a closed form.
        base_T_flange: (..., 4, 4), m.
        hold: (6,) or (..., 6), rad, angles q that free joints keep; 0 by default.
    """
    poses = np.asarray(base_T_flange, dtype=float)
    shape = poses.shape[:-2]
    poses = poses.reshape(-1, 16)
    held = arm.theta(np.zeros(6) if hold is None else np.asarray(hold, dtype=float))
    held = np.broadcast_to(held, (*shape, 6)).reshape(-1, 6)
    q = np.empty((len(poses), 8, 6))
    degenerate = np.empty((len(poses), 8), dtype=np.uint8)
    for start in range(0, len(poses), CHUNK):
        part = slice(start, start + CHUNK)
        q[part], degenerate[part] = _solved(arm, poses[part], held[part])
    for shift in SHIFTS:
        stuck = np.isnan(q[..., 0]).all(axis=1) & (degenerate & (WRIST | SHOULDER)).any(axis=1)
        if not stuck.any():
            break
        q[stuck], degenerate[stuck] = _solved(arm, poses[stuck], held[stuck] + shift)
    return Branches(q.reshape(*shape, 8, 6), degenerate.reshape(*shape, 8))


def _solved(arm: DhArm, poses: Array, held: Array) -> tuple[Array, Flags]:
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
