"""Many assignments at once: each one's pose, the spots that it explains, and how well.

Besides the flange's pose each hypothesis has one shift of the whole right image. It stands for the
motion between exposures that are not simultaneous: the marker moves as a whole, so its shape stays
a sharp test even where its place does not.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from verify.identification import kernel
from verify.identification.seeds import GATE, Graph, Index, Points, cross
from verify.identification.views import Views
from verify.records import Array

LEAST_SKEW = 1e-3  # px: simultaneous for every purpose, and nothing is divided by zero
NEAREST = 0.02  # m, depth below which a point cannot be imaged
FREE_POSITION = 10.0  # m, standard deviation that leaves position to the images
FREE_ROTATION = 3.0  # rad, likewise: all the way round
LARGEST_GATE = 10.0  # px, an LED predicted worse than this could be any spot
REWARD = 20.0  # 2 ln of how much denser spots are at an LED (half a px) than clutter (20 an image)
MERGED_COST = 9.0  # of the same kind: a clean spot is taken unless it lies 3 sigma farther off
IMPROBABLE = 1e-4  # chi² beyond this probability is not this marker
ALONE_COST = 7.0  # likewise: an LED in view of one camera is hidden from the other once in 30 times


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

    def take(self, chosen: NDArray[np.bool_] | Index) -> "Hypotheses":
        """Keep some, by index or mask."""
        kept = {name: getattr(self, name)[chosen] for name in self.__slots__}
        return Hypotheses(**kept)

    def join(self, other: "Hypotheses") -> "Hypotheses":
        """Append others."""
        names = self.__slots__
        both = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in names}
        return Hypotheses(**both)


def start(views: Views, rotation: Array, position: Array, spot: Index) -> Hypotheses:
    """Begin hypotheses (h of them) at coarse poses, nothing held."""
    count = len(position)
    free = np.repeat([FREE_POSITION, FREE_ROTATION], 3)
    return Hypotheses(
        rotation=rotation,
        position=position,
        shift=np.zeros((count, 2)),
        spot=spot,
        hold=np.tile(free**-2, (count, 1)),
        covariance=np.tile(np.diag([*free**2, views.skew**2, views.skew**2]), (count, 1, 1)),
        chi2=np.full(count, np.inf),
    )


def seed(
    views: Views, points: Points, graph: Graph, nodes: Index, rig_R_flange: Array
) -> Hypotheses:
    """Begin hypotheses from one, two or three nodes each, (h, 1), (h, 2) or (h, 3).

    What the nodes leave open (all turns, or that about their line) stays as in `rig_R_flange`.
    """
    count, corners = nodes.shape
    rig, led = points.rig[graph.point[nodes]], views.leds[graph.led[nodes]]
    rotation = np.broadcast_to(rig_R_flange, (count, 3, 3))
    if corners == 2:
        rotation = (
            _least_turn((led[:, 1] - led[:, 0]) @ rig_R_flange.T, rig[:, 1] - rig[:, 0]) @ rotation
        )
    elif corners == 3:
        rotation = _triad(rig) @ np.swapaxes(_triad(led), 1, 2)
    position = rig.mean(axis=1) - np.einsum("hij,hj->hi", rotation, led.mean(axis=1))
    spot = np.full((count, 2, len(views.leds)), -1, dtype=np.int64)
    row = np.arange(count)[:, None]
    for side in (0, 1):
        spot[row, side, graph.led[nodes]] = points.spot[side, graph.point[nodes]]
    return start(views, np.array(rotation), position, spot)


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


def _triad(corner: Array) -> Array:
    """Axes (h, 3, 3) of triangles (h, 3, 3): along the first side, in the plane, across it."""
    along = corner[:, 1] - corner[:, 0]
    across = cross(along, corner[:, 2] - corner[:, 0])
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    across = across / np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([along, cross(across, along), across], axis=2)


def polish(views: Views, hypotheses: Hypotheses) -> Hypotheses:
    """Fit, gather what each pose explains, fit again; drop what fails and what is there twice."""
    current = refine(views, hypotheses, 2)  # from a few mm off two steps leave 0.01 px
    return settle_spots(views, current)


def settle_spots(views: Views, hypotheses: Hypotheses) -> Hypotheses:
    """Gather and fit until the spots are those of the pose; keep each good assignment once."""
    current = refine(views, unique(gather(views, hypotheses)), 1)
    again = gather(views, current)
    if np.any(again.spot != current.spot):
        current = refine(views, again, 2)
    return unique(current.take(plausible(current)))


def predict(views: Views, hypotheses: Hypotheses) -> tuple[Array, Array, Array]:
    """Predict LED images (h, 2, n, 2), their derivative (h, 2, n, 2, 8), and depths (h, 2, n)."""
    shape = (len(hypotheses), 2, len(views.leds))
    image, derivative, depth = np.empty((*shape, 2)), np.empty((*shape, 2, 8)), np.empty(shape)
    kernel.predict_all(
        (views.camera_R_rig, views.center, views.focal),
        NEAREST,
        views.leds,
        np.ascontiguousarray(hypotheses.rotation),
        hypotheses.position,
        hypotheses.shift,
        image,
        derivative,
        depth,
    )
    return image, derivative, depth


def refine(views: Views, hypotheses: Hypotheses, steps: int) -> Hypotheses:
    """Fit pose and shift to the assigned spots by Gauss-Newton, every hypothesis by itself."""
    count = len(hypotheses)
    if count == 0:
        return hypotheses
    fitted = replace(
        hypotheses,
        rotation=np.array(hypotheses.rotation, order="C"),
        position=hypotheses.position.copy(),
        shift=hypotheses.shift.copy(),
        covariance=np.empty((count, kernel.FREE, kernel.FREE)),
        chi2=np.empty(count),
    )
    kernel.fit_all(
        (views.camera_R_rig, views.center, views.focal),
        (views.pixels, views.covariance),
        (NEAREST, views.led_play * views.mean_focal, 1 / max(views.skew, LEAST_SKEW) ** 2),
        views.leds,
        fitted.rotation,
        fitted.position,
        fitted.shift,
        fitted.spot,
        fitted.hold,
        steps,
        fitted.covariance,
        fitted.chi2,
    )
    return fitted


def _play(views: Views, depth: Array) -> Array:
    """Covariance (..., 2, 2), px², of an LED that sits a little off its place in the marker."""
    spread = (views.led_play * views.mean_focal / np.maximum(depth, NEAREST)) ** 2
    covariance: Array = spread[..., None, None] * np.eye(2)
    return covariance


def gather(views: Views, hypotheses: Hypotheses, largest: float = LARGEST_GATE) -> Hypotheses:
    """Give every LED the nearest spot within its gate, one spot to one LED at most.

    An LED that the pose predicts worse than `largest` (px) gets none: its gate would hold anything.
    """
    if len(hypotheses) == 0:
        return hypotheses
    image, derivative, depth = predict(views, hypotheses)
    own = derivative @ hypotheses.covariance[:, None, None] @ np.swapaxes(derivative, -1, -2)
    known = own[..., 0, 0] + own[..., 1, 1] <= 2 * largest**2
    spread = (own + _play(views, depth))[:, :, :, None] + views.covariance[:, None]
    away = views.pixels[:, None] - image[:, :, :, None]
    squared = _squared_distance(away, spread)
    possible = views.allowed & (squared <= GATE**2) & (known & (depth > NEAREST))[..., None]
    cost = np.where(possible, squared + MERGED_COST * views.merged[:, None], np.inf)
    cost[cost > cost.min(axis=2, keepdims=True)] = np.inf  # the nearer LED keeps a spot
    spot = np.where(np.isfinite(cost.min(axis=3)), np.argmin(cost, axis=3), -1)
    return replace(hypotheses, spot=spot.astype(np.int64))


def _squared_distance(away: Array, spread: Array) -> Array:
    """Squared Mahalanobis length of (..., 2) under (..., 2, 2)."""
    x, y = away[..., 0], away[..., 1]
    a, b, d = spread[..., 0, 0], spread[..., 0, 1], spread[..., 1, 1]
    squared: Array = (d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b)
    return squared


def unique(hypotheses: Hypotheses) -> Hypotheses:
    """Keep the best fit of each assignment: two poses of a flat marker may share one."""
    if len(hypotheses) < 2:
        return hypotheses
    best: dict[bytes, int] = {}
    for index in np.argsort(hypotheses.chi2, kind="stable").tolist():
        best.setdefault(hypotheses.spot[index].tobytes(), index)
    return hypotheses.take(np.array(list(best.values())))


def plausible(hypotheses: Hypotheses) -> NDArray[np.bool_]:
    """Say which hypotheses see an LED in both images and fit within their noise."""
    used: NDArray[np.bool_] = hypotheses.spot >= 0
    seen = np.any(used, axis=1).sum(axis=1)
    determined = np.array([0, 3, 5, 6])[np.minimum(seen, 3)]
    freedom = 2 * used.sum(axis=(1, 2)) - determined
    fits = hypotheses.chi2 <= chdtri(np.maximum(freedom, 1), IMPROBABLE)
    good: NDArray[np.bool_] = fits & np.any(np.all(used, axis=1), axis=1)
    return good


def score(views: Views, hypotheses: Hypotheses) -> Array:
    """Twice the negative log evidence of each, against clutter alone: the less the better."""
    used = hypotheses.spot >= 0
    merged = used & views.merged[np.arange(2)[:, None], hypotheses.spot]
    alone = used[:, 0] != used[:, 1]
    explained = REWARD * used.sum(axis=(1, 2)) - MERGED_COST * merged.sum(axis=(1, 2))
    total: Array = hypotheses.chi2 + ALONE_COST * alone.sum(axis=1) - explained
    return total
