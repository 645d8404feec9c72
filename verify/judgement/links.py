"""Where an arm's links are, and how the flange moves when one of them is not what it should be."""

import numpy as np

import robots
from verify.records import Array


def link_frames(arm: robots.DhArm, q: Array) -> Array:
    """DH frames 0 to n of joint angles (m, n): base_T_frame, (m, n + 1, 4, 4)."""
    frames = np.tile(np.eye(4), (len(q), arm.dof + 1, 1, 1))
    theta = arm.theta(q)
    for i in range(arm.dof):
        c, s = np.cos(theta[:, i]), np.sin(theta[:, i])
        ca, sa = np.cos(arm.alpha[i]), np.sin(arm.alpha[i])
        step = np.tile(np.eye(4), (len(q), 1, 1))
        step[:, 0] = np.stack([c, -s * ca, s * sa, arm.a[i] * c], axis=1)
        step[:, 1] = np.stack([s, c * ca, -c * sa, arm.a[i] * s], axis=1)
        step[:, 2] = [0.0, sa, ca, arm.d[i]]
        frames[:, i + 1] = frames[:, i] @ step
    return frames


def shift(axis: Array) -> Array:
    """Twist of the flange (m, 6, 1) a metre along axes (m, 3)."""
    return np.concatenate([axis, np.zeros_like(axis)], axis=1)[:, :, None]


def turn(axis: Array, lever: Array) -> Array:
    """Likewise a radian about axes (m, 3) that the flange is a lever (m, 3), m, away from."""
    return np.concatenate([np.cross(axis, lever), axis], axis=1)[:, :, None]
