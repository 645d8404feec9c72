"""Each pair's share of the interim check: how it shows each figure beside the body's own motion.

Pairs that show the same spots are worked out together: n of them at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robots.transforms import rigid_columns
from verify.core.fiducials import Marker
from verify.core.records import Array, Flags, Index, Measurement, Pose, Sighting
from verify.measurement.pose import motion_columns

TOL_RANK = 1e-9  # singular values of a whitened pose design below this are rounding
# of a figure's effect left beside the pose's: less, and the pair does not show it
MIN_EFFECT = 1e-6

PosedPair = tuple[Measurement, Pose, Sighting, Sighting]  # a pair, its pose, left and right


@dataclass(frozen=True, slots=True)
class PairEquations:
    """One pair's normal equations for the figures, and what its pixels do to them."""

    seen: Measurement
    led: tuple[Index, Index]  # of each spot, left and right
    pan: tuple[float, float]  # rad, as read
    information: Array  # (3, 3); 0 for a figure that the pair does not show
    wanted: Array  # (3,)
    functional: Array  # (3, 2 s): d wanted / d px
    value: Array  # (3,), the pair's own figures; nan where it does not show one


def rows_of(pairs: Sequence[Measurement], marker: Marker) -> list[PairEquations]:
    """Fit the figures to what the poses left over of pairs, one by one; those without a body drop.

    The pairs are measured, or refused for what their poses left over.
    """
    groups: dict[tuple[int, bytes], list[tuple[int, PosedPair]]] = {}
    for number, seen in enumerate(pairs):
        pose, left, right = seen.pose, seen.left, seen.right
        if pose is None or left is None or right is None or not len(left) or not len(right):
            continue
        alike = len(left), _used_spots(pose).tobytes()
        groups.setdefault(alike, []).append((number, (seen, pose, left, right)))
    found: dict[int, PairEquations] = {}
    for group in groups.values():
        numbers, posed = zip(*group, strict=True)
        found.update(zip(numbers, _rows(posed, marker), strict=True))
    return [found[number] for number in sorted(found)]


def _used_spots(pose: Pose) -> Flags:
    """Spots that count, (s,): those that the fit kept, or every one where no pose explains them."""
    return ~pose.rejected if pose.consistent else np.ones_like(pose.rejected)


def _rows(pairs: Sequence[PosedPair], marker: Marker) -> list[PairEquations]:
    """The same of pairs that show equally many spots, and of which the same ones count."""
    poses = [pose for _, pose, _, _ in pairs]
    sensitivity = np.array([pose.sensitivity for pose in poses])
    turn = np.array([pose.rig_T_flange[:3, :3] for pose in poses])
    led = np.array([np.concatenate([left.led, right.led]) for _, _, left, right in pairs])
    centre = np.array([np.concatenate([left.centre, right.centre]) for _, _, left, right in pairs])
    offset = marker.leds[led] @ np.swapaxes(turn, 1, 2)
    by_pose = sensitivity @ rigid_columns(offset)
    figures = _figures(sensitivity, offset, centre, len(pairs[0][2]))
    rows = np.flatnonzero(np.repeat(_used_spots(poses[0]), 2))
    spread = spot_covariance(pairs, by_pose)[:, rows[:, None], rows]
    white = np.linalg.inv(np.linalg.cholesky(spread))
    figure = white @ figures.reshape(len(pairs), -1, 3)[:, rows]
    left_of = figure - project_onto(white @ by_pose.reshape(len(pairs), -1, 6)[:, rows], figure)
    faint = np.sum(left_of**2, axis=1) < MIN_EFFECT * np.sum(figure**2, axis=1)
    left_of = np.where(faint[:, None], 0.0, left_of)
    left_of = np.where(_indistinguishable(left_of, figure)[:, None], 0.0, left_of)
    turned = np.swapaxes(left_of, 1, 2)
    functional = np.zeros((len(pairs), 3, 2 * led.shape[1]))
    functional[:, :, rows] = turned @ white
    information = turned @ left_of
    residual = np.array([pose.residual.reshape(-1, 1) for pose in poses])
    wanted = (functional @ residual)[:, :, 0]
    shown = np.diagonal(information, axis1=1, axis2=2) > 0
    value = (invert_shown(information) @ wanted[:, :, None])[:, :, 0]
    return [
        PairEquations(seen, (left.led, right.led), (left.pan, right.pan), *figured)
        for (seen, _, left, right), *figured in zip(
            pairs, information, wanted, functional, np.where(shown, value, np.nan), strict=True
        )
    ]


def _figures(sensitivity: Array, offset: Array, centre: Array, lefts: int) -> Array:
    """What each figure does to the pixels, (n, s, 2, 3): body larger; right image lower; turned."""
    figures = np.zeros((*centre.shape, 3))
    figures[:, :, :, 0] = (sensitivity @ offset[:, :, :, None])[:, :, :, 0]
    for spots, share in ((slice(None, lefts), -0.5), (slice(lefts, None), 0.5)):
        x, y = np.moveaxis(centre[:, spots] - centre[:, spots].mean(axis=1, keepdims=True), 2, 0)
        figures[:, spots, 1, 1] = share
        figures[:, spots, :, 2] = share * np.stack([-y, x], axis=2)
    return figures


def spot_covariance(pairs: Sequence[PosedPair], by_pose: Array) -> Array:
    """What varies from pair to pair, (n, 2 s, 2 s), px²: noise, and the acceleration all share."""
    blocks = np.array([np.concatenate([a.covariance, b.covariance]) for _, _, a, b in pairs])
    moved_px = np.array(
        [
            motion_columns(by, np.concatenate([a.lever, b.lever]), pose.acceleration_prior)
            for by, (_, pose, a, b) in zip(by_pose, pairs, strict=True)
        ]
    )
    count, spots = moved_px.shape[:2]
    moved_px = moved_px.reshape(count, 2 * spots, -1)
    total: Array = moved_px @ np.swapaxes(moved_px, 1, 2)
    by_spot = total.reshape(count, spots, 2, spots, 2)
    np.einsum("nsisj->nsij", by_spot)[:] += blocks
    return total


def project_onto(design: Array, columns: Array) -> Array:
    """The part of columns (..., r, k) that a design (..., r, c), the body's motion, makes too."""
    scale = np.linalg.norm(design, axis=-2, keepdims=True)
    basis, size, _ = np.linalg.svd(design / np.where(scale > 0, scale, 1.0), full_matrices=False)
    basis = basis * (size > TOL_RANK * size[..., :1])[..., None, :]
    return basis @ (np.swapaxes(basis, -1, -2) @ columns)


def _indistinguishable(left_of: Array, figure: Array) -> Flags:
    """Figures (..., 3) that a pair of few spots cannot tell from its others: it shows none."""
    found = np.zeros((*figure.shape[:-2], figure.shape[-1]), dtype=bool)
    for k in range(figure.shape[-1]):
        own, others = left_of[..., [k]], np.delete(left_of, k, axis=-1)
        alone = own - project_onto(others, own)
        found[..., k] = np.sum(alone**2, axis=(-2, -1)) < MIN_EFFECT * np.sum(
            figure[..., k] ** 2, axis=-1
        )
    return found


def invert_shown(information: Array) -> Array:
    """Invert what is shown of (..., 3, 3); zero for a figure that is not."""
    shown = np.diagonal(information, axis1=-2, axis2=-1) > 0
    both = shown[..., :, None] & shown[..., None, :]
    unshown = ~shown[..., None] * np.eye(information.shape[-1])
    return np.where(both, np.linalg.inv(np.where(both, information, 0.0) + unshown), 0.0)
