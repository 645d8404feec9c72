"""What the closed forms share: turning to a wrist, two links in a plane, and how a family answers.

Everything works on rows: coordinate arrays of shape (m,), m poses at once. The eight branches are
three choices, each an axis of length two: shoulder (0 facing the wrist, 1 facing away), elbow
(0 bent by a positive angle, 1 by a negative one) and wrist (0 with sin θ5 >= 0, 1 with <= 0), in
this order: branch = 4 · shoulder + 2 · elbow + wrist.

No digits are lost near a singularity, and no polishing is needed: each later angle is computed from
the sines and cosines of the angles already chosen, never from a second vanishing pair. A joint may
be ill determined there; the pose it leads to is not.
"""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from robots.arm import DhArm
from robots.transforms import Array

Mask = NDArray[np.bool_]
Flags = NDArray[np.uint8]
Misfit = tuple[int, str, float, str]  # joint (1 to 6), key, value found, what is needed
Needed = dict[str, tuple[float | None, ...]]  # columns, mm and degrees; None is any number

WRIST, SHOULDER, ELBOW = 1, 2, 4  # bits of Branches.degenerate

# |sin θ5| taken as 0: a free joint held turns the flange by less, half of 1e-9 rad
TOL_WRIST = 5e-10
TOL_SHOULDER = 1e-12  # m, the wrist's distance from axis 1 taken as 0; as 1e-9 mm
TOL_SIDE = 1e-10  # m: an arm's plane that passes axis 1 may miss the wrist by this, of rounding
TOL_ELBOW = 1.5e-8  # |sin of the elbow|: below √rounding the elbow's two branches are one
TOL_COSINE = 1e-10  # a cosine may pass 1 by rounding: less than 2e-10 m of reach, even folded


class Family(Protocol):
    """A kind of arm with a closed form; a module serves as one."""

    def misfit(self, arm: DhArm) -> Misfit | None:
        """Name the first entry of the table that does not belong to the family, if any."""

    def solve(self, arm: DhArm, pose: Array, hold: Array) -> tuple[Array, Mask, Flags]:
        """Solve poses of an arm of this family: base_T_flange's elements (16, m), row by row.

        `hold` (6, m) or (6, 1): DH angles that a free joint keeps. Returns DH angles
        (6, 2, 2, 2, m), not wrapped; which exist and which are degenerate (flags), both to be
        broadcast to (2, 2, 2, m).
        """

    def reach(self, arm: DhArm) -> tuple[float, float]:
        """Least and greatest distance, m, that the two links span."""


class ShoulderSolutions(NamedTuple):
    """Joint 1's two answers: (2, m) each; (m,) `free` where any would do, and where they exist."""

    theta: Array
    cosine: Array
    sine: Array
    free: Mask
    exists: Mask


class ElbowSolutions(NamedTuple):
    """Two links reaching a point: both elbows are ±bend, with the first link at azimuth ∓ inner."""

    azimuth: Array
    inner: Array
    bend: Array
    exists: Mask
    merged: Mask


def turn_to(x: Array, y: Array, hold: Array, side: float = 0.0) -> ShoulderSolutions:
    """Turn joint 1 so that (x, y) lies in the arm's plane: facing it, and facing away.

    x and y (m,), m, are of the wrist centre in the base frame; `side`, m, is how far the arm's
    plane lies from axis 1, along axis 2. Where the wrist is on joint 1's axis and the plane too,
    both answers are `hold`, its DH angle.
    """
    distance = np.sqrt(x * x + y * y)
    if side:
        return _turn_aside(x, y, distance, side)
    free = distance < TOL_SHOULDER
    some_free = bool(free.any())
    distance = np.where(free, 1.0, distance) if some_free else distance
    cosine, sine = np.empty((2, *x.shape)), np.empty((2, *x.shape))
    cosine[0], sine[0] = x / distance, y / distance
    cosine[1], sine[1] = -cosine[0], -sine[0]
    theta = np.empty_like(cosine)
    theta[0] = np.arctan2(y, x)
    theta[1] = theta[0] + np.pi
    if some_free:
        theta[:, free] = np.broadcast_to(hold, x.shape)[free]
        cosine[:, free], sine[:, free] = np.cos(theta[:, free]), np.sin(theta[:, free])
    return ShoulderSolutions(theta, cosine, sine, free, np.ones_like(free))


def _turn_aside(x: Array, y: Array, distance: Array, side: float) -> ShoulderSolutions:
    """Put (x, y) into a plane that passes axis 1 by `side`; closer than that, it cannot be."""
    exists = distance >= abs(side) - TOL_SIDE
    along = np.sqrt(np.maximum((distance - side) * (distance + side), 0.0))
    both = np.stack([along, -along])
    # the sines carry the scale of `distance`, whose rounding must not stretch the turn
    cosine, sine = x * both + y * side, y * both - x * side
    length = np.hypot(cosine, sine)
    length[length == 0] = 1.0
    return ShoulderSolutions(
        np.arctan2(sine, cosine),
        cosine / length,
        sine / length,
        np.zeros_like(exists),
        exists,
    )


def bend_to(x: Array, y: Array, first: float, second: float) -> ElbowSolutions:
    """Reach the point (x, y), m, of any shape with two links: the law of cosines in a plane.

    Angles count from x towards y. The first link, m, is at the origin, the second at the point.
    """
    cosine = (x * x + y * y - (first**2 + second**2)) / (2 * first * second)
    exists = np.abs(cosine) <= 1 + TOL_COSINE
    np.clip(cosine, -1, 1, out=cosine)
    sine = np.sqrt((1 - cosine) * (1 + cosine))
    inner = np.arctan2(second * sine, first + second * cosine)
    return ElbowSolutions(
        np.arctan2(y, x), inner, np.arctan2(sine, cosine), exists, exists & (sine < TOL_ELBOW)
    )


def turn_wrist(theta: Array, g: int, entries: tuple[Array, ...], hold: Array) -> Mask:
    """Fill in θ4 to θ6 of a spherical wrist, in place, by Q = RotZ(θ4) RotY(g θ5) RotZ(θ6).

    `theta` (6, 2, 2, 2, m) is of joint, shoulder, elbow, wrist and pose; `entries` are q11, q12,
    q13, q21, q22, q23 and q33 of Q, to be broadcast to (2, 2, m). Where the wrist is straight and
    only θ4 ± θ6 determined, θ4 is `hold` (m,). Returns where that is, (2, 2, m).
    """
    q11, q12, q13, q21, q22, q23, q33 = entries
    # θ4 from the third column; then RotZ(-θ4) Q gives the others
    y4, x4 = g * q23, g * q13
    s5 = np.sqrt(x4 * x4 + y4 * y4)
    theta[3, ..., 0, :] = np.arctan2(y4, x4)
    theta[4, ..., 0, :] = np.arctan2(s5, q33)
    theta[5, ..., 0, :] = np.arctan2(x4 * q21 - y4 * q11, x4 * q22 - y4 * q12)
    theta[3, ..., 1, :] = theta[3, ..., 0, :] + np.pi
    theta[4, ..., 1, :] = -theta[4, ..., 0, :]
    theta[5, ..., 1, :] = theta[5, ..., 0, :] + np.pi
    straight = np.broadcast_to(s5 < TOL_WRIST, theta.shape[1:3] + theta.shape[4:])
    if straight.any():
        theta4, q11, q12, q13, q21, q22, q23, q33 = (
            np.broadcast_to(entry, straight.shape)[straight] for entry in (hold, *entries)
        )
        c4, s4 = np.cos(theta4), np.sin(theta4)
        theta5 = g * np.arctan2(c4 * q13 + s4 * q23, q33)
        theta6 = np.arctan2(c4 * q21 - s4 * q11, c4 * q22 - s4 * q12)
        for wrist in (0, 1):
            theta[3:, :, :, wrist][:, straight] = np.stack([theta4, theta5, theta6])
    return straight


def table_mismatch(arm: DhArm, needed: Needed) -> Misfit | None:
    """Compare table columns (mm and degrees) with what a family needs; None is any number."""
    columns = {"a_mm": arm.a * 1000, "d_mm": arm.d * 1000, "alpha_deg": np.degrees(arm.alpha)}
    for key, values in needed.items():
        for joint, (found, value) in enumerate(zip(columns[key], values, strict=True), start=1):
            if value is not None and abs(found - value) > 1e-9:  # rounding of the unit alone
                return joint, key, float(found), f"{value:g} is needed"
    return None
