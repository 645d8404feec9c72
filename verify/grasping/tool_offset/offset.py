"""By how much the hand is elsewhere than it was told to be: from LEDs seen while the arm stands.

Model: the arm errs by constant offsets of its joints, the registration of its base by a constant
shift: z = J(q) δ + b + noise, z being the measured flange pose less the told one. Both have priors
of zero mean (what `[accuracy]` claims of the arm, what rig.toml states of the base), so a
measurement counts for as much as it is better than the claim; where it contradicts the claim beyond
chance, the claim is widened by the root of χ² over its degrees of freedom (R. T. Birge, 1932).
Offsets of joints carry the error from where it was measured to where the object is.

The flange of an arm that stands about where it was told to: measured in one pair of pictures.

The chain of `verify run`, but for two things: nothing moves between the pictures, and where the
arm was told to stand says where to look, and which of several LEDs a spot can be. That is a choice:
its value enters no result.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

import robots
from robots import DhArm
from robots.transforms import difference
from verify.core.fiducials import Marker
from verify.core.records import Array, Image, Measurement, Sighting, Spots, StereoPair
from verify.core.rig import Camera, Rig
from verify.core.statistics import chi2_ppf
from verify.grasping.cell import Cell
from verify.measurement.correspondence.assign import PosePrediction, assign_leds
from verify.measurement.detection.detect import detect
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import spot_columns, stated_systematics

MAX_OFFSET = 0.010  # m: an arm that is farther off needs a person, not a correction
MIN_AGREEING = 6  # pictures that agree
MAX_SQUARED_DISTANCE = float(
    chi2_ppf(1 - 1e-6, 6)
)  # squared Mahalanobis distance of a picture from the others
MIN_AGREEING_SHARE = 0.75  # of the measured pictures that must agree


@dataclass(frozen=True, slots=True)
class FlangeMeasurement:
    """The flange by its LEDs in one pair of pictures."""

    t: float  # s
    status: str  # of `verify.core.records.Measurement`; or why the pair was not measured
    base_T_flange: Array | None  # (4, 4); None: not measured
    covariance: Array | None  # (6, 6), m and rad, base axes, of a perturbation on the left
    systematic: Array | None  # (6, 6), likewise: what rig and LEDs state of themselves


@dataclass(frozen=True, slots=True)
class ToolOffset:
    """What the LEDs say of the hand's place at the object."""

    off: Array  # (3,), m, base frame: where the grip point is less where it is told to be
    covariance: Array  # (3, 3), m²
    used: bool  # the end point is corrected for it; else the margin must have room for it


@dataclass(frozen=True, slots=True)
class OffsetMeasurement:
    """One look at the hand before a descent, whatever came of it."""

    reason: str  # what came of it, in words
    sights: tuple[FlangeMeasurement, ...]
    told: Array  # base_T_flange (4, 4), as ordered
    read: Array | None  # likewise, by the encoders
    measured: Array | None  # likewise, by the LEDs; None: no agreed measurement
    hand: ToolOffset | None  # None: nothing is known beside the claim

    @property
    def used(self) -> bool:
        """Whether the end point is corrected."""
        return self.hand is not None and self.hand.used


@dataclass(frozen=True, slots=True)
class _PooledPose:
    pose: Array  # base_T_flange (4, 4)
    off: Array  # (6,), m and rad: less the told pose
    covariance: Array  # (6, 6)
    count: int


def average_sights(sights: Sequence[FlangeMeasurement], told: Array) -> _PooledPose | str:
    """Average the pictures that agree, weighed by their covariances; or say why they cannot be.

    A still scene errs alike in all its pictures (edges beside an LED, the pixels' raster): the mean
    keeps the uncertainty of one picture, and grows where the pictures scatter by more than that.

    Args:
        sights: of an arm that stands.
        told: base_T_flange (4, 4), as ordered.
    """
    good = [s for s in sights if s.base_T_flange is not None and s.covariance is not None]
    if len(good) < MIN_AGREEING:
        return f"its LEDs were measured in {len(good)} of {len(sights)} pictures"
    poses = np.array([s.base_T_flange for s in good])
    z = difference(poses, told)
    each = np.array([s.covariance for s in good])
    weights = np.linalg.inv(each)
    apart = z - np.median(z, axis=0)
    near = np.einsum("ki,kij,kj->k", apart, weights, apart) < MAX_SQUARED_DISTANCE
    if near.sum() < max(MIN_AGREEING, MIN_AGREEING_SHARE * len(good)):
        return "pictures of its LEDs contradict each other"
    z, weights, each = z[near], weights[near], each[near]
    mean = np.linalg.solve(weights.sum(axis=0), np.einsum("kij,kj->i", weights, z))
    scatter = np.einsum("ki,kij,kj->", z - mean, weights, z - mean) / (6 * (len(z) - 1))
    one = each.mean(axis=0) * max(1.0, float(scatter))
    stated = [s.systematic for s, kept in zip(good, near, strict=True) if kept]
    shared = next((s for s in stated if s is not None), np.zeros((6, 6)))
    middle = int(np.argmin(np.abs(z - mean) @ (1 / np.sqrt(np.diag(one)))))
    return _PooledPose(poses[near][middle], mean, one + shared, len(z))


def tool_offset(
    found: _PooledPose, arm: DhArm, cell: Cell, base: Array, q_told: Array, q_end: Array
) -> ToolOffset:
    """Carry what was measured where the arm stands to where it will grip.

    Args:
        found: the LEDs' word.
        arm: that was told.
        cell: the gripper, and what is claimed of the arm.
        base: (3, 3), m², what is stated of the base's place, at the hand.
        q_told: (n,), rad, where it was told to stand.
        q_end: (n,), rad, where it will be told to grip.
    """
    grip = cell.gripper.flange_T_grip[:3, 3]
    moves, end = robots.jacobian(arm, q_told), _grip_jacobian(arm, q_end, grip)
    # as likely for each joint, and so large that the grip point errs by what is claimed
    joint = 3 * cell.accuracy.robot**2 / float((_grip_jacobian(arm, q_told, grip) ** 2).sum())
    prior = np.zeros((arm.dof + 3, arm.dof + 3))
    prior[: arm.dof, : arm.dof] = np.eye(arm.dof) * joint
    prior[arm.dof :, arm.dof :] = base
    shows = np.hstack([moves, np.vstack([np.eye(3), np.zeros((3, 3))])])
    expected = shows @ prior @ shows.T
    beyond = float(found.off @ np.linalg.solve(expected + found.covariance, found.off)) / 6
    prior, expected = prior * max(1.0, beyond), expected * max(1.0, beyond)
    gain = np.linalg.solve(expected + found.covariance, shows @ prior).T
    causes, left = gain @ found.off, prior - gain @ shows @ prior
    carried = np.hstack([end, np.eye(3)])
    off = carried @ causes
    within = float(np.linalg.norm(off)) <= MAX_OFFSET
    return ToolOffset(off, carried @ left @ carried.T, within)


def _grip_jacobian(arm: DhArm, q: Array, grip: Array) -> Array:
    """How the grip point moves with each joint, (3, n), m/rad."""
    moves = robots.jacobian(arm, q)
    lever = robots.forward(arm, q)[:3, :3] @ grip
    found: Array = moves[:3] + np.cross(moves[3:].T, lever).T
    return found


SEARCH_RADIUS = (
    1.5 * MAX_OFFSET
)  # m: LEDs that are farther from where they are told are not looked for
MAX_ROTATION = 0.1  # rad: no offset that moves the hand by so little turns it so far
SURROUNDINGS_PX = 14.0  # about an LED: the background that is fitted with it


def measure_resting_flange(pair: StereoPair, rig: Rig, marker: Marker, told: Array) -> Measurement:
    """Measure where the flange stands.

    Args:
        pair: taken while it stood.
        rig: the cameras.
        marker: the LEDs.
        told: rig_T_flange, (4, 4), within SEARCH_RADIUS and MAX_ROTATION.

    Returns:
        Its status is "measured", "too_few_leds", "ambiguous_leds" or "outlier".
    """
    pans = pair.pan_left, pair.pan_right
    spots = (
        detect(pair.left, _search_window(told, marker, rig.left, pans[0], pair.left)),
        detect(pair.right, _search_window(told, marker, rig.right, pans[1], pair.right)),
    )
    near = PosePrediction(told, SEARCH_RADIUS, MAX_ROTATION)
    found = assign_leds(spots[0], spots[1], rig, pans[0], pans[1], marker, prediction=near)
    seen = len({*found.left_led.tolist(), *found.right_led.tolist()})
    if found.status != "measured" or found.rig_T_flange is None:
        return Measurement(pair.frame, pair.t_left, found.status, seen)
    left = _sighting(spots[0], found.left_led, found.left_spot, pair.t_left, pair.pan_left)
    right = _sighting(spots[1], found.right_led, found.right_spot, pair.t_left, pair.pan_right)
    doubt = partial(_systematic_columns, rig, marker, left, right)
    pose = fit_pose(left, right, rig, marker, found.rig_T_flange, doubt)
    status = "measured" if pose.consistent else "outlier"
    return Measurement(pair.frame, pair.t_left, status, seen, pose, left, right, found.choice)


def _sighting(
    spots: Spots, led: NDArray[np.int64], spot: NDArray[np.int64], t: float, pan: float
) -> Sighting:
    """LEDs that stand still: wherever in the picture they are, it is one instant."""
    return Sighting(
        led=led,
        centre=spots.centre[spot],
        covariance=spots.covariance[spot],
        t=t,
        pan=pan,
        peak=spots.peak[spot],
        velocity=np.zeros((len(led), 2)),
        acceleration_lever=np.zeros(len(led)),
    )


def _systematic_columns(
    rig: Rig, marker: Marker, left: Sighting, right: Sighting, rig_T_flange: Array, by_point: Array
) -> Array:
    """What rig and marker state of themselves, as the spots would show it."""
    parameters = stated_systematics(rig, marker, turning=True)
    return spot_columns(parameters, left, right, rig_T_flange, by_point, rig, marker)


def _search_window(told: Array, marker: Marker, camera: Camera, pan: float, image: Image) -> Array:
    """One box around all LEDs, (1, 4) px: x0, y0, x1, y1; pan is rad, as read."""
    camera_T_flange = camera.camera_T_rig(pan) @ told
    points = marker.leds @ camera_T_flange[:3, :3].T + camera_T_flange[:3, 3]
    points = points[points[:, 2] > 0]  # behind the camera there is nothing to look for
    if not len(points):
        return np.zeros((0, 4))
    wide = SEARCH_RADIUS + marker.led_diameter
    border = SURROUNDINGS_PX + camera.matrix[0, 0] * wide / points[:, 2].min()
    pixels = camera.project(points)
    box = np.concatenate([pixels.min(axis=0) - border, pixels.max(axis=0) + border])
    height, width = image.shape[:2]
    kept: Array = np.clip(box, 0, [width, height, width, height])
    return kept[None] if np.all(kept[2:] > kept[:2]) else np.zeros((0, 4))
