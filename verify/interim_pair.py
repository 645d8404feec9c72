"""One pair's share of the interim check: how it shows each figure beside the body's own motion."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.marker import Marker
from verify.records import Array, Measurement, Pose, Sighting

RANK = 1e-9  # singular values of a whitened pose design below this are rounding
FAINT = 1e-6  # of a figure's effect left beside the pose's: less, and the pair does not show it


@dataclass(frozen=True, slots=True)
class Row:
    """One pair's normal equations for the figures, and what its pixels do to them."""

    seen: Measurement
    pose: Pose
    led: tuple[NDArray[np.int64], NDArray[np.int64]]  # of each spot, left and right
    pan: tuple[float, float]  # rad, as read
    information: Array  # (3, 3); 0 for a figure that the pair does not show
    wanted: Array  # (3,)
    functional: Array  # (3, 2 s): d wanted / d px

    @property
    def value(self) -> Array:
        """The pair's own figures, (3,); nan where it does not show one."""
        shown = np.diag(self.information) > 0
        return np.where(shown, inverse_of(self.information) @ self.wanted, np.nan)


def row_of(seen: Measurement, marker: Marker) -> Row | None:
    """Fit the figures to what the pose left over of one pair; None: it shows no body."""
    pose, left, right = seen.pose, seen.left, seen.right
    if pose is None or left is None or right is None or not len(left) or not len(right):
        return None
    keep = ~pose.rejected if pose.consistent else np.ones_like(pose.rejected)
    offset = marker.leds[np.concatenate([left.led, right.led])] @ pose.rig_T_flange[:3, :3].T
    by_pose = pose.sensitivity @ _rigid(offset)
    figures = _figures(pose, offset, np.concatenate([left.centre, right.centre]), len(left))
    rows = np.repeat(keep, 2)
    lower = np.linalg.cholesky(_covariance(pose, left, right, by_pose)[np.ix_(rows, rows)])
    white = np.linalg.inv(lower)
    figure = white @ figures.reshape(-1, 3)[rows]
    left_of = figure - _shadow(white @ by_pose.reshape(-1, 6)[rows], figure)
    left_of[:, np.sum(left_of**2, axis=0) < FAINT * np.sum(figure**2, axis=0)] = 0.0
    left_of[:, _alike(left_of, figure)] = 0.0
    functional = np.zeros((3, len(rows)))
    functional[:, rows] = left_of.T @ white
    return Row(
        seen=seen,
        pose=pose,
        led=(left.led, right.led),
        pan=(left.pan, right.pan),
        information=left_of.T @ left_of,
        wanted=functional @ pose.residual.reshape(-1),
        functional=functional,
    )


def _figures(pose: Pose, offset: Array, centre: Array, lefts: int) -> Array:
    """What each figure does to the pixels, (s, 2, 3): body larger; right image lower; turned."""
    figures = np.zeros((len(centre), 2, 3))
    figures[:, :, 0] = np.einsum("sij,sj->si", pose.sensitivity, offset)
    for spots, share in ((slice(None, lefts), -0.5), (slice(lefts, None), 0.5)):
        x, y = (centre[spots] - centre[spots].mean(axis=0)).T
        figures[spots, 1, 1] = share
        figures[spots, :, 2] = share * np.stack([-y, x], axis=1)
    return figures


def _rigid(offset: Array) -> Array:
    """Motion of points for a translation and a small turn of their body, (s, 3, 6)."""
    x, y, z = offset.T
    none = np.zeros_like(x)
    turned = np.array([[none, z, -y], [-z, none, x], [y, -x, none]]).transpose(2, 0, 1)
    return np.concatenate([np.tile(np.eye(3), (len(offset), 1, 1)), turned], axis=2)


def _covariance(pose: Pose, left: Sighting, right: Sighting, by_pose: Array) -> Array:
    """What varies from pair to pair, (2 s, 2 s), px²: noise, and the acceleration all share."""
    blocks = np.concatenate([left.covariance, right.covariance])
    lever = np.concatenate([left.acceleration_lever, right.acceleration_lever])
    moved_px = (by_pose * lever[:, None, None]).reshape(-1, 6)
    total: Array = (moved_px * np.repeat(np.square(pose.acceleration_prior), 3)) @ moved_px.T
    for i, block in enumerate(blocks):
        total[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += block
    return total


def _shadow(design: Array, columns: Array) -> Array:
    """The part of columns that the body's own motion makes as well."""
    scale = np.linalg.norm(design, axis=0)
    basis, size, _ = np.linalg.svd(design / np.where(scale > 0, scale, 1.0), full_matrices=False)
    basis = basis[:, size > RANK * size[0]]
    part: Array = basis @ (basis.T @ columns)
    return part


def _alike(left_of: Array, figure: Array) -> list[int]:
    """Figures that a pair of few spots cannot tell from its others: it shows none of them."""
    found = []
    for k in range(figure.shape[1]):
        own, others = left_of[:, k], np.delete(left_of, k, axis=1)
        alone = own - _shadow(others, own) if others.any() and own.any() else own
        if alone @ alone < FAINT * (figure[:, k] @ figure[:, k]):
            found.append(k)
    return found


def inverse_of(information: Array) -> Array:
    """Invert what is shown; zero for a figure that is not."""
    shown = np.diag(information) > 0
    inverse = np.zeros_like(information)
    inverse[np.ix_(shown, shown)] = np.linalg.inv(information[np.ix_(shown, shown)])
    return inverse
