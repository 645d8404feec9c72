"""What a calibration from boards is worth: fit, coverage, accuracy of a point, what helps most."""

from dataclasses import dataclass

import numpy as np

from verify.calibration.covariance import in_si
from verify.calibration.quality_accuracy import SPOT, Field, field, parameters, sight
from verify.calibration.quality_coverage import ImageCoverage, Stance, image_coverage, stances
from verify.calibration.quality_views import View, rms, views
from verify.calibration.records import Calibration
from verify.records import Array
from verify.rig import Camera

ODD = 0.1  # of the image's size: a principal point farther off its centre wants an explanation
SURE = 4.0  # standard uncertainties between the principal point and the centre
ROUND = 0.05  # m, to which the distances of the maps are rounded
SIDES = ("left", "right")
GROUPS = {  # key of a parameter, without its unit, to what it belongs to
    "fx": "focal lengths",
    "fy": "focal lengths",
    "cx": "principal points",
    "cy": "principal points",
    **dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), "lens distortion"),
    **dict.fromkeys(("mount_rx", "mount_ry", "mount_rz"), "cameras' turns"),
    **dict.fromkeys((f"mount_{axis}" for axis in "xyz"), "cameras' places"),
    **dict.fromkeys((f"pan_center_{axis}" for axis in "xyz"), "cameras' places"),
    **dict.fromkeys((f"pan_axis_r{axis}" for axis in "xyz"), "pan axes and zeros"),
    "pan_zero": "pan axes and zeros",
}
NOISE, READINGS = "spot noise", "pan readings"


@dataclass(frozen=True, slots=True)
class PrincipalPoint:
    """Where a camera's optical axis meets the image, and whether to believe it."""

    camera: int
    offset: Array  # (2,), px, from the image's centre
    distance: float  # px
    uncertainty: float | None  # px, standard, along the offset; None: held, or not stated
    odd: bool  # farther off the centre than a camera as it is sold
    believed: bool  # the pictures give it: many times its own uncertainty away from the centre


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one group of parameters does to the depth of a point in the middle of the view."""

    group: str
    alone: float  # m, standard uncertainty of the depth, were all else exact
    without: float  # m, what would be left of it, were this group exact


@dataclass(frozen=True, slots=True)
class Quality:
    """What the boards say of the rig they calibrated."""

    rms: tuple[float, float, float]  # px: both cameras, left, right
    views: tuple[View, ...]
    coverage: tuple[ImageCoverage, ...]
    stances: tuple[Stance, ...]
    principal_points: tuple[PrincipalPoint, ...]
    pan: Array  # (2,), rad, for which the fields hold
    working_distance: float  # m, median distance of the boards
    fields: tuple[Field, ...]  # nearest first
    contributions: tuple[Contribution, ...]  # what would help most first


def judge(calibration: Calibration, pan: Array | None = None) -> Quality:
    """Say what a calibration is worth.

    Args:
        calibration: with the rig's covariance.
        pan: (b, 2), rad, readings of the bases at its pairs; None: the rig's own fixed ones.

    Raises:
        ValueError: the rig states no covariance, or `pan` does not fit the pairs.
    """
    rig = calibration.rig
    if pan is None:
        pan = np.tile([rig.left.pan, rig.right.pan], (len(calibration.frames), 1))
    if pan.shape != (len(calibration.frames), 2):
        raise ValueError(f"{len(calibration.frames)} pairs need as many pan readings")
    usual = np.median(pan, axis=0)
    stood = stances(calibration, pan)
    near, working, far = _distances([s.distance for s in stood])
    used = calibration.residuals.used
    left = calibration.residuals.camera == 0
    return Quality(
        rms=(
            rms(calibration.residuals.residual[used]),
            rms(calibration.residuals.residual[used & left]),
            rms(calibration.residuals.residual[used & ~left]),
        ),
        views=views(calibration.residuals),
        coverage=image_coverage(calibration),
        stances=stood,
        principal_points=tuple(_principal_point(calibration, side) for side in (0, 1)),
        pan=usual,
        working_distance=working,
        fields=tuple(
            field(rig, usual, d, calibration.turning) for d in sorted({near, working, far})
        ),
        contributions=_contributions(calibration, usual, working),
    )


def _distances(boards: list[float]) -> tuple[float, float, float]:
    """Nearest, median and farthest distance of the boards, rounded; some may coincide."""
    wanted = np.quantile(boards, [0.0, 0.5, 1.0])
    near, median, far = np.maximum(np.round(wanted / ROUND), 1).tolist()
    return round(near * ROUND, 6), round(median * ROUND, 6), round(far * ROUND, 6)


def _principal_point(calibration: Calibration, side: int) -> PrincipalPoint:
    camera: Camera = (calibration.rig.left, calibration.rig.right)[side]
    size = np.array(calibration.rig.image_size)
    offset = camera.matrix[:2, 2] - (size - 1) / 2  # pixel centres at whole numbers
    distance = float(np.linalg.norm(offset))
    u = _along(calibration, [f"{SIDES[side]}.{key}_px" for key in ("cx", "cy")], offset)
    odd = bool(np.any(np.abs(offset) > ODD * size))
    sure = u is not None and distance > SURE * u
    return PrincipalPoint(side, offset, distance, u, odd, sure)


def _along(calibration: Calibration, names: list[str], way: Array) -> float | None:
    """Standard uncertainty of some parameters in one direction; None where not all are stated."""
    given = calibration.rig.covariance
    if given is None or not set(names) <= set(given.parameters) or not way.any():
        return None
    rows = [given.parameters.index(name) for name in names]
    unit = way / np.linalg.norm(way)
    return float(np.sqrt(unit @ in_si(given)[np.ix_(rows, rows)] @ unit))


def _contributions(
    calibration: Calibration, pan: Array, distance: float
) -> tuple[Contribution, ...]:
    """Split the variance of a depth by what would be left of it, were a group exact.

    The parts do not add up: parameters found from the same pictures hang together.
    """
    names, covariance = parameters(calibration.rig, calibration.turning)
    found = sight(calibration.rig, pan, np.array([[0.0, 0.0, distance]]), names)
    slope = found.by_rig[:, 0, 2]
    noise = float(SPOT**2 * np.sum(found.by_pixels[0, 2] ** 2))
    systematic = float(slope @ covariance @ slope)
    split = [Contribution(NOISE, float(np.sqrt(noise)), float(np.sqrt(systematic)))]
    groups = _groups(calibration, names)
    for group in dict.fromkeys(groups):
        own = np.array([g == group for g in groups])
        inner = covariance[np.ix_(own, own)]
        common = covariance[own] @ slope
        gone = float(common @ np.linalg.pinv(inner, hermitian=True) @ common)
        alone = float(slope[own] @ inner @ slope[own])
        left = max(systematic + noise - gone, 0.0)
        split.append(Contribution(group, float(np.sqrt(alone)), float(np.sqrt(left))))
    return tuple(sorted(split, key=lambda c: (c.without, c.group)))


def _groups(calibration: Calibration, names: tuple[str, ...]) -> list[str]:
    """Name the group of each parameter; what stands beyond the rig's own is a pan reading."""
    given = calibration.rig.covariance
    cameras = sum(n.startswith(("left.", "right.")) for n in given.parameters) if given else 0
    groups = []
    for index, name in enumerate(names):
        key = name.partition(".")[2].removesuffix("_px").removesuffix("_mm").removesuffix("_deg")
        groups.append(READINGS if index >= cameras else GROUPS[key])
    return groups
