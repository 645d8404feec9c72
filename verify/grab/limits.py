"""How far, how fast and how abruptly each joint may go; and words for what would go beyond."""

from dataclasses import dataclass

import numpy as np

from robots import Arm
from verify.errors import InputError
from verify.records import Array

SLACK = 1e-6  # of each limit: rounding of a trajectory that runs at its limit


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Of each joint, (n,): position, rad, and its greatest rates."""

    lower: Array  # rad
    upper: Array  # rad
    speed: Array  # rad/s
    acceleration: Array  # rad/s²
    jerk: Array  # rad/s³


@dataclass(frozen=True, slots=True)
class Motion:
    """What the joints do at one instant, (n,) each, or at many, (m, n)."""

    q: Array  # rad
    velocity: Array  # rad/s
    acceleration: Array  # rad/s²


def joint_limits(arm: Arm, share: float) -> JointLimits:
    """Take an arm's limits, and the share of its rates that may be used.

    Args:
        arm: whose file states speed, acceleration and jerk.
        share: 0 to 1, of each of the three.

    Raises:
        InputError: the file does not state them.
    """
    speed, acceleration, jerk = arm.speed, arm.acceleration, arm.jerk
    if speed is None or acceleration is None or jerk is None:
        found = "states no speed_deg_s, acceleration_deg_s2 and jerk_deg_s3 of its joints"
        remedy = "Write them into each [[joint]], from the maker's data."
        raise InputError(f'robot "{arm.name}"', found, "nothing moves without them", remedy)
    return JointLimits(arm.lower, arm.upper, share * speed, share * acceleration, share * jerk)


def at_rest(q: Array) -> Motion:
    """Stand at joint angles (n,)."""
    return Motion(q, np.zeros_like(q), np.zeros_like(q))


def violation(limits: JointLimits, motion: Motion) -> str:
    """Say which limit a motion breaks, in words; empty where it keeps them all.

    The last look before anything is ordered; NaN breaks every limit.
    """
    speed, most = limits.speed, limits.acceleration
    limited = (
        (motion.q, limits.lower, limits.upper, "would stand at", "°"),
        (motion.velocity, -speed, speed, "would turn at", "°/s"),
        (motion.acceleration, -most, most, "would speed up by", "°/s²"),
    )
    for values, lower, upper, what, unit in limited:
        slack = SLACK * (upper - lower)
        outside = ~((values >= lower - slack) & (values <= upper + slack))  # NaN is outside
        if outside.any():
            first = tuple(np.argwhere(outside)[0])
            joint = first[-1]
            value, low, high = np.degrees([values[first], lower[joint], upper[joint]])
            allowed = f"allowed is {low:g} to {high:g}{unit}"
            return f"joint {joint + 1} {what} {value:.1f}{unit}, {allowed}"
    return ""
