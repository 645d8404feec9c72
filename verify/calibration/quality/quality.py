"""Quality of a calibration from boards: fit, coverage, accuracy, largest sources of uncertainty.

`judge_calibration` gathers it; `draw_rectified` shows one pair rectified, where a corner must lie
on the same line of both images.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from verify.calibration.quality import accuracy
from verify.calibration.quality.coverage import (
    BoardOrientation,
    ImageCoverage,
    board_orientations,
    image_coverage,
)
from verify.calibration.stereo import parameters as par
from verify.calibration.stereo.records import Calibration, Residuals, camera_covariance, rms
from verify.core.records import SIDES, Array, Flags, Image
from verify.core.rig import Camera, Rig
from verify.core.statistics import MAD_TO_SIGMA
from verify.measurement.systematics import covariance_in_si

MAX_ROBUST_SIGMA = 3.5  # robust standard deviations above the median: Iglewicz and Hoaglin's limit
MIN_EXCESS_RATIO = 1.5  # times the median: a smaller excess does no harm
MIN_VIEWS = 5  # views of a camera that have a usual rms
MAX_CENTRE_OFFSET = 0.1  # of the image's size: a principal point farther off its centre is unusual
MIN_CENTRE_SIGMA = 4.0  # standard uncertainties between the principal point and the centre
DISTANCE_STEP = 0.05  # m, to which the distances of the maps are rounded
NOISE_GROUP, READINGS_GROUP, PAN_GROUP = "spot noise", "pan readings", "pan axes and zeros"
GROUPS = {  # of a camera's parameters, by key
    "pan_zero_deg": PAN_GROUP,
    **dict.fromkeys(par.PARAMETER_KEYS[par.PAR_FOCAL], "focal lengths"),
    **dict.fromkeys(par.PARAMETER_KEYS[par.PAR_PRINCIPAL], "principal points"),
    **dict.fromkeys(par.PARAMETER_KEYS[par.PAR_LENS], "lens distortion"),
    **dict.fromkeys(par.PARAMETER_KEYS[par.PAR_TURN], "cameras' turns"),
    **dict.fromkeys(par.PARAMETER_KEYS[par.PAR_OFFSET], "cameras' places"),
    **dict.fromkeys(par.PARAMETER_KEYS[par.PAR_CENTER], "cameras' places"),
    **dict.fromkeys(par.PARAMETER_KEYS[par.PAR_AXIS], PAN_GROUP),
}
PICTURE_WIDTH = 720  # px of either image in the report
N_LINES = 12  # across both images
LINE_COLOUR = (80, 200, 80)  # BGR
GAP = 4  # px between the images


@dataclass(frozen=True, slots=True)
class ViewQuality:
    """One board in one camera, as the adjustment left it."""

    camera: int  # 0 left, 1 right
    frame: int
    corners: int  # that were used
    refused: int  # as outliers
    rms: float  # px, root mean square distance of the used corners, as OpenCV counts
    largest: float  # px
    mean: Array  # (2,), px
    poor: bool  # stands out among its camera's views


@dataclass(frozen=True, slots=True)
class PrincipalPoint:
    """Offset of a camera's principal point, and whether it is plausible."""

    camera: int
    offset: Array  # (2,), px, from the image's centre
    distance: float  # px
    uncertainty: float | None  # px, standard, along the offset; None: held, or not stated
    odd: bool  # farther off the centre than in a camera as it is sold
    believed: bool  # significant: many times its own uncertainty from the centre


@dataclass(frozen=True, slots=True)
class DepthContribution:
    """Share of one group of parameters in the depth of a point in the middle of the view."""

    group: str
    alone: float  # m, standard uncertainty of the depth, were all else exact
    without: float  # m, the standard uncertainty that is left, were this group exact


@dataclass(frozen=True, slots=True)
class CalibrationQuality:
    """Everything that judges a calibration."""

    rms: tuple[float, float, float]  # px: both cameras, left, right
    views: tuple[ViewQuality, ...]
    coverage: tuple[ImageCoverage, ...]
    orientations: tuple[BoardOrientation, ...]
    principal_points: tuple[PrincipalPoint, ...]
    pan: Array  # (2,), rad, for which the fields hold
    working_distance: float  # m, median distance of the boards
    fields: tuple[accuracy.AccuracyField, ...]  # nearest first
    contributions: tuple[DepthContribution, ...]  # what would help most first


def judge_calibration(calibration: Calibration, pan: Array | None = None) -> CalibrationQuality:
    """Judge a calibration: fit, coverage, accuracy, sources of uncertainty.

    `pan` (b, 2), rad, holds readings of the bases at its pairs; None: the rig's own fixed ones.

    Raises:
        ValueError: the rig states no covariance, or `pan` does not fit the pairs.
    """
    rig = calibration.rig
    if pan is None:
        pan = np.tile([rig.left.pan, rig.right.pan], (len(calibration.frames), 1))
    if pan.shape != (len(calibration.frames), 2):
        raise ValueError(f"{len(calibration.frames)} pairs need as many pan readings")
    usual = np.median(pan, axis=0)
    orientations = board_orientations(calibration, pan)
    near, working, far = _distances([s.distance for s in orientations])
    residuals = calibration.residuals
    used, left = residuals.used, residuals.camera == 0
    return CalibrationQuality(
        rms=(
            rms(residuals.residual[used]),
            rms(residuals.residual[used & left]),
            rms(residuals.residual[used & ~left]),
        ),
        views=view_residuals(residuals),
        coverage=image_coverage(calibration),
        orientations=orientations,
        principal_points=tuple(_principal_point(calibration, side) for side in (0, 1)),
        pan=usual,
        working_distance=working,
        fields=tuple(
            accuracy.uncertainty_field(rig, usual, d, calibration.turning)
            for d in sorted({near, working, far})
        ),
        contributions=_contributions(calibration, usual, working),
    )


def _distances(boards: list[float]) -> tuple[float, float, float]:
    """Nearest, median and farthest distance of the boards, rounded; some may coincide."""
    steps = np.maximum(np.round(np.quantile(boards, [0.0, 0.5, 1.0]) / DISTANCE_STEP), 1).tolist()
    near, median, far = (round(step * DISTANCE_STEP, 6) for step in steps)
    return near, median, far


def _principal_point(calibration: Calibration, side: int) -> PrincipalPoint:
    camera = (calibration.rig.left, calibration.rig.right)[side]
    size = np.array(calibration.rig.image_size)
    offset = camera.matrix[:2, 2] - (size - 1) / 2  # pixel centres at whole numbers
    distance = float(np.linalg.norm(offset))
    names = [f"{SIDES[side]}.{key}_px" for key in ("cx", "cy")]
    u = _directional_uncertainty(calibration, names, offset)
    odd = bool(np.any(np.abs(offset) > MAX_CENTRE_OFFSET * size))
    sure = u is not None and distance > MIN_CENTRE_SIGMA * u
    return PrincipalPoint(side, offset, distance, u, odd, sure)


def _directional_uncertainty(
    calibration: Calibration, names: list[str], direction: Array
) -> float | None:
    """Standard uncertainty of some parameters in one direction; None where not all are stated."""
    given = calibration.rig.covariance
    if given is None or not set(names) <= set(given.parameters) or not direction.any():
        return None
    rows = [given.parameters.index(name) for name in names]
    unit = direction / np.linalg.norm(direction)
    return float(np.sqrt(unit @ covariance_in_si(given)[np.ix_(rows, rows)] @ unit))


def _contributions(
    calibration: Calibration, pan: Array, distance: float
) -> tuple[DepthContribution, ...]:
    """Split the variance of a depth by what would be left of it, were a group exact.

    The parts do not add up: parameters found from the same pictures are correlated.
    """
    names, covariance = accuracy.systematic_parameters(calibration.rig, calibration.turning)
    found = accuracy.point_sensitivities(
        calibration.rig, pan, np.array([[0.0, 0.0, distance]]), names
    )
    slope = found.by_rig[:, 0, 2]
    noise = float(accuracy.SPOT_SIGMA**2 * np.sum(found.by_pixels[0, 2] ** 2))
    systematic = float(slope @ covariance @ slope)
    split = [DepthContribution(NOISE_GROUP, float(np.sqrt(noise)), float(np.sqrt(systematic)))]
    stated = len(camera_covariance(calibration.rig)[0])  # parameters beyond them are pan readings
    groups = [GROUPS[name.partition(".")[2]] for name in names[:stated]]
    groups += [READINGS_GROUP] * (len(names) - stated)
    for group in dict.fromkeys(groups):
        own = np.array([g == group for g in groups])
        inner = covariance[np.ix_(own, own)]
        common = covariance[own] @ slope
        removed = float(common @ np.linalg.pinv(inner, hermitian=True) @ common)
        alone = float(slope[own] @ inner @ slope[own])
        left = max(systematic + noise - removed, 0.0)
        split.append(DepthContribution(group, float(np.sqrt(alone)), float(np.sqrt(left))))
    return tuple(sorted(split, key=lambda c: (c.without, c.group)))


def view_residuals(residuals: Residuals) -> tuple[ViewQuality, ...]:
    """Summarise the residuals by camera and frame, in that order."""
    views = []
    for camera in np.unique(residuals.camera).tolist():
        own = residuals.camera == camera
        frames = np.unique(residuals.frame[own]).tolist()
        parts = [residuals.residual[own & (residuals.frame == f) & residuals.used] for f in frames]
        poor = outlying_views(np.array([rms(part) for part in parts]))
        for frame, part, bad in zip(frames, parts, poor.tolist(), strict=True):
            every = int(np.sum(own & (residuals.frame == frame)))
            largest = float(np.linalg.norm(part, axis=1).max()) if len(part) else float("nan")
            mean = part.mean(axis=0) if len(part) else np.full(2, np.nan)
            refused = every - len(part)
            views.append(
                ViewQuality(camera, frame, len(part), refused, rms(part), largest, mean, bad)
            )
    return tuple(views)


def outlying_views(values: Array) -> Flags:
    """Find the rms values (n,) that stand out among the others.

    Location and scale are median and median absolute deviation, so nearly half of the views may be
    bad without hiding each other.

    Source: the modified z-score of Iglewicz and Hoaglin, How to Detect and Handle Outliers, 1993.
    """
    known = np.isfinite(values) & (values > 0)
    out = np.zeros(len(values), dtype=bool)
    if known.sum() < MIN_VIEWS:
        return out
    usual = float(np.median(values[known]))
    spread = MAD_TO_SIGMA * float(np.median(np.abs(values[known] - usual)))
    out[known] = values[known] > max(usual + MAX_ROBUST_SIGMA * spread, MIN_EXCESS_RATIO * usual)
    return out


def draw_rectified(rig: Rig, left: Image, right: Image, pan: Array | None = None) -> bytes:
    """Rectify a pair and draw level lines across both images: PNG, side by side.

    Images are (h, w) grey or (h, w, 3) BGR, as taken, pan (2,), rad, the readings of the bases at
    that pair; None: the rig's own fixed ones. The same input gives the same bytes.

    Source: the rectification is OpenCV's stereoRectify (Bouguet's).
    """
    angles = [rig.left.pan, rig.right.pan] if pan is None else pan.tolist()
    right_T_left = rig.right.camera_T_rig(angles[1]) @ rig.left.rig_T_camera(angles[0])
    turns = cv2.stereoRectify(
        rig.left.matrix, rig.left.distortion, rig.right.matrix, rig.right.distortion,
        rig.image_size, right_T_left[:3, :3], right_T_left[:3, 3:], alpha=0,
    )  # fmt: skip
    new = [np.asarray(turn, dtype=float) for turn in turns[:4]]
    pictures = [_rectify(left, rig.left, *new[::2]), _rectify(right, rig.right, *new[1::2])]
    gap = np.full((len(pictures[0]), GAP, 3), 255, dtype=np.uint8)
    both = np.concatenate([pictures[0], gap, pictures[1]], axis=1)
    for y in np.linspace(0, len(both), N_LINES + 1)[1:-1]:
        cv2.line(both, (0, round(float(y))), (both.shape[1] - 1, round(float(y))), LINE_COLOUR, 1)
    return cv2.imencode(".png", both)[1].tobytes()


def _rectify(picture: Image, camera: Camera, turn: Array, new: Array) -> Image:
    colour = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    height, width = picture.shape[:2]
    scale = PICTURE_WIDTH / width
    smaller = np.diag([scale, scale, 1.0]) @ new[:, :3]
    size = (PICTURE_WIDTH, round(height * scale))
    maps = cv2.initUndistortRectifyMap(
        camera.matrix, camera.distortion, turn, smaller, size, cv2.CV_32FC1
    )
    return np.asarray(cv2.remap(colour, *maps, cv2.INTER_LINEAR), dtype=np.uint8)
