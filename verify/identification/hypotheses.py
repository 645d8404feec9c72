"""Many assignments at once: each one's pose, the spots that it explains, and how well.

Besides the flange's pose each hypothesis has one shift of the whole right image. It stands for the
motion between exposures that are not simultaneous: the marker moves as a whole, so its shape stays
a sharp test even where its place does not.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from verify.identification import kernel, kernel_seeds, kernel_settle, kernel_spots
from verify.identification.kernel_points import GATE, Index
from verify.identification.seeds import Graph, Points
from verify.identification.views import Views
from verify.records import Array

LEAST_SKEW = 1e-3  # px: simultaneous for every purpose, and nothing is divided by zero
NEAREST = 0.02  # m, depth below which a point cannot be imaged
FREE = np.repeat([10.0, 3.0], 3)  # m, rad: standard deviations that leave a pose to the images
LARGEST_GATE = 10.0  # px, an LED predicted worse than this could be any spot
REWARD = 20.0  # 2 ln of how much denser spots are at an LED (half a px) than clutter (20 an image)
MERGED_COST = 9.0  # of the same kind: a clean spot is taken unless it lies 3 sigma farther off
IMPROBABLE = 1e-4  # chi² beyond this probability is not this marker
ALONE_COST = 7.0  # likewise: an LED in view of one camera is hidden from the other once in 30 times
COARSE = 4e-3  # m, how well a coarse pose places an LED: depth, with the images a few ms apart
DETERMINED = np.array([0, 3, 5, 6])  # degrees of freedom, by LEDs seen: three determine all
POSE, SHIFT = np.arange(6), np.arange(6, 8)  # of a covariance
SIDES = np.array([[0], [1]])


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Assignments of spots to LEDs, with the pose that each one means."""

    rotation: Array  # (h, 3, 3), rig_R_flange
    position: Array  # (h, 3), m, flange in the rig
    shift: Array  # (h, 2), px, of the right image
    spot: Index  # (h, 2, n), left and right spot of each LED, -1 for none
    hold: Array  # (h, 6), 1/m² and 1/rad²: how firmly each step keeps the pose where it is
    covariance: Array  # (h, 8, 8), m, rad, px
    chi2: Array  # (h,), the shift's own share included; inf before the first fit

    def __len__(self) -> int:
        """Count the hypotheses."""
        return len(self.position)

    @property
    def laid(self) -> kernel_settle.Laid:
        """All that they are, as the kernels take it."""
        return (
            self.rotation, self.position, self.shift, self.spot, self.hold, self.covariance,
            self.chi2,
        )  # fmt: skip

    def copied(self) -> "Hypotheses":
        """The same in arrays of their own."""
        return self.take(np.arange(len(self)))

    def first(self, count: int) -> "Hypotheses":
        """Keep the first so many."""
        return self.take(slice(count))

    def take(self, chosen: NDArray[np.bool_] | Index | slice) -> "Hypotheses":
        """Keep some, by index, mask or slice."""
        return Hypotheses(
            self.rotation[chosen],
            self.position[chosen],
            self.shift[chosen],
            self.spot[chosen],
            self.hold[chosen],
            self.covariance[chosen],
            self.chi2[chosen],
        )

    def join(self, other: "Hypotheses") -> "Hypotheses":
        """Append others."""
        return Hypotheses(
            np.concatenate([self.rotation, other.rotation]),
            np.concatenate([self.position, other.position]),
            np.concatenate([self.shift, other.shift]),
            np.concatenate([self.spot, other.spot]),
            np.concatenate([self.hold, other.hold]),
            np.concatenate([self.covariance, other.covariance]),
            np.concatenate([self.chi2, other.chi2]),
        )


def start(views: Views, rotation: Array, position: Array, spot: Index) -> Hypotheses:
    """Begin hypotheses (h of them) at coarse poses, nothing held."""
    count = len(position)
    hold, covariance = np.empty((count, 6)), np.zeros((count, kernel.FREE, kernel.FREE))
    hold[:] = FREE**-2
    covariance[:, POSE, POSE] = FREE**2
    covariance[:, SHIFT, SHIFT] = views.skew**2
    chi2 = np.full(count, np.inf)
    return Hypotheses(rotation, position, np.zeros((count, 2)), spot, hold, covariance, chi2)


def seed(
    views: Views, points: Points, graph: Graph, nodes: Index, rig_R_flange: Array
) -> Hypotheses:
    """Begin hypotheses from one, two or three nodes each, (h, 1), (h, 2) or (h, 3).

    What the nodes leave open (all turns, or that about their line) stays as in `rig_R_flange`.
    """
    count, corners = nodes.shape
    rotation, position = np.empty((count, 3, 3)), np.empty((count, 3))
    rotation[:] = rig_R_flange
    if corners == 2:
        rig, led = points.rig[graph.point[nodes]], views.leds[graph.led[nodes]]
        line = (led[:, 1] - led[:, 0]) @ rig_R_flange.T
        rotation = np.ascontiguousarray(_least_turn(line, rig[:, 1] - rig[:, 0]) @ rotation)
    spot = np.empty((count, 2, len(views.leds)), dtype=np.int64)
    kernel_seeds.begin_poses(
        (points.spot, points.rig),
        (graph.point, graph.led),
        nodes,
        views.leds,
        rotation,
        position,
        spot,
    )
    return start(views, rotation, position, spot)


def _least_turn(source: Array, target: Array) -> Array:
    """Rotations (h, 3, 3) of least angle that carry directions (h, 3) onto others."""
    source = source / np.linalg.norm(source, axis=1, keepdims=True)
    target = target / np.linalg.norm(target, axis=1, keepdims=True)
    half = source + target
    opposite = np.linalg.norm(half, axis=1) < 1e-9  # half a turn about anything across will do
    across = np.cross(source, np.eye(3)[np.argmin(np.abs(source), axis=1)])
    half = np.where(opposite[:, None], across, half)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    # Two half turns, about the source and about the half-way direction, make the least turn.
    first = 2 * source[:, :, None] * source[:, None] - np.eye(3)
    second = 2 * half[:, :, None] * half[:, None] - np.eye(3)
    return np.where(opposite[:, None, None], second, second @ first)


def polish(views: Views, hypotheses: Hypotheses) -> Hypotheses:
    """Fit, gather what each pose explains, fit again; drop what fails and what is there twice."""
    if len(hypotheses) == 0:
        return hypotheses
    steps = 2  # from a few mm off they leave 0.01 px
    own = hypotheses.copied()
    count = kernel_settle.settle_all(_asked(views), own.laid, steps, bounds(len(views.leds)))
    return own.first(count)


def follow(
    views: Views, found: Hypotheses, rig_T_flange: Array, place: Array, *, settled: bool
) -> Hypotheses:
    """Take the spots nearest to a predicted pose, alone and from what the search found.

    Args:
        views: the two images.
        found: what the search found there; LEDs that one camera alone sees are looked for anew.
        rig_T_flange: (4, 4), the prediction.
        place: (6,), m and rad, its standard uncertainties.
        settled: nothing is left to find, if the prediction's spots are those of the first found.
    """
    count = len(found) + 1
    none = np.full((count, 2, len(views.leds)), -1, dtype=np.int64)
    own = start(views, np.empty((count, 3, 3)), np.empty((count, 3)), none)
    own.rotation[0], own.position[0] = rig_T_flange[:3, :3], rig_T_flange[:3, 3]
    own.covariance[0, POSE, POSE] = place**2
    for mine, theirs in zip(own.laid, found.laid, strict=True):
        mine[1:] = theirs
    own.hold[:] = place**-2
    count = kernel_settle.follow_all(_asked(views), own.laid, bounds(len(views.leds)), settled)
    return own.first(count)


def _asked(views: Views) -> kernel_settle.Asked:
    """What the kernels that settle hypotheses are told of the images and the marker."""
    play = views.led_play * views.mean_focal
    return (
        views.cameras,
        (views.pixels, views.covariance, views.merged),
        views.allowed,
        (
            (NEAREST, play, 1 / max(views.skew, LEAST_SKEW) ** 2),
            (NEAREST, play, GATE, LARGEST_GATE, MERGED_COST),
        ),
        views.leds,
    )


def unique(hypotheses: Hypotheses) -> Hypotheses:
    """Keep the best fit of each assignment: two poses of a flat marker may share one."""
    if len(hypotheses) < 2:
        return hypotheses
    return hypotheses.take(kernel_settle.first_of_each(hypotheses.chi2, hypotheses.spot))


@lru_cache(maxsize=8)
def bounds(leds: int) -> tuple[Array, Index]:
    """What `kernel_settle.likely` is to know, of a marker with so many LEDs."""
    freedom = np.maximum(np.arange(4 * leds + 1), 1)
    return np.asarray(chdtri(freedom, IMPROBABLE), dtype=float), DETERMINED


def score(views: Views, hypotheses: Hypotheses) -> Array:
    """Twice the negative log evidence of each, against clutter alone: the less the better."""
    used, seen, both = _counts(hypotheses)
    merged = (hypotheses.spot >= 0) & views.merged[SIDES, hypotheses.spot]
    explained = REWARD * used - MERGED_COST * merged.sum(axis=(1, 2))
    total: Array = hypotheses.chi2 + ALONE_COST * (seen - both) - explained
    return total


def lone(hypotheses: Hypotheses) -> NDArray[np.bool_]:
    """Say where one LED of several is all that both cameras see: any lamp would do as well."""
    several = hypotheses.spot.shape[2] > 1
    alone: NDArray[np.bool_] = several & (_counts(hypotheses)[2] == 1)
    return alone


def _counts(hypotheses: Hypotheses) -> Index:
    """Count spots in use, LEDs seen, and LEDs seen by both cameras, (3, h)."""
    counts = np.empty((3, len(hypotheses)), dtype=np.int64)
    kernel_spots.count_all(hypotheses.spot, counts)
    return counts


def conflicts(hypotheses: Hypotheses, best: int) -> NDArray[np.bool_]:
    """Say which hypotheses contradict one: another spot for an LED, or another LED for a spot."""
    marked = np.empty(len(hypotheses), dtype=np.bool_)
    kernel_spots.mark_conflicts(hypotheses.spot, best, marked)
    return marked


def departure(
    views: Views, hypotheses: Hypotheses, rig_T_flange: Array, position: float, rotation: float
) -> Array:
    """Measure how far the LEDs of each hypothesis (h,) are from where a reference pose has them.

    Their mean is compared on the scale of `position` (m), their arrangement about it on that of
    `rotation` (rad): a symmetric marker's turn stands out however far the whole has moved. What
    the LEDs seen do not determine plays no part.
    """
    off = np.empty(len(hypotheses))
    kernel_spots.depart_all(
        views.leds,
        hypotheses.spot,
        (hypotheses.rotation, hypotheses.position),
        np.array(rig_T_flange, order="C"),
        (position, rotation, COARSE),
        off,
    )
    return off
