"""A family without a closed form whose answers are all found: an elbow arm with an offset wrist.

Axes 2 and 3 are parallel, axes 4 and 5 meet, and axis 6 passes axis 5 by a5 or meets it d5 away
from axis 4. The twists are (-90, 0, -90, 90, -90, 0)°. The wrist centre, where axes 4 and 5 meet,
depends on θ6 alone; θ1 to θ3 follow from it in closed form, two shoulders and two elbows. What is
left is one equation a branch: axis 4 is square to axis 5,

    e(θ6) = z3 · z4 = 0.

Each branch is sampled over a turn of θ6; changes of sign are bisected. Where a branch ends, at a
stretched or folded elbow, and where |e| is least without a change, a root can be near: these are
starts of Newton steps on the whole chain. Source: derived from the DH table.
"""

import numpy as np
from numpy.typing import NDArray

from robots.arm import DhArm
from robots.closed_form import Misfit, Needed, bend_to, table_mismatch, turn_to
from robots.transforms import Array

ALPHA = (-90.0, 0.0, -90.0, 90.0, -90.0, 0.0)
LENGTHS: Needed = {"a_mm": (None, None, None, 0.0, None, 0.0), "d_mm": (None,) * 6}
N_SAMPLES = 128  # of a turn: roots of one branch that are nearer together can pass for none
N_BISECTIONS = 32  # of a sample's width: to 1e-11 rad
MAX_LEAST = 0.2  # |e|: a least value above hides no root between two samples
Choices = NDArray[np.intp]
Mask = NDArray[np.bool_]


def misfit(arm: DhArm) -> Misfit | None:
    """Name the first entry of the table that does not belong to this family, if any."""
    if arm.a[1] <= 0:
        return 2, "a_mm", float(arm.a[1] * 1000), "an upper arm longer than 0 is needed"
    if np.hypot(arm.a[2], arm.d[3]) == 0:
        return 4, "d_mm", 0.0, "a forearm longer than 0 is needed"
    return table_mismatch(arm, {**LENGTHS, "alpha_deg": ALPHA})


def starts(arm: DhArm, poses: Array) -> tuple[Choices, Array]:
    """Which of the poses (m, 4, 4), m, has which DH angles (k, 6), rad, to within a Newton step."""
    m = len(poses)
    step = 2 * np.pi / N_SAMPLES
    samples: Array = np.linspace(0.0, 2 * np.pi, N_SAMPLES, endpoint=False)
    pose = np.repeat(np.arange(m), N_SAMPLES)
    _, e, exists = _solve(arm, poses[pose], np.tile(samples, m))
    e, exists = e.reshape(2, 2, m, N_SAMPLES), exists.reshape(2, 2, m, N_SAMPLES)
    after, there = np.roll(e, -1, axis=-1), np.roll(exists, -1, axis=-1)
    before, was = np.roll(e, 1, axis=-1), np.roll(exists, 1, axis=-1)

    crossed = exists & there & (np.sign(e) != np.sign(after))
    shoulder, elbow, pose, k = np.nonzero(crossed)
    lower: Array = samples[k]
    upper: Array = lower + step
    first = np.sign(e[crossed])
    for _ in range(N_BISECTIONS):
        middle: Array = (lower + upper) / 2
        _, value, _ = _of(_solve(arm, poses[pose], middle), shoulder, elbow)
        same = np.sign(value) == first
        lower, upper = np.where(same, middle, lower), np.where(same, upper, middle)
    found = [(pose, _of(_solve(arm, poses[pose], (lower + upper) / 2), shoulder, elbow)[0])]

    ends = exists & ~(there & was)
    size = np.abs(e)
    least = exists & there & was & (size <= np.abs(after)) & (size <= np.abs(before))
    shoulder, elbow, pose, k = np.nonzero(ends | (least & (size < MAX_LEAST)))
    found.append((pose, _of(_solve(arm, poses[pose], samples[k]), shoulder, elbow)[0]))
    rows = np.concatenate([pose for pose, _ in found])
    angles = np.concatenate([theta for _, theta in found], axis=1).T
    real = np.isfinite(angles).all(axis=1)
    return rows[real], angles[real]


def _of(
    solved: tuple[Array, Array, Mask], shoulder: Choices, elbow: Choices
) -> tuple[Array, Array, Mask]:
    """Of every row the branch that is named."""
    row = np.arange(len(shoulder))
    theta, e, exists = solved
    return theta[:, shoulder, elbow, row], e[shoulder, elbow, row], exists[shoulder, elbow, row]


def _solve(arm: DhArm, poses: Array, theta6: Array) -> tuple[Array, Array, Mask]:
    """DH angles (6, 2, 2, m), e and whether a branch exists (2, 2, m), at θ6 (m,) of each pose."""
    a1, a2, a3, _, a5, _ = arm.a.tolist()
    d1, _, _, d4, d5, d6 = arm.d.tolist()
    c6, s6 = np.cos(theta6), np.sin(theta6)
    n, o, z5, p = (poses[:, :3, i].T for i in range(4))
    x5, y5 = c6 * n - s6 * o, s6 * n + c6 * o
    wx, wy, wz = p - d6 * z5 - a5 * x5 + d5 * y5
    shoulders, _, there = turn_to(wx, wy, np.zeros(1), float(arm.d[1] + arm.d[2]))
    length, gamma = float(np.hypot(a3, d4)), -float(np.arctan2(d4, a3))

    theta = np.empty((6, 2, 2, len(theta6)))  # joint, shoulder, elbow, pose
    exists = np.empty(theta.shape[1:], dtype=np.bool_)
    for shoulder, (theta1, cosine, sine) in enumerate(shoulders):
        bent = bend_to(wx * cosine + wy * sine - a1, d1 - wz, a2, length)
        exists[shoulder] = there & bent.exists
        theta[0, shoulder] = theta1
        for elbow in (0, 1):
            theta[1, shoulder, elbow] = bent.azimuths[elbow]
            theta[2, shoulder, elbow] = gamma + bent.bends[elbow]
    c1, s1 = np.cos(theta[0]), np.sin(theta[0])
    c23, s23 = np.cos(theta[1] + theta[2]), np.sin(theta[1] + theta[2])

    def x3(v: Array) -> Array:
        return np.asarray(c23 * (c1 * v[0] + s1 * v[1]) - s23 * v[2])

    def y3(v: Array) -> Array:
        return np.asarray(s1 * v[0] - c1 * v[1])

    def z3(v: Array) -> Array:
        return np.asarray(-s23 * (c1 * v[0] + s1 * v[1]) - c23 * v[2])

    theta[3] = np.arctan2(-x3(y5), y3(y5))
    theta[4] = np.arctan2(z3(x5), z3(z5))
    theta[5] = theta6
    return np.where(exists, theta, np.nan), np.where(exists, -z3(y5), np.nan), exists
