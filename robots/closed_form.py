"""What the closed forms share: turning to a wrist, two links in a plane, and how a family answers.

Everything is a number: a float for one pose, or an array (m,) of m poses at once. The eight
branches are three choices: shoulder (0 facing the wrist, 1 facing away), elbow (0 bent by a
positive angle, 1 by a negative one) and wrist (0 with sin θ5 >= 0, 1 with <= 0), in this order:
branch = 4 · shoulder + 2 · elbow + wrist.

No digits are lost near a singularity, and no polishing is needed: each later angle is computed from
the sines and cosines of the angles already chosen, never from a second vanishing pair. A joint may
be ill determined there; the pose it leads to is not.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from robots.arm import DhArm
from robots.elementary import Condition, Number, arctan2, clip, cos, sin, some, sqrt, where

Misfit = tuple[int, str, float, str]  # joint (1 to 6), key, value found, what is needed
Needed = dict[str, tuple[float | None, ...]]  # columns, mm and degrees; None is any number

WRIST, SHOULDER, ELBOW = 1, 2, 4  # bits of Branches.degenerate

# |sin θ5| taken as 0: a free joint held turns the flange by less, half of 1e-9 rad
TOL_WRIST = 5e-10
TOL_SHOULDER = 1e-12  # m, the wrist's distance from axis 1 taken as 0; as 1e-9 mm
TOL_SIDE = 1e-10  # m: an arm's plane that passes axis 1 may miss the wrist by this, of rounding
TOL_ELBOW = 1.5e-8  # |sin of the elbow|: below √rounding the elbow's two branches are one
TOL_COSINE = 1e-10  # a cosine may pass 1 by rounding: less than 2e-10 m of reach, even folded


class Answer(NamedTuple):
    """A branch: DH angles, rad, not wrapped, where it exists, and its bits of `degenerate`."""

    branch: int
    theta: Sequence[Number]
    exists: Condition
    flags: Number


class Family(Protocol):
    """A kind of arm with a closed form; a module serves as one."""

    def misfit(self, arm: DhArm) -> Misfit | None:
        """Name the first entry of the table that does not belong to the family, if any."""

    def solve(self, arm: DhArm, pose: Sequence[Number], hold: Sequence[Number]) -> Iterator[Answer]:
        """Solve poses of an arm of this family: the eight branches, in any order.

        `pose` has the 16 elements of base_T_flange, row by row; `hold`, the six DH angles that a
        free joint keeps.
        """

    def reach(self, arm: DhArm) -> tuple[float, float]:
        """Least and greatest distance, m, that the two links span."""


class Turn(NamedTuple):
    """A joint's angle, rad, with its cosine and sine."""

    theta: Number
    cosine: Number
    sine: Number


class ElbowSolutions(NamedTuple):
    """Two links reaching a point, the elbow bent by a positive angle and by a negative one."""

    azimuths: tuple[Number, Number]  # of the first link, rad
    bends: tuple[Number, Number]  # of the second against the first, rad
    exists: Condition
    merged: Condition


def turn_to(
    x: Number, y: Number, hold: Number, side: float
) -> tuple[tuple[Turn, Turn], Condition, Condition]:
    """Turn joint 1 so that (x, y) lies in the arm's plane: facing it, and facing away.

    x and y, m, are of the wrist centre in the base frame; `side`, m, is how far the arm's plane
    lies from axis 1, along axis 2. Where the wrist is on joint 1's axis and the plane too, both
    answers are `hold`, its DH angle. Returns the answers, where any would do, and where they exist.
    """
    distance = sqrt(x * x + y * y)
    if side:
        along = sqrt(clip((distance - side) * (distance + side), 0.0, np.inf))
        facing, away = (
            angle_of(x * across + y * side, y * across - x * side, hold)
            for across in (along, -along)
        )
        return (facing, away), False, distance >= abs(side) - TOL_SIDE
    free = distance < TOL_SHOULDER
    facing = angle_of(x, y, hold, free)
    away = Turn(facing.theta + np.pi, -facing.cosine, -facing.sine)
    if some(free):
        away = Turn(*where(free, facing, away))
    return (facing, away), free, True


def angle_of(x: Number, y: Number, hold: Number, free: Condition = False) -> Turn:
    """Turn to (x, y), of any length; where there is none or any would do, to the angle `hold`."""
    length = sqrt(x * x + y * y)
    free = free | (length == 0)
    some_free = some(free)
    length = where(free, 1.0, length) if some_free else length
    turn = Turn(arctan2(y, x), x / length, y / length)
    if some_free:
        turn = Turn(*where(free, Turn(hold, cos(hold), sin(hold)), turn))
    return turn


def bend_to(x: Number, y: Number, first: float, second: float) -> ElbowSolutions:
    """Reach the point (x, y), m, with two links: the law of cosines in a plane.

    Angles count from x towards y. The first link, m, is at the origin, the second at the point.
    """
    cosine = (x * x + y * y - (first**2 + second**2)) / (2 * first * second)
    exists = abs(cosine) <= 1 + TOL_COSINE
    cosine = clip(cosine, -1.0, 1.0)
    sine = sqrt((1 - cosine) * (1 + cosine))
    azimuth, bend = arctan2(y, x), arctan2(sine, cosine)
    inner = arctan2(second * sine, first + second * cosine)
    return ElbowSolutions(
        (azimuth - inner, azimuth + inner), (bend, -bend), exists, exists & (sine < TOL_ELBOW)
    )


def turn_wrist(
    g: int, entries: tuple[Number, ...], hold: Number
) -> tuple[tuple[tuple[Number, ...], tuple[Number, ...]], Condition]:
    """Find θ4 to θ6 of a spherical wrist, both ways, by Q = RotZ(θ4) RotY(g θ5) RotZ(θ6).

    `entries` are q11, q12, q13, q21, q22, q23 and q33 of Q. Where the wrist is straight and only
    θ4 ± θ6 determined, θ4 is `hold`. Returns where that is as well.
    """
    q11, q12, q13, q21, q22, q23, q33 = entries
    # θ4 from the third column; then RotZ(-θ4) Q gives the others
    y4, x4 = g * q23, g * q13
    s5 = sqrt(x4 * x4 + y4 * y4)
    theta4, theta5 = arctan2(y4, x4), arctan2(s5, q33)
    theta6 = arctan2(x4 * q21 - y4 * q11, x4 * q22 - y4 * q12)
    one, other = (theta4, theta5, theta6), (theta4 + np.pi, -theta5, theta6 + np.pi)
    straight = s5 < TOL_WRIST
    if some(straight):
        c4, s4 = cos(hold), sin(hold)
        theta5 = g * arctan2(c4 * q13 + s4 * q23, q33)
        held = hold, theta5, arctan2(c4 * q21 - s4 * q11, c4 * q22 - s4 * q12)
        one, other = where(straight, held, one), where(straight, held, other)
    return (one, other), straight


def table_mismatch(arm: DhArm, needed: Needed) -> Misfit | None:
    """Compare table columns (mm and degrees) with what a family needs; None is any number."""
    columns = {"a_mm": arm.a * 1000, "d_mm": arm.d * 1000, "alpha_deg": np.degrees(arm.alpha)}
    for key, values in needed.items():
        for joint, (found, value) in enumerate(zip(columns[key], values, strict=True), start=1):
            if value is not None and abs(found - value) > 1e-9:  # rounding of the unit alone
                return joint, key, float(found), f"{value:g} is needed"
    return None
