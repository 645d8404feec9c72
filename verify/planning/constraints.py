"""Which postures may be planned with, and what excludes the others, counted."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from verify.planning.skeleton import Skeleton, dexterity, skeleton
from verify.planning.view import Flags, views
from verify.planning.wishes import Bench, Wish
from verify.records import Array

Rows = NDArray[np.int64]

FEWEST_LEDS = 3  # in both cameras: fewer leave a turn open
MARGIN_PX = 40.0  # at a pose; on the way half of it
SINGULAR = 0.1  # least singular value of J, lengths over 143 mm: robots.coupling's own gate
SINGULAR_ON_THE_WAY = 0.03  # passed, not measured at
CAMERA_CLEARANCE = 0.15  # m of any link or LED from the cameras
THICKNESS = 0.08  # m between the middles of two links that do not touch
BEND = 0.3  # m along the links: nearer points belong to one bend
CHUNK = 4000  # postures at a time
SLACK = 1e-9  # rad: rounding at a limit

REASONS = (
    "fewer than 3 LEDs inside both pictures",
    "LEDs turned away from a camera",
    "LED images that run into each other",
    "the arm below the floor",
    "the arm too near to a camera",
    "the arm too near to itself",
    "near a singularity",
)


@dataclass(frozen=True)
class Constraints:
    """What a posture must keep."""

    bench: Bench
    wish: Wish
    lower: Array = field(init=False)  # (j,), rad
    upper: Array = field(init=False)

    def __post_init__(self) -> None:
        arm, near = self.bench.arm, self.wish.near
        lower, upper = arm.lower, arm.upper
        if near is not None:
            lower = np.maximum(lower, near - self.wish.within)
            upper = np.minimum(upper, near + self.wish.within)
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)

    @cached_property
    def skeleton(self) -> Skeleton:
        """The arm's links."""
        return skeleton(self.bench.arm)

    @cached_property
    def _apart(self) -> Flags:
        """Which pairs of points are far from each other along the links, (p, p)."""
        way = self.skeleton.way
        return np.abs(way[:, None] - way) > BEND

    @cached_property
    def _eyes(self) -> Array:
        """The cameras' optical centres in the base frame, (2, 3), m."""
        rig = self.bench.rig
        base_T_rig = np.linalg.inv(rig.rig_T_base)
        placed = [c.rig_T_camera(c.pan) for c in (rig.left, rig.right)]
        return np.array([(base_T_rig @ one)[:3, 3] for one in placed])

    def reason(self, q: Array, *, on_the_way: bool = False) -> Rows:
        """Say which constraint excludes each posture.

        Args:
            q: (m, j), rad, within the joints' limits.
            on_the_way: between two poses the rim and singularities may come nearer.

        Returns:
            (m,), the first of REASONS that does; -1 where none does.
        """
        parts = [self._reason(q[i : i + CHUNK], on_the_way) for i in range(0, len(q), CHUNK)]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)

    def good(self, q: Array, *, on_the_way: bool = False) -> Flags:
        """Say which postures (m, j) keep the joints' limits and everything else, (m,)."""
        inside = np.all((q >= self.lower - SLACK) & (q <= self.upper + SLACK), axis=1)
        inside[inside] = self.reason(q[inside], on_the_way=on_the_way) < 0
        return np.asarray(inside, dtype=bool)

    def _reason(self, q: Array, on_the_way: bool) -> Rows:
        margin = MARGIN_PX / 2 if on_the_way else MARGIN_PX
        frames = self.skeleton.frames(q)
        left, right = views(self.bench, frames[:, -1], margin, self.wish.view_angle)
        inside = left.inside & right.inside
        facing = inside & left.facing & right.facing
        apart = facing & left.apart & right.apart
        reason = np.full(len(q), -1, dtype=np.int64)
        for place, leds in reversed(list(enumerate((inside, facing, apart)))):
            reason[leds.sum(axis=1) < FEWEST_LEDS] = place
        left_over = np.flatnonzero(reason < 0)
        reason[left_over] = self._crowded(frames[left_over], on_the_way)
        return reason

    def _crowded(self, frames: Array, on_the_way: bool) -> Rows:
        """Look at the arm itself, where the LEDs are in view."""
        points = self.skeleton.points(frames)
        raised = points[:, self.skeleton.moving]
        away = np.linalg.norm(raised[:, :, None] - self._eyes, axis=-1).min(axis=(1, 2))
        gaps = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
        gaps[:, ~self._apart] = np.inf
        least = SINGULAR_ON_THE_WAY if on_the_way else SINGULAR
        broken = (
            (raised[:, :, 2] < self.wish.floor).any(axis=1),
            away < CAMERA_CLEARANCE,
            gaps.min(axis=(1, 2)) < THICKNESS,
            dexterity(frames) < least,
        )
        reason = np.full(len(frames), -1, dtype=np.int64)
        for place, flags in reversed(list(enumerate(broken))):
            reason[flags] = len(REASONS) - len(broken) + place
        return reason
