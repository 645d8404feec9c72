"""Joint angles at singularities, and DH matrices multiplied out."""

import dataclasses
import functools

import numpy as np
from numpy import cos, sin

import robots
from robots import spherical_wrist
from robots.transforms import Array

NEAR = (0.0, *(sign * 10.0**-k for k in range(3, 13) for sign in (1, -1)))


def stretched(arm: robots.DhArm) -> float:
    """θ3 at which the elbow is stretched."""
    return spherical_wrist.forearm(arm)[1] if arm.family == "spherical_wrist" else 0.0


def with_signs(arm: robots.DhArm) -> robots.DhArm:
    """Give an arm joints that count backwards and from another zero; the shipped ones do not."""
    return dataclasses.replace(
        arm,
        sign=np.array([1.0, -1, -1, 1, -1, 1]),
        offset=np.array([0.1, -1.2, 0.7, 0.0, 2.0, -3.0]),
    )


def linked(arm: robots.Arm, factor: int = -1) -> robots.Arm:
    """Give an arm a joint 2 that turns link 3 as well."""
    linkage = np.eye(arm.dof)
    linkage[2, 1] = factor
    return dataclasses.replace(arm, linkage=linkage)


@functools.cache
def wrist_on_axis_1(arm: robots.DhArm, count: int, seed: int) -> Array:
    """Random joint angles whose wrist is on axis 1 to rounding: Newton on its distance by θ2."""
    theta = np.random.default_rng(seed).uniform(-np.pi, np.pi, (3 * count, 6))
    nudge = np.array([0.0, 1e-6, 0.0, 0.0, 0.0, 0.0])

    def distance(angles: Array) -> Array:
        pose = robots.forward(arm, arm.joint_angles(angles))
        wrist = pose[..., :2, 3] - arm.d[5] * pose[..., :2, 2]
        return wrist[..., 0] * np.cos(angles[..., 0]) + wrist[..., 1] * np.sin(angles[..., 0])

    for _ in range(60):
        slope = (distance(theta + nudge) - distance(theta - nudge)) / 2e-6
        theta[:, 1] -= np.clip(
            distance(theta) / np.where(np.abs(slope) < 1e-3, 1e-3, slope), -0.5, 0.5
        )
    on_axis = np.abs(distance(theta)) < 1e-15
    return arm.joint_angles(theta[on_axis][:count])


def link(theta: Array, a: float, d: float, quarter: int) -> Array:
    """RotZ(θ) TransZ(d) TransX(a) RotX(α), standard DH; (m, 4, 4)."""
    c, s, o = cos(theta), sin(theta), np.zeros_like(theta)
    ca, sa = float(quarter == 0), float(quarter)
    rows = [
        [c, -s * ca, s * sa, a * c],
        [s, c * ca, -c * sa, a * s],
        [o, o + sa, o + ca, o + d],
        [o, o, o, o + 1],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def turned_by(found: Array, true: Array) -> Array:
    """By how much angles differ, on the circle."""
    return np.abs((found - true + np.pi) % (2 * np.pi) - np.pi)
