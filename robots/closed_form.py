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

WRIST, SHOULDER, ELBOW = 1, 2, 4  # bits of Branches.degenerate

# |sin θ5| taken as 0: a free joint held turns the flange by less, half of 1e-9 rad
TOL_WRIST = 5e-10
TOL_SHOULDER = 1e-12  # m, the wrist's distance from axis 1 taken as 0; as 1e-9 mm
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
    """Joint 1's two answers: (2, m) each; `free` (m,) where any would do."""

    theta: Array
    cosine: Array
    sine: Array
    free: Mask


class ElbowSolutions(NamedTuple):
    """Two links reaching a point: both elbows are ±bend, with the first link at azimuth ∓ inner."""

    azimuth: Array
    inner: Array
    bend: Array
    exists: Mask
    merged: Mask


def turn_to(x: Array, y: Array, hold: Array) -> ShoulderSolutions:
    """Turn joint 1 so that (x, y) lies in the arm's plane: facing it, and facing away.

    x and y (m,), m, are of the wrist centre in the base frame. Where that is on joint 1's axis,
    both answers are `hold`, its DH angle.
    """
    distance = np.sqrt(x * x + y * y)
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
    return ShoulderSolutions(theta, cosine, sine, free)


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


def table_mismatch(arm: DhArm, needed: dict[str, tuple[float | None, ...]]) -> Misfit | None:
    """Compare table columns (mm and degrees) with what a family needs; None is any number."""
    columns = {"a_mm": arm.a * 1000, "d_mm": arm.d * 1000, "alpha_deg": np.degrees(arm.alpha)}
    for key, values in needed.items():
        for joint, (found, value) in enumerate(zip(columns[key], values, strict=True), start=1):
            if value is not None and abs(found - value) > 1e-9:  # rounding of the unit alone
                return joint, key, float(found), f"{value:g} is needed"
    return None
