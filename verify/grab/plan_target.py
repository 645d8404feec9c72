"""What is to be grasped: where it is in the robot's base, how well that is known, and how big."""

from dataclasses import dataclass

import numpy as np

from robots.transforms import carry, invert
from verify.grab.hand_off import HandSeen
from verify.grab.target import TargetSeen
from verify.records import Array
from verify.rig import Rig
from verify.spot_derivatives import AXES
from verify.systematics import BODY, unit

UPRIGHT = 0.7  # |cosine| from which a picture's columns run along the approach: within 45°


@dataclass(frozen=True, slots=True)
class Thing:
    """An object to grasp, in the robot's base frame."""

    position: Array  # (3,), m, of its middle
    covariance: Array  # (3, 3), m²: of the pictures, the rig and the robot's place in it, as stated
    width: float  # m, across the approach: what goes between the fingers
    width_standard_uncertainty: float  # m
    length: float  # m, along the approach
    length_standard_uncertainty: float  # m
    seen: HandSeen | None = None  # the hand, looked at above it; None: it was not


def into_base(rig: Rig, point: Array, covariance: Array) -> tuple[Array, Array]:
    """Carry a point of the rig into the robot's base, with its covariance.

    The robot's place in the rig adds what rig.toml states of it (`robot_base.*`, a small rotation
    on the left in the rig's axes); where it states nothing, it is taken as exact. Correlations of
    that place with the cameras' own parameters are left out.

    Args:
        rig: with the robot's place.
        point: (3,), m, rig frame.
        covariance: (3, 3), m², rig frame.

    Returns:
        (3,) m and (3, 3) m², base frame.
    """
    base_T_rig = invert(rig.rig_T_base)
    base_R_rig = base_T_rig[:3, :3]
    total = base_R_rig @ (covariance + base_spread(rig, point)) @ base_R_rig.T
    return carry(base_T_rig, point), total


def from_seen(seen: TargetSeen, rig: Rig, direction: Array) -> Thing:
    """Take a tracked target for the object to grasp.

    Its size is seen across the line of sight. Where the pictures' columns (the rig's y) run within
    45° of the approach, their extent is the length, and the rows' is the width; else both extents
    are across it, and the greater one counts for both.

    Args:
        seen: a target whose centre is known.
        rig: with the robot's place.
        direction: (3,), unit vector of the approach, base frame.
    """
    position, covariance = into_base(rig, seen.centre, seen.covariance)
    size, u = seen.size, seen.size_standard_uncertainty
    down_rig = rig.rig_T_base[:3, :3] @ direction
    wide, long = (0, 1) if abs(down_rig[1]) > UPRIGHT else (int(np.argmax(size)),) * 2
    return Thing(
        position,
        covariance,
        width=float(size[wide]),
        width_standard_uncertainty=float(u[wide]),
        length=float(size[long]),
        length_standard_uncertainty=float(u[long]),
    )


def base_spread(rig: Rig, point: Array) -> Array:
    """Covariance of a fixed point of the base, seen in the rig: what rig.toml states of the base.

    Args:
        rig: with the robot's place.
        point: (3,), m, rig frame.

    Returns:
        (3, 3), m², rig frame; 0 where nothing is stated.
    """
    given = rig.covariance
    if given is None:
        return np.zeros((3, 3))
    arm = point - rig.rig_T_base[:3, 3]
    columns, places = [], []
    for place, name in enumerate(given.parameters):
        head, _, key = name.partition(".")
        if head != "robot_base" or key not in BODY:
            continue
        axis = np.eye(3)[AXES.index(key.split("_")[0][-1])]
        moved = np.cross(axis, arm) if key.startswith("r") else axis
        columns.append(moved * given.standard_uncertainty[place] * unit(name))
        places.append(place)
    if not places:
        return np.zeros((3, 3))
    moves = np.stack(columns, axis=1)
    found: Array = moves @ given.correlation[np.ix_(places, places)] @ moves.T
    return found
