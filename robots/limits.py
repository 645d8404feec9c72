"""Joint limits, and joints that turn more than once."""

import itertools

import numpy as np
from numpy.typing import NDArray

from robots.arm import Arm
from robots.transforms import Array

TURN = 2 * np.pi
SLACK = 1e-9  # rad: rounding must not put an arm standing at its limit outside


def within_limits(arm: Arm, q: Array) -> NDArray[np.bool_]:
    """Say which joint angles (..., n), taken as they are, lie within the limits; NaN does not."""
    inside: NDArray[np.bool_] = np.all((q >= arm.lower - SLACK) & (q <= arm.upper + SLACK), axis=-1)
    return inside


def turns(arm: Arm, q: Array) -> Array:
    """List the joint angles within limits that are the same posture, whole turns apart.

    A joint that spans two turns doubles the answers of `inverse`; one outside its limits may come
    inside by a turn, or drop out.

    Args:
        arm: any arm.
        q: (n,) or (b, n), rad, such as the branches of one pose; rows with NaN are left out.

    Returns:
        (k, n), row by row of q, smaller angles first; k may be 0.
    """
    found: list[tuple[float, ...]] = []
    for row in np.asarray(q, dtype=float).reshape(-1, arm.dof):
        if np.isfinite(row).all():
            found.extend(itertools.product(*map(_alternatives, row, arm.lower, arm.upper)))
    return np.array(found, dtype=float).reshape(-1, arm.dof)


def near(q: Array, q_near: Array) -> Array:
    """Shift each joint of q by whole turns to within half a turn of q_near; shapes broadcast."""
    shifted: Array = q - TURN * np.round((q - q_near) / TURN)
    return shifted


def near_within(arm: Arm, q: Array, q_near: Array) -> Array:
    """Like `near`, but among the turns within limits; NaN rows where a joint has none."""
    shifted = near(q, q_near)
    up = np.ceil(
        (arm.lower - SLACK - shifted) / TURN
    )  # least turns that lift it to the lower limit
    down = np.floor((arm.upper + SLACK - shifted) / TURN)  # most turns up to the upper limit
    inside = shifted + TURN * np.clip(0, up, np.maximum(up, down))
    return np.where(within_limits(arm, inside)[..., None], inside, np.nan)


def _alternatives(angle: float, lower: float, upper: float) -> list[float]:
    first = int(np.ceil((lower - SLACK - angle) / TURN))
    last = int(np.floor((upper + SLACK - angle) / TURN))
    return [float(angle + TURN * turn) for turn in range(first, last + 1)]
