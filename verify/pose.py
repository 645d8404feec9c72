"""Sightings and marker to the flange's pose in the rig, by maximum likelihood on reprojection.

Triangulating each LED and fitting a rigid motion throws away most of what the pixels know about
rotation; here all spots of both images are predicted from one pose, and the pose that makes them
most likely is found by Gauss-Newton. An LED seen by one camera counts.

What alignment could not know, the acceleration between two pairs, is a rigid-body quantity: all
spots that were moved share it. It is marginalised, so it correlates their errors instead of
pretending to average out over LEDs.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.marker import Marker
from verify.pose_prediction import predict_spots
from verify.records import Array, Pose, Sighting
from verify.rig import Camera, Rig, distort

# Acceleration assumed a speed, 1/s: arms move in sines near 0.5 Hz (2 pi f = 3) or in ramps of a
# third of a second. The session's own motion corrects it afterwards (comparison.py).
ACCELERATION_PER_SPEED = 3.0
ROUGH_ACCELERATION = (0.02, 0.1)  # m/s², rad/s²: a slow arm still starts and stops
LEVER = 0.1  # m, the size of a marker: makes metres and radians comparable
SCALE = np.repeat([LEVER, 1.0], 3)
SCALES = np.outer(SCALE, SCALE)
# LEDs that barely leave a line: a turn known worse than this is no measurement, and too large
# for the linearisation that its uncertainty rests on.
WORST_KNOWN = 0.1  # rad, or 10 mm at the marker's size
UNDETERMINED = 1e-10  # information a direction, relative to the best: rounding, not measurement
OUTLIER = 20.0  # chi² of one spot, 2 degrees of freedom: 5e-5 false rejections
MODEL_FLOOR_PX = 0.03  # shape of a real LED, lens model: what noise alone does not explain
FEWEST_SPOTS = 5  # ten coordinates for six unknowns: below that none can be accused
MOMENT = 0.01  # s: long against rounding, short against the motion
ITERATIONS = 25
FLOOR = np.eye(2) * 1e-6  # px²
CONVERGED = 1e-10  # m and rad: a thousandth of the smallest uncertainty that pixels allow


@dataclass(frozen=True, slots=True)
class Views:
    """The sightings of both cameras as one stack: s spots, left ones first."""

    points: Array  # (s, 3), m, LEDs in the flange frame
    centre: Array  # (s, 2), px
    covariance: Array  # (s, 2, 2), px²
    velocity: Array  # (s, 2), px/s
    lever: Array  # (s,), s²
    cameras: tuple[
        tuple[Camera, Array, "slice[int, int | None, None]"], ...
    ]  # camera, camera_T_rig, its spots
    # each spot's camera, so that one pass serves both
    camera_R_rig: Array = field(init=False)  # (s, 3, 3)
    origin: Array = field(init=False)  # (s, 3), m, of the rig in the camera
    lens: Array = field(init=False)  # (5, s), k1, k2, p1, p2, k3
    focal: Array = field(init=False)  # (s, 2, 2), px, of the camera's matrix
    middle: Array = field(init=False)  # (s, 2), px, likewise

    def __post_init__(self) -> None:
        count = len(self.points)
        shapes = {
            "camera_R_rig": (count, 3, 3),
            "origin": (count, 3),
            "lens": (5, count),
            "focal": (count, 2, 2),
            "middle": (count, 2),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, np.empty(shape))
        for camera, camera_T_rig, spots in self.cameras:
            self.camera_R_rig[spots] = camera_T_rig[:3, :3]
            self.origin[spots] = camera_T_rig[:3, 3]
            self.lens[:, spots] = camera.distortion[:, None]
            self.focal[spots] = camera.matrix[:2, :2]
            self.middle[spots] = camera.matrix[:2, 2]


# d spots by what is stated of rig and marker, columns of unit variance (2 s, p), at a pose (4, 4)
# and the derivative of its pixels by their points (s, 2, 3)
Doubt = Callable[[Array, Array], Array]


def fit_pose(
    left: Sighting,
    right: Sighting,
    rig: Rig,
    marker: Marker,
    start: Array,
    doubt: Doubt | None = None,
) -> Pose:
    """Find the pose under which both images are most likely.

    Args:
        left: LEDs in the left image, aligned.
        right: LEDs in the right image, at the same instant.
        rig: the cameras.
        marker: the LEDs in the flange frame.
        start: rig_T_flange to begin with, (4, 4). Directions that the LEDs do not determine
            keep its value.
        doubt: how far rig and marker themselves may be off, which must not make an outlier of a
            healthy spot; asked for where a spot looks like one. None: by a rough bound.

    Returns:
        The pose with its covariance; spots that no pose explains with the rest are rejected.
    """
    views = _stack(left, right, rig, marker)
    keep = np.ones(len(views.centre), dtype=bool)
    tolerance = np.diag(np.repeat(_tolerance(views, marker), 2))
    curvature = np.zeros_like(views.centre)
    if views.lever.any():
        rough = _gauss_newton(views, keep, start)
        curvature = _curvature(views, rough.rig_T_flange, rough.twist)
        straight = views.centre - curvature * views.lever[:, None]
        views, start = replace(views, centre=straight), rough.rig_T_flange
    while True:
        fit = _gauss_newton(views, keep, start)
        worst, size = _worst_spot(fit, keep, tolerance)
        if size >= OUTLIER and doubt is not None:
            columns, doubt = doubt(fit.rig_T_flange, fit.by_point), None
            tolerance = tolerance + columns @ columns.T
            worst, size = _worst_spot(fit, keep, tolerance)
        settled = size < OUTLIER
        if settled or keep.sum() <= FEWEST_SPOTS or (~keep).sum() >= len(keep) // 3:
            return _pose(fit, views, keep, settled, curvature)
        keep[worst] = False


def _stack(left: Sighting, right: Sighting, rig: Rig, marker: Marker) -> Views:
    m = len(left)
    camera_T_rig: list[Array] = [
        camera.camera_T_rig(sighting.pan)
        for camera, sighting in ((rig.left, left), (rig.right, right))
    ]
    return Views(
        points=marker.leds[np.concatenate([left.led, right.led])],
        centre=np.concatenate([left.centre, right.centre]),
        covariance=np.concatenate([left.covariance, right.covariance]),
        velocity=np.concatenate([left.velocity, right.velocity]),
        lever=np.concatenate([left.acceleration_lever, right.acceleration_lever]),
        cameras=(
            (rig.left, camera_T_rig[0], slice(0, m)),
            (rig.right, camera_T_rig[1], slice(m, None)),
        ),
    )


def predict(views: Views, rig_T_flange: Array) -> tuple[Array, Array, Array]:
    """Where the spots should be, and how that changes with the pose.

    Returns:
        pixels (s, 2); their derivative by the point in the rig (s, 2, 3), px/m; and by the pose
        (s, 2, 6), a translation and a rotation vector in rig axes.
    """
    count = len(views.points)
    pixels, by_point = np.empty((count, 2)), np.empty((count, 2, 3))
    by_pose = np.empty((count, 2, 6))
    predict_spots(
        rig_T_flange,
        views.points,
        views.camera_R_rig,
        views.origin,
        views.lens,
        views.focal,
        views.middle,
        pixels,
        by_point,
        by_pose,
    )
    return pixels, by_point, by_pose


def _seen(views: Views, points_rig: Array) -> tuple[Array, Array]:
    """Ideal image coordinates (s, 2) and depths (s, 1), m, of points in the rig."""
    local = (views.camera_R_rig @ points_rig[..., None])[..., 0] + views.origin
    depth = local[:, 2:]
    return local[:, :2] / depth, depth


def _pixels(views: Views, distorted: Array) -> Array:
    pixels: Array = (views.focal @ distorted[..., None])[..., 0] + views.middle
    return pixels


@dataclass(frozen=True, slots=True)
class _Fit:
    rig_T_flange: Array
    residual: Array  # (s, 2)
    by_point: Array  # (s, 2, 3)
    by_pose: Array  # (s, 2, 6)
    noise: Array  # (2 k, 2 k) of the kept spots: pixels
    acceleration: Array  # (2 k, 2 k): alignment
    twist: Array  # (6,)
    prior: tuple[float, float]
    gain: Array  # (6, 2 k)
    determined: Array  # (6, d)


def _gauss_newton(views: Views, keep: NDArray[np.bool_], start: Array) -> _Fit:
    pose = np.array(start, dtype=float)
    rows = np.repeat(keep, 2)
    for iteration in range(ITERATIONS):
        pixels, by_point, by_pose = predict(views, pose)
        residual = views.centre - pixels
        design = by_pose.reshape(-1, 6)[rows]
        if iteration == 0:  # velocities and their lever change nothing measurable in later rounds
            noise = _block_diagonal(views.covariance[keep])
            twist, prior = _motion(views, design, keep)
            acceleration = _acceleration(views, by_pose, keep, prior)
            weight = np.linalg.inv(noise + acceleration)
        weighted = design.T @ weight
        inverse, determined = _inverse(weighted @ design)
        gain = inverse @ weighted
        step = gain @ residual.reshape(-1)[rows]
        pose = perturb(pose, step)
        if np.abs(step).max() < CONVERGED:
            break
    return _Fit(
        pose, residual, by_point, by_pose, noise, acceleration, twist, prior, gain, determined
    )


def perturb(pose: Array, step: Array) -> Array:
    """Move a pose by a translation and a small rotation vector, both in the outer frame's axes."""
    moved = pose.copy()
    moved[:3, :3] = cv2.Rodrigues(step[3:])[0] @ pose[:3, :3]
    moved[:3, 3] += step[:3]
    return moved


def _inverse(information: Array) -> tuple[Array, Array]:
    """Covariance in the determined directions, and the functionals that are determined.

    The information matrix of one or two LEDs (or of LEDs on one line) is singular; its null
    vectors are the motions that no picture shows.
    """
    values, vectors = np.linalg.eigh(information * SCALES)
    known = (values > UNDETERMINED * values[-1]) & (values > WORST_KNOWN**-2)
    if known.all():
        return (vectors / values) @ vectors.T * SCALES, np.eye(6)
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T * SCALES
    hidden = vectors[:, ~known] * SCALE[:, None]
    complement = np.linalg.svd(hidden, full_matrices=True)[0][:, hidden.shape[1] :]
    return inverse, complement


def _motion(
    views: Views, design: Array, keep: NDArray[np.bool_]
) -> tuple[Array, tuple[float, float]]:
    """How the flange moves, from the spots' velocities, and the acceleration that this suggests."""
    velocity = views.velocity[keep].reshape(-1)
    if not velocity.any():
        return np.zeros(6), ROUGH_ACCELERATION
    scaled = design * SCALE
    square = scaled.T @ scaled
    ridge = 1e-6 * np.trace(square) / 6  # keeps one or two LEDs solvable
    twist = SCALE * np.linalg.solve(square + ridge * np.eye(6), scaled.T @ velocity)
    linear = ACCELERATION_PER_SPEED * math.hypot(*twist[:3].tolist()) + ROUGH_ACCELERATION[0]
    angular = ACCELERATION_PER_SPEED * math.hypot(*twist[3:].tolist()) + ROUGH_ACCELERATION[1]
    return twist, (linear / np.sqrt(3), angular / np.sqrt(3))  # a component


def _acceleration(
    views: Views, by_pose: Array, keep: NDArray[np.bool_], prior: tuple[float, float]
) -> Array:
    """Covariance of the kept spots from the unknown acceleration, (2 k, 2 k), px²."""
    moved = (by_pose[keep] * views.lever[keep][:, None, None]).reshape(-1, 6)
    spread = np.repeat(np.square(prior), 3)
    covariance: Array = (moved * spread) @ moved.T
    return covariance


def _block_diagonal(blocks: Array) -> Array:
    matrix = np.zeros((len(blocks), 2, len(blocks), 2))
    np.einsum("iaib->iab", matrix)[:] = blocks
    return matrix.reshape(2 * len(blocks), -1)


def _tolerance(views: Views, marker: Marker) -> Array:
    """Variance a spot may show beside its noise before it counts as an outlier, (s,), px²."""
    shift = marker.centre_shift_standard_uncertainty or 0.0
    led = marker.led_standard_uncertainty or 0.0
    # half a metre: nearer than LEDs are watched, so the bound is generous
    return MODEL_FLOOR_PX**2 + np.square(views.focal[:, 0, 0] / 0.5) * (shift**2 + led**2)


def _worst_spot(fit: _Fit, keep: NDArray[np.bool_], tolerance: Array) -> tuple[int, float]:
    """The kept spot that fits worst, by its own residual in its own uncertainty."""
    rows = np.repeat(keep, 2)
    total = fit.noise + fit.acceleration + tolerance[rows][:, rows]
    design = fit.by_pose[keep].reshape(-1, 6)
    hat = np.eye(len(total)) - design @ fit.gain
    spread = (hat @ total @ hat.T).reshape(keep.sum(), 2, -1, 2)
    residual = fit.residual[keep]
    # a spot that nothing else checks has no residual to speak of: floor against 0/0
    block = np.einsum("iaib->iab", spread) + FLOOR
    size = np.sum(residual * np.linalg.solve(block, residual[..., None])[..., 0], axis=1)
    worst = int(np.argmax(size))
    return int(np.flatnonzero(keep)[worst]), float(size[worst])


def _curvature(views: Views, rig_T_flange: Array, twist: Array) -> Array:
    """Image acceleration of a flange that keeps its twist, (s, 2), px/s².

    LEDs that turn about the flange, and points that come nearer, do not cross the image at a
    steady rate even then. It points one way, so it would not average out.
    """
    if not twist.any():
        return np.zeros_like(views.centre)
    moments = (perturb(rig_T_flange, twist * h) for h in (-MOMENT, 0.0, MOMENT))
    points = (views.points @ pose[:3, :3].T + pose[:3, 3] for pose in moments)
    early, now, late = (
        _pixels(views, distort(_seen(views, place)[0], views.lens)) for place in points
    )
    second: Array = (early + late - 2 * now) / MOMENT**2
    return second


def _pose(
    fit: _Fit, views: Views, keep: NDArray[np.bool_], consistent: bool, curvature: Array
) -> Pose:
    spread = np.repeat(np.square(fit.prior), 3)  # of the acceleration's components
    kept = fit.residual[keep].reshape(-1)
    gain = np.zeros((6, 2 * len(keep)))
    gain[:, np.repeat(keep, 2)] = fit.gain
    return Pose(
        rig_T_flange=fit.rig_T_flange,
        covariance_pixels=fit.gain @ fit.noise @ fit.gain.T,
        covariance_alignment=fit.gain @ fit.acceleration @ fit.gain.T,
        twist=fit.twist,
        acceleration_prior=fit.prior,
        determined=fit.determined,
        gain=gain,
        sensitivity=fit.by_point,
        curvature=curvature,
        residual=fit.residual,
        spot_uncertainty=np.sqrt(
            np.einsum("saa->s", views.covariance) / 2
            + np.sum((fit.by_pose * views.lever[:, None, None]) ** 2 @ spread, axis=1) / 2
        ),
        rejected=~keep,
        consistent=consistent,
        chi2=float(kept @ np.linalg.solve(fit.noise + fit.acceleration, kept)),
        degrees_of_freedom=len(kept) - fit.determined.shape[1],
    )
