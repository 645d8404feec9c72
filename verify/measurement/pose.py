"""Fit the flange's pose in the rig to the LED spots of both images by maximum likelihood.

Model of spot i of camera c, at the pair's instant:

    z_i = project_c(camera_T_rig (R p_i + p)) + J_i sum_k h_ik a_k + e_i,   e_i ~ N(0, S_i), px
    step: R' = exp(phi) R,   p' = p + rho,   both in rig axes

p_i is the LED in the flange frame, S_i the spot's covariance, J_i the derivative by the pose (2, 6)
and h_ik alignment's levers of acceleration, jerk and snap, s², s³, s⁴. Parameter vector of a step:

    index  symbol  meaning                              unit
    0-2    rho     translation of the flange, rig axes  m
    3-5    phi     rotation vector, rig axes            rad

The acceleration a_1, (6,) m/s² and rad/s², is unknown between two pairs, the jerk a_2 among three,
the snap a_3 among four. They are common to all spots of the rigid body: with priors N(0,
diag(sigma²)) they are marginalised, which correlates the spots' errors. An LED in one image alone
counts. Spots that contradict the others are rejected one by one.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from robots.transforms import difference
from verify.core.fiducials import Marker
from verify.core.records import Array, Flags, Index, Pose, Sighting
from verify.core.rig import Camera, Rig
from verify.core.statistics import chi2_bound
from verify.measurement.kernels import entries as kernel
from verify.measurement.kernels.entries import MOTION_RATE, SCALE

MAX_SPOT_CHI2 = 20.0  # chi² of one spot, 2 degrees of freedom: 5e-5 false rejections
P_CONTRADICTION = 1e-7  # of the pair's chi² as a whole
MODEL_ERROR_PX = 0.03  # shape of a real LED, lens model: what noise alone does not explain
IDENTITY = np.eye(6)
MIN_ACROSS = 1e-6  # m and 1: an LED on the line, or a ray along it, shows no turn
MIN_SHARE = 0.025  # of the likelihood of two poses: an interval of 95 % need not hold one of less
MIN_SPOTS = 5  # ten coordinates for six unknowns: below that none can be accused


@dataclass(frozen=True, slots=True)
class SightingStack:
    """The sightings of both cameras: s spots, left ones first."""

    led: Index  # (s,)
    points: Array  # (s, 3), m, LEDs in the flange frame
    centre: Array  # (s, 2), px
    covariance: Array  # (s, 2, 2), px²
    velocity: Array  # (s, 2), px/s
    lever: Array  # (s, 3), s², s³, s⁴
    cameras: Array  # (2, 23), left and right, as `kernels.entries.predict_spots` has them
    left: int  # spots of the left camera

    @property
    def places(self) -> tuple[Array, Array, int]:
        """Arguments of a prediction beside the pose."""
        return self.points, self.cameras, self.left


def stack_sightings(left: Sighting, right: Sighting, rig: Rig, points: Array) -> SightingStack:
    """Stack both cameras' sightings of points (n, 3), m, in the flange frame."""
    led = np.concatenate([left.led, right.led])
    return SightingStack(
        led,
        points[led],
        np.concatenate([left.centre, right.centre]),
        np.concatenate([left.covariance, right.covariance]),
        np.concatenate([left.velocity, right.velocity]),
        np.concatenate([left.lever, right.lever]),
        camera_rows(rig.left, rig.right, left.pan, right.pan),
        len(left),
    )


@lru_cache(maxsize=16)
def camera_rows(left: Camera, right: Camera, pan_left: float, pan_right: float) -> Array:
    """Both cameras, as `SightingStack` has them; kept, as a pair is fitted more than once."""
    placed = (left, left.camera_T_rig(pan_left)), (right, right.camera_T_rig(pan_right))
    return np.array(
        [[*pose[:3].flat, *one.distortion, *one.matrix[:2].flat] for one, pose in placed]
    )


# d spots by what is stated of rig and marker, columns of unit variance (2 s, p), at a pose (4, 4)
# and the derivative of its pixels by their points (s, 2, 3)
ParameterColumns = Callable[[Array, Array], Array]


def fit_pose(
    left: Sighting,
    right: Sighting,
    rig: Rig,
    marker: Marker,
    start: Array,
    parameter_columns: ParameterColumns | None = None,
) -> Pose:
    """Find the pose under which both images, aligned to the same instant, are most likely.

    From `start`, rig_T_flange (4, 4): directions that the LEDs do not determine keep its value.
    `parameter_columns` gives the stated uncertainty of rig and marker as columns of the spots,
    which must not make an outlier of a good spot; called where a spot looks like one. None: a rough
    bound alone. Spots that no pose explains with the rest are rejected. Where two LEDs are in both
    images and others in one, two poses may explain them: what stays open widens the covariance.
    """
    views = stack_sightings(left, right, rig, marker.leds)
    return fit_stack(views, rig, marker, start, parameter_columns)


def fit_stack(
    views: SightingStack,
    rig: Rig,
    marker: Marker,
    start: Array,
    parameter_columns: ParameterColumns | None = None,
    *,
    expected: tuple[Array, float] | None = None,
) -> Pose:
    """`fit_pose` for sightings of the marker that are stacked already.

    `expected`, a pose (4, 4) and the standard uncertainty of its turn, rad, helps to choose where
    two poses may explain the spots.
    """
    keep = np.ones(len(views.centre), dtype=np.bool_)
    sigmas = marker.centre_shift_standard_uncertainty or 0, marker.led_standard_uncertainty or 0
    counts = views.left, len(views.centre) - views.left
    tolerance = _tolerance(rig.left, rig.right, counts, sigmas)
    while True:
        fit, doubt = _likelier_fit(views, keep, start, marker.leds, tolerance, expected)
        worst, size, agree = fit.judgement
        sound = agree and size < MAX_SPOT_CHI2
        if not sound and parameter_columns is not None:
            columns = parameter_columns(fit.rig_T_flange, fit.predicted[1])
            tolerance, parameter_columns = tolerance + columns @ columns.T, None
            continue
        kept = int(np.count_nonzero(keep))
        last = kept <= MIN_SPOTS or len(keep) - kept >= len(keep) // 3
        if last or size < MAX_SPOT_CHI2:
            return _pose(fit, keep, sound, doubt)
        keep[worst] = False


def predict(views: SightingStack, rig_T_flange: Array) -> tuple[Array, Array, Array]:
    """Predict the spots from a pose: pixels (s, 2), with the derivatives.

    By the point in the rig (s, 2, 3), px/m; and by the pose (s, 2, 6), a translation and a rotation
    vector in rig axes.
    """
    return kernel.predict_spots(rig_T_flange, *views.places)


def motion_columns(by_pose: Array, lever: Array, prior: tuple[float, float]) -> Array:
    """What motion that is not known does to spots, columns of unit variance, (s, 2, 18), px.

    `by_pose` (s, 2, 6), derivative of the spots by the pose; `lever` (s, 3), s², s³, s⁴; `prior` of
    the acceleration, m/s² and rad/s² a component.
    """
    moved = by_pose * np.repeat(prior, 3)
    levers = lever * MOTION_RATE ** np.arange(lever.shape[1])
    columns: Array = moved[:, :, None] * levers[:, None, :, None]
    return columns.reshape(*moved.shape[:2], -1)


@dataclass(frozen=True, slots=True)
class _PoseFit:
    """A fitted pose, and what `kernels.entries.fit_spots` returns beside it."""

    rows: Index  # (2 k,), which of the coordinates are those of kept spots
    rig_T_flange: Array  # (4, 4)
    judgement: kernel.Judgement  # under the tolerance
    predicted: tuple[Array, Array, Array]  # residual, derivatives by the point and by the pose
    spread: Array  # (2, 2 s, 2 s), covariance from pixels and from alignment
    gain: Array  # (6, 2 s), 0 for spots that are not kept
    directions: tuple[Array, Flags]  # of the pose, and whether spots determine them
    twist: Array  # (6,)
    prior: tuple[float, float]
    curvature: Array  # (s, 2), px/s²
    figures: tuple[Array, Array, Array, float]  # covariances, uncertainty and chi² of that


def _gauss_newton(views: SightingStack, keep: Flags, start: Array, tolerance: Array) -> _PoseFit:
    pose = np.array(start, dtype=float, order="C")
    spots = views.covariance, views.velocity, views.lever
    rows = keep.repeat(2).nonzero()[0]
    limits = tolerance, _chi2_bounds(2 * len(views.centre))
    found = kernel.fit_spots(views.places, views.centre, spots, rows, pose, limits)
    return _PoseFit(rows, pose, *found)


@lru_cache(maxsize=16)
def _chi2_bounds(count: int) -> Array:
    """Greatest chi² of spots that do not contradict each other, by degrees of freedom from 0."""
    return np.array([np.inf, *(chi2_bound(P_CONTRADICTION, n) for n in range(1, count + 1))])


def _likelier_fit(
    views: SightingStack,
    keep: Flags,
    start: Array,
    leds: Array,
    tolerance: Array,
    expected: tuple[Array, float] | None,
) -> tuple[_PoseFit, Array | None]:
    """Fit from a start, or from the second pose that explains the spots if that is likelier.

    Gives too what a choice between both adds to the pose's covariance, (6, 6); None: no choice.
    """
    fit = _gauss_newton(views, keep, start, tolerance)
    if len(fit.rows) == 4 * views.left == 4 * len(leds):  # both images show the whole marker
        return fit, None
    left, right = np.split(views.led, [views.left])
    seen = left[keep[: views.left]].tolist(), right[keep[views.left :]].tolist()
    second = second_start(fit.rig_T_flange, seen, leds, views.cameras)
    if second is None:
        return fit, None
    try:
        rival = _gauss_newton(views, keep, second, tolerance)
    except np.linalg.LinAlgError:
        return fit, None
    more = _unlikelihood(rival, expected) - _unlikelihood(fit, expected)
    if more < 0:
        fit, rival, more = rival, fit, -more
    share = 1 - 1 / (1 + math.exp(-more / 2))
    if share < MIN_SHARE:
        return fit, None
    apart = difference(rival.rig_T_flange, fit.rig_T_flange)
    return fit, share * np.outer(apart, apart)


def second_start(
    pose: Array, leds: tuple[Sequence[int], Sequence[int]], points: Array, cameras: Array
) -> Array | None:
    """Turn a pose to where LEDs in one image alone are explained a second time; None: nowhere.

    Two LEDs in both images leave a turn open, about the line through them. An LED in one image is
    at r from its circle's centre, and on a ray of direction u across the line, which meets the
    circle again at r - 2 (r . u) u: exactly, where the ray lies in the circle's plane.

    `pose` (4, 4), rig_T_flange; `leds`, those seen by the left camera and by the right one;
    `points` (n, 3), m, of all LEDs in the flange; `cameras` (2, 23), as
    `kernels.entries.predict_spots` has them. A start for a fit, not a value.
    """
    left, right = (set(some) for some in leds)
    both, alone = left & right, sorted(left ^ right)
    if len(both) != 2 or not alone:
        return None
    first, second, lone = (pose[:3, :3] @ points[i] + pose[:3, 3] for i in (*both, alone[0]))
    placed = cameras[int(alone[0] in right), :12].reshape(3, 4)
    eye = -placed[:, :3].T @ placed[:, 3]
    line = (second - first) / np.linalg.norm(second - first)
    arm, ray = (v - line * (line @ v) for v in (lone - first, lone - eye))
    if np.linalg.norm(arm) < MIN_ACROSS or np.linalg.norm(ray) < MIN_ACROSS:
        return None
    ray /= np.linalg.norm(ray)
    again = arm - 2 * (arm @ ray) * ray
    angle = math.atan2(line @ np.cross(arm, again), arm @ again)
    turn = Rotation.from_rotvec(line * angle).as_matrix()
    moved = pose.copy()
    moved[:3, :3] = turn @ pose[:3, :3]
    moved[:3, 3] = first + turn @ (pose[:3, 3] - first)
    return moved


def _unlikelihood(fit: _PoseFit, expected: tuple[Array, float] | None) -> float:
    """Twice the negative log likelihood of a fit, but for a constant."""
    chi2 = fit.figures[3]
    if expected is None:
        return chi2
    pose, sigma = expected
    turn = np.linalg.norm(difference(fit.rig_T_flange, pose)[3:])
    return chi2 + float(turn / sigma) ** 2


def perturb(pose: Array, step: Array) -> Array:
    """Move a pose by a translation and a small rotation vector, both in the outer frame's axes."""
    moved = np.array(pose, dtype=float, order="C")
    kernel.move_pose(moved, np.ascontiguousarray(step, dtype=float))
    return moved


def _determined_functionals(fit: _PoseFit) -> Array:
    """Functionals of the pose that the spots determine, (6, d): across what none of them shows."""
    directions, known = fit.directions
    if np.count_nonzero(known) == len(known):
        return IDENTITY  # one for all pairs: a long session has thousands
    hidden = directions[:, ~known] * SCALE[:, None]
    return np.linalg.svd(hidden, full_matrices=True)[0][:, hidden.shape[1] :]


@lru_cache(maxsize=16)
def _tolerance(
    left: Camera, right: Camera, counts: tuple[int, int], sigmas: tuple[float, float]
) -> Array:
    """Covariance spots may show beside noise before one counts as an outlier, (2 s, 2 s), px².

    `sigmas`, m, of an apparent LED centre and of an LED's place.
    """
    focal = np.repeat([left.matrix[0, 0], right.matrix[0, 0]], counts)
    # half a metre: nearer than LEDs are watched, so the bound is generous
    variance = MODEL_ERROR_PX**2 + np.square(focal / 0.5) * (sigmas[0] ** 2 + sigmas[1] ** 2)
    return np.diag(np.repeat(variance, 2))


def _pose(fit: _PoseFit, keep: Flags, consistent: bool, doubt: Array | None) -> Pose:
    residual, by_point, _ = fit.predicted
    pixels, alignment, uncertainty, chi2 = fit.figures
    determined = _determined_functionals(fit)
    return Pose(
        rig_T_flange=fit.rig_T_flange,
        covariance_pixels=pixels if doubt is None else pixels + doubt,
        covariance_alignment=alignment,
        twist=fit.twist,
        acceleration_prior=fit.prior,
        determined=determined,
        gain=fit.gain,
        sensitivity=by_point,
        curvature=fit.curvature,
        residual=residual,
        spot_uncertainty=uncertainty,
        rejected=~keep,
        consistent=consistent,
        chi2=chi2,
        degrees_of_freedom=len(fit.rows) - determined.shape[1],
    )
