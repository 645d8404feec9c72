"""Accuracy of a triangulated point: its random part, and the systematic part from the rig.

With the pixels u (4) of a point x (3) in both images, J = du/dx, and the rig's parameters p with
covariance C, a point from least squares on its pixels has

    random       s² J⁺ J⁺'              s: standard uncertainty of a spot's centre, px
    systematic   D C D',  D = -J⁺ du/dp

J and du/dp are central differences through the rig's own model.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robots.transforms import carry
from verify.calibration.origin import MM
from verify.calibration.quality.coverage import view_frame
from verify.calibration.stereo.parameters import PARAMETER_KEYS, step_camera
from verify.calibration.stereo.records import camera_covariance
from verify.core.records import Array
from verify.core.rig import Rig
from verify.measurement.triangulation import rays

STEP = 1e-6  # SI units and pixels: small against curvature, large against rounding
SPOT_SIGMA = 0.02  # px, standard uncertainty of one LED's centre in one image, each way
MAP_COLUMNS, MAP_ROWS = 9, 5  # points of a map; odd, so that one is in the middle
TEST_LENGTH = 0.1  # m, of the distance whose uncertainty is stated


def parameter_derivatives(
    function: Callable[[Rig], Array], rig: Rig, names: Sequence[str]
) -> Array:
    """Differentiate an array by p of a rig's parameters, named as in rig.toml's [covariance].

    Returns (p, ...), a SI unit (or pixel, or one) of the parameter.
    """

    def at(name: str, step: float) -> Array:
        side, _, key = name.partition(".")
        change = step * np.eye(len(PARAMETER_KEYS))[PARAMETER_KEYS.index(key)]
        if side == "left":
            return function(replace(rig, left=step_camera(rig.left, change)))
        return function(replace(rig, right=step_camera(rig.right, change)))

    return np.array([(at(name, STEP) - at(name, -STEP)) / 2 / STEP for name in names])


@dataclass(frozen=True, slots=True)
class AccuracyField:
    """Points on a plane across the view, and the covariance of each; NaN out of sight."""

    distance: float  # m, before the middle between the cameras
    x: Array  # (c,), m, along the baseline
    y: Array  # (r,), m, down
    random: Array  # (r, c, 3, 3), m², view axes: one spot of SPOT_SIGMA px in either image
    systematic: Array  # (r, c, 3, 3), m²: the rig's own uncertainty

    @property
    def total(self) -> Array:
        """Both parts, (r, c, 3, 3), m²."""
        return self.random + self.systematic


def uncertainty_parts(field: AccuracyField, covariance: Array) -> tuple[Array, Array, Array]:
    """Standard uncertainties across the line of sight, along it (depth), and in total, (r, c), m.

    The covariance (r, c, 3, 3), m², is one of the field's parts. Across: in the direction in which
    it is largest. Total: the root of the sum of the three squares.
    """
    x, y = np.meshgrid(field.x, field.y)
    sights = np.stack([x, y, np.full_like(x, field.distance)], axis=-1)
    sights /= np.linalg.norm(sights, axis=-1, keepdims=True)
    depth = np.einsum("...i,...ij,...j->...", sights, covariance, sights)
    across = np.eye(3) - sights[..., :, None] * sights[..., None, :]
    visible = ~np.isnan(depth)
    lateral = np.full(depth.shape, np.nan)
    lateral[visible] = np.linalg.eigvalsh((across @ covariance @ across)[visible])[:, -1]
    return (np.sqrt(lateral), np.sqrt(depth), np.sqrt(np.trace(covariance, axis1=-2, axis2=-1)))


def uncertainty_maps(field: AccuracyField) -> dict[str, Array]:
    """All standard uncertainties, (r, c), mm, by their names in results: random_lateral_mm, …."""
    kinds = ("random", "systematic", "total")
    found = {kind: uncertainty_parts(field, getattr(field, kind)) for kind in kinds}
    parts = ("lateral", "depth", "total")
    return {f"{k}_{part}_mm": found[k][i] * MM for k in kinds for i, part in enumerate(parts)}


@dataclass(frozen=True, slots=True)
class PointDerivatives:
    """Derivatives of n points by their pixels and by the rig's parameters."""

    by_pixels: Array  # (n, 3, 4), m/px, view axes: left x, y, right x, y
    by_rig: Array  # (p, n, 3), a SI unit of each parameter


def point_sensitivities(
    rig: Rig, pan: Array, points: Array, names: Sequence[str]
) -> PointDerivatives:
    """Differentiate least-squares points (n, 3), m, view frame, by pixels and p rig parameters.

    The pan readings (2,) are in rad.
    """
    rig_T_view = view_frame(rig, pan)
    places = carry(rig_T_view, points)
    steps = STEP * rig_T_view[:3, :3].T  # one of the view's axes a row
    moved = [_pixels(rig, pan, places + s) - _pixels(rig, pan, places - s) for s in steps]
    by_point = np.stack(moved, axis=-1) / (2 * STEP)  # (n, 4, 3)
    by_pixels = np.asarray(np.linalg.pinv(by_point), dtype=np.float64)
    by_rig = parameter_derivatives(lambda r: _pixels(r, pan, places), rig, names)
    return PointDerivatives(by_pixels, -np.einsum("nij,pnj->pni", by_pixels, by_rig))


def _pixels(rig: Rig, pan: Array, places: Array) -> Array:
    """Project points (n, 3) of the rig into both images, (n, 4), px."""
    sides = zip((rig.left, rig.right), pan.tolist(), strict=True)
    images = [camera.project(carry(camera.camera_T_rig(at), places)) for camera, at in sides]
    return np.concatenate(images, axis=1)


def systematic_parameters(rig: Rig, turning: bool) -> tuple[tuple[str, ...], Array]:
    """Names and covariance of all sources of the systematic part, SI units and pixels.

    Where the bases turn, each pan reading's own uncertainty acts as one of its zero.

    Raises:
        ValueError: the rig states no covariance.
    """
    names, full = camera_covariance(rig)
    for side, camera in (("left", rig.left), ("right", rig.right)):
        if turning and camera.pan_standard_uncertainty:
            names = (*names, f"{side}.pan_zero_deg")  # again: of the reading, not of the zero
            full = np.pad(full, (0, 1))
            full[-1, -1] = camera.pan_standard_uncertainty**2
    return names, full


def uncertainty_field(rig: Rig, pan: Array, distance: float, turning: bool) -> AccuracyField:
    """Map the expected uncertainty across the view at one distance, m, by the rig's covariance.

    The distance is before the middle between the cameras, `pan` (2,), rad, the readings of the
    bases; `turning`: they vary, and so their own uncertainty counts.
    """
    names, covariance = systematic_parameters(rig, turning)
    x, y = _grid(rig, pan, distance)
    places = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), distance)], axis=-1)
    points = places.reshape(-1, 3)
    pixels, size = _pixels(rig, pan, carry(view_frame(rig, pan), points)), [*rig.image_size] * 2
    visible = np.all((pixels >= -0.5) & (pixels <= np.array(size) - 0.5), axis=1)
    found = point_sensitivities(rig, pan, points[visible], names)
    random, systematic = np.full((2, len(points), 3, 3), np.nan)
    random[visible] = SPOT_SIGMA**2 * found.by_pixels @ found.by_pixels.transpose(0, 2, 1)
    systematic[visible] = np.einsum("pni,pq,qnj->nij", found.by_rig, covariance, found.by_rig)
    shape = (len(y), len(x), 3, 3)
    return AccuracyField(distance, x, y, random.reshape(shape), systematic.reshape(shape))


def _grid(rig: Rig, pan: Array, distance: float) -> tuple[Array, Array]:
    """Cell centres over the part of the plane at one distance that both cameras cover, m."""
    width, height = rig.image_size
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) * [width - 1, height - 1]
    view_T_rig = np.linalg.inv(view_frame(rig, pan))
    lows, highs = [], []
    for camera, angle in ((rig.left, float(pan[0])), (rig.right, float(pan[1]))):
        centre, sights = rays(camera, angle, corners)
        start = view_T_rig[:3, :3] @ centre + view_T_rig[:3, 3]
        ways = sights @ view_T_rig[:3, :3].T
        places = start + ways * ((distance - start[2]) / ways[:, 2])[:, None]
        lows.append(places[:, :2].min(axis=0))
        highs.append(places[:, :2].max(axis=0))
    low, high = np.max(lows, axis=0), np.min(highs, axis=0)
    shares = [(np.arange(n) + 0.5) / n for n in (MAP_COLUMNS, MAP_ROWS)]
    return low[0] + shares[0] * (high[0] - low[0]), low[1] + shares[1] * (high[1] - low[1])


def length_uncertainty(
    rig: Rig, pan: Array, distance: float, axis: int, turning: bool
) -> tuple[float, float]:
    """Standard uncertainty of a distance of TEST_LENGTH, m: random part, systematic part.

    A motion common to all points cancels, as it does in a registered robot's pose. The middle of
    the two points lies on the view's axis at `distance`, m; they lie along axis 0 across, 1 down, 2
    in depth. The pan (2,) is in rad; `turning`: readings vary, and so their own uncertainty counts.
    """
    names, covariance = systematic_parameters(rig, turning)
    middle, half = np.array([0.0, 0.0, distance]), TEST_LENGTH / 2 * np.eye(3)[axis]
    found = point_sensitivities(rig, pan, np.stack([middle - half, middle + half]), names)
    apart = found.by_rig[:, 1, axis] - found.by_rig[:, 0, axis]
    random = SPOT_SIGMA * np.linalg.norm(found.by_pixels[:, axis])
    return float(random), float(np.sqrt(apart @ covariance @ apart))
