"""Measure by the flange's LEDs how far the hand is from where it was ordered, while the arm stands.

Model: the arm errs by constant offsets of its joints, the registration of its base by a constant
shift,

    z = J(q) delta + b + noise,   z: measured flange pose less the ordered one

    delta  (n,)  joint offsets, rad   prior: zero mean, the claim of [accuracy] in grab.toml
    b      (3,)  shift of the base, m prior: zero mean, what rig.toml states of the base

So a measurement counts for as much as it is better than the claim; where it contradicts the claim
beyond chance, the claim is widened by the root of chi² over its degrees of freedom (R. T. Birge,
1932). Joint offsets carry the error from where it was measured to where the object is.

The flange is measured as by `verify run`, but nothing moves between the two pictures, and the
ordered pose restricts which LED a spot can be; its value enters no result.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import robots
from robots import DhArm
from robots.transforms import carry, difference
from verify.core.fiducials import Marker
from verify.core.records import Array, Image, Index, Measurement, Sighting, Spots, StereoPair
from verify.core.rig import Camera, Rig
from verify.core.statistics import chi2_ppf
from verify.grasping.cell import Cell
from verify.measurement.chain import detect_in_turn
from verify.measurement.correspondence.assign import PosePrediction, assign_leds
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import spot_columns, stated_systematics

MAX_OFFSET = 0.010  # m: an arm that is farther off needs a person, not a correction
MIN_AGREEING = 6  # pictures that agree
# squared Mahalanobis distance of a picture from the others
MAX_SQUARED_DISTANCE = float(chi2_ppf(1 - 1e-6, 6))
MIN_AGREEING_SHARE = 0.75  # of the measured pictures that must agree
SEARCH_RADIUS = 1.5 * MAX_OFFSET  # m from the ordered place: LEDs farther off are not searched
MAX_ROTATION = 0.1  # rad: no offset that moves the hand by so little turns it so far
SURROUNDINGS_PX = 14.0  # about an LED: the background that is fitted with it


@dataclass(frozen=True, slots=True)
class FlangeMeasurement:
    """The flange by its LEDs in one pair of pictures."""

    t: float  # s
    status: str  # of `verify.core.records.Measurement`; or why the pair was not measured
    base_T_flange: Array | None = None  # (4, 4); None: not measured
    covariance: Array | None = None  # (6, 6), m and rad, base axes, of a perturbation on the left
    systematic: Array | None = None  # (6, 6), of what rig and LEDs state of themselves


@dataclass(frozen=True, slots=True)
class ToolOffset:
    """The hand's offset at the object by its LEDs."""

    off: Array  # (3,), m, base frame: the grip point less the ordered one
    covariance: Array  # (3, 3), m²
    used: bool  # the end point is corrected for it; else the margin must have room for it


@dataclass(frozen=True, slots=True)
class OffsetMeasurement:
    """One measurement of the hand before a descent, whatever its outcome."""

    reason: str  # the outcome, in words
    sights: tuple[FlangeMeasurement, ...]
    ordered: Array  # base_T_flange (4, 4)
    read: Array | None = None  # base_T_flange by the encoders
    measured: Array | None = None  # base_T_flange by the LEDs; None: no agreed measurement
    hand: ToolOffset | None = None  # None: nothing is known beside the claim

    @property
    def used(self) -> bool:
        """Whether the end point is corrected."""
        return self.hand is not None and self.hand.used


@dataclass(frozen=True, slots=True)
class _PooledPose:
    pose: Array  # base_T_flange (4, 4)
    off: Array  # (6,), m and rad: less the ordered pose
    covariance: Array  # (6, 6)


def average_sights(sights: Sequence[FlangeMeasurement], ordered: Array) -> _PooledPose | str:
    """Average the pictures that agree, weighted by their covariances; or say why not.

    Errors of a still scene are common to all its pictures (edges beside an LED, the pixel raster):
    the mean keeps the uncertainty of one picture, increased where they scatter by more than that.
    The sights are of an arm that stands, ordered to base_T_flange (4, 4).
    """
    good = [s for s in sights if s.base_T_flange is not None and s.covariance is not None]
    if len(good) < MIN_AGREEING:
        return f"its LEDs were measured in {len(good)} of {len(sights)} pictures"
    poses = np.array([s.base_T_flange for s in good])
    z = difference(poses, ordered)
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
    return _PooledPose(poses[near][middle], mean, one + shared)


def tool_offset(
    found: _PooledPose, arm: DhArm, cell: Cell, base: Array, q_ordered: Array, q_end: Array
) -> ToolOffset:
    """Carry the offset from where it was measured to where the hand will grip.

    The cell holds the gripper, and the arm's claimed accuracy; `base` (3, 3), m², is the stated
    covariance of the base's place, at the hand. The arm was ordered to stand at q_ordered (n,),
    rad, and will be ordered to grip at q_end.
    """
    grip = cell.gripper.flange_T_grip[:3, 3]
    moves, end = robots.jacobian(arm, q_ordered), _grip_jacobian(arm, q_end, grip)
    # as likely for each joint, and so large that the grip point errs by what is claimed
    joint = 3 * cell.accuracy.robot**2 / float((_grip_jacobian(arm, q_ordered, grip) ** 2).sum())
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
    """Derivative of the grip point by the joint angles, (3, n), m/rad."""
    moves = robots.jacobian(arm, q)
    lever = robots.forward(arm, q)[:3, :3] @ grip
    return moves[:3] + np.cross(moves[3:].T, lever).T


def measure_resting_flange(
    pair: StereoPair, rig: Rig, marker: Marker, ordered: Array
) -> Measurement:
    """Measure where the flange stands, by a pair taken while it stood.

    `ordered`: rig_T_flange, (4, 4), within SEARCH_RADIUS and MAX_ROTATION. The status is
    "measured", "too_few_leds", "ambiguous_leds" or "outlier".
    """
    pans = pair.pan_left, pair.pan_right
    spots = detect_in_turn(
        pair,
        _search_window(ordered, marker, rig.left, pans[0], pair.left),
        _search_window(ordered, marker, rig.right, pans[1], pair.right),
    )
    near = PosePrediction(ordered, SEARCH_RADIUS, MAX_ROTATION)
    found = assign_leds(spots, rig, pans, marker, prediction=near)
    n_leds = len({*found.left_led.tolist(), *found.right_led.tolist()})
    if found.status != "measured" or found.rig_T_flange is None:
        return Measurement(pair.frame, pair.t_left, found.status, n_leds)
    left = _sighting(spots[0], found.left_led, found.left_spot, pair.t_left, pair.pan_left)
    right = _sighting(spots[1], found.right_led, found.right_spot, pair.t_left, pair.pan_right)

    def doubt(rig_T_flange: Array, by_point: Array) -> Array:
        """Stated systematics of rig and marker, as changes of the spots."""
        stated = stated_systematics(rig, marker, turning=True)
        return spot_columns(stated, rig, marker, left, right, rig_T_flange, by_point)

    pose = fit_pose(left, right, rig, marker, found.rig_T_flange, doubt)
    status = "measured" if pose.consistent else "outlier"
    return Measurement(pair.frame, pair.t_left, status, n_leds, pose, left, right, found.choice)


def _sighting(spots: Spots, led: Index, spot: Index, t: float, pan: float) -> Sighting:
    """Make a sighting of LEDs at rest: all rows of the picture count as one instant."""
    return Sighting(
        led=led,
        centre=spots.centre[spot],
        covariance=spots.covariance[spot],
        t=t,
        pan=pan,
        peak=spots.peak[spot],
        velocity=np.zeros((len(led), 2)),
        lever=np.zeros((len(led), 3)),
    )


def _search_window(
    ordered: Array, marker: Marker, camera: Camera, pan: float, image: Image
) -> Array:
    """One box around all LEDs, (1, 4) px: x0, y0, x1, y1; pan is rad, as read."""
    points = carry(camera.camera_T_rig(pan) @ ordered, marker.leds)
    points = points[points[:, 2] > 0]  # behind the camera there is nothing to find
    if not len(points):
        return np.zeros((0, 4))
    wide = SEARCH_RADIUS + marker.led_diameter
    border = SURROUNDINGS_PX + camera.matrix[0, 0] * wide / points[:, 2].min()
    pixels = camera.project(points)
    box = np.concatenate([pixels.min(axis=0) - border, pixels.max(axis=0) + border])
    height, width = image.shape[:2]
    kept: Array = np.clip(box, 0, [width, height, width, height])
    return kept[None] if np.all(kept[2:] > kept[:2]) else np.zeros((0, 4))
