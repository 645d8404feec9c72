"""Predicted pixels of LEDs on a moving flange, with derivatives by everything a registration finds.

Spot s of LED l, taken at the stamped time t by a camera with its pan reading:

    x_s = project(K, k; camera_T_rig rig_T_base base_T_flange(q(t - clock + skew_s)) led_l) + noise

with skew_s the skew for spots of the right camera, else 0. Parameters (8 + 3 LEDs):

    0 - 5     rig_T_base: position, rotation about its own origin on the left     m, rad
    6 …       LED positions in the flange frame                                   m
    -2        clock, added to the readings' time gives the cameras'               s
    -1        skew, by how much the right camera's stamps are early               s

Every spot is predicted at its own instant (time stamp, and row of a rolling shutter). The noise of
interpolated readings is a weighted sum of single readings' noise, which two instants may share.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import robots
from robots.transforms import rigid_columns
from verify.calibration.registration.body_poses import BodyPose
from verify.core.readings import Readings
from verify.core.records import Array, Flags, Index
from verify.core.rig import Camera, Rig, distort_with_jacobian
from verify.measurement.pose import perturb

BASE_COLUMNS = slice(0, 6)  # of the design: base, LEDs, clock, skew
RIGHT = 1


def reading_variance(readings: Readings, resolution: float | None) -> Array:
    """Variance of one reading of each joint, (j,), rad²: its roughness, or its last digit."""
    return np.maximum(readings.noise**2, (resolution or 0.0) ** 2 / 12)


def interpolation_weights(readings: Readings, t: Array) -> tuple[Index, Array]:
    """Express readings interpolated at t (n,), s, controller's clock, as weighted sums of readings.

    Returns indices (n, 4) and weights (n, 4) with readings.at(t) = sum of weight · q[index].
    """
    last = len(readings.t) - 1
    first = np.clip(np.searchsorted(readings.t, t, side="right") - 2, 0, max(last - 3, 0))
    around = first[:, None] + np.arange(4)
    # a reading weighs what it gives where it alone is 1; four neighbours are marked differently
    marks = replace(readings, q=np.eye(4)[np.arange(last + 1) % 4])
    return np.minimum(around, last), np.take_along_axis(marks.at(t), around % 4, axis=1)


def shared_noise(index: Index, weight: Array) -> Array:
    """Covariance (..., m, m) of readings at instants (..., m) by noise of unit variance.

    `index` and `weight` (..., m, k): the k samples that each is interpolated from.
    """
    same = index[..., :, None, :, None] == index[..., None, :, None, :]
    return np.asarray(np.einsum("...abkl,...ak,...bl->...ab", same, weight, weight))


@dataclass(frozen=True, slots=True)
class RegistrationParameters:
    """The parameters of a registration."""

    rig_T_base: Array  # (4, 4)
    leds: Array  # (n, 3), m, flange frame
    clock: float  # s, added to the readings' time gives the cameras'
    skew: float  # s, by how much the right camera's stamps are early

    @property
    def size(self) -> int:
        """Count the parameters: 6 of the base, 3 an LED, clock, skew."""
        return 8 + self.leds.size

    def moved(self, step: Array) -> "RegistrationParameters":
        """Add a step (size,): the base's turns on the left, about its own origin."""
        return RegistrationParameters(
            rig_T_base=perturb(self.rig_T_base, step[BASE_COLUMNS]),
            leds=self.leds + step[6:-2].reshape(-1, 3),
            clock=self.clock + float(step[-2]),
            skew=self.skew + float(step[-1]),
        )


@dataclass(frozen=True, slots=True)
class SpotStack:
    """The spots of a session, pair by pair (s spots, n pairs)."""

    pair: Index  # (s,), 0 … n - 1, rising
    frame: Index  # (n,)
    side: Index  # (s,), 0 left, 1 right
    led: Index  # (s,)
    centre: Array  # (s, 2), px
    covariance: Array  # (s, 2, 2), px²
    t: Array  # (s,), s, as stamped
    pan: Array  # (s,), rad
    camera_T_rig: Array  # (s, 4, 4)
    used: Flags  # (s,)

    def __len__(self) -> int:
        """Count the pairs."""
        return len(self.frame)


def stack_spots(poses: Sequence[BodyPose], rig: Rig) -> SpotStack:
    """Stack the spots of all pairs."""
    raws = [one.raw for one in poses]
    sizes = [size for raw in raws for size in (raw.left, len(raw) - raw.left)]
    pans = [pan for raw in raws for pan in raw.pans]  # of each pair left, then right
    cameras = (rig.left, rig.right) * len(poses)
    placed = [camera.camera_T_rig(pan) for camera, pan in zip(cameras, pans, strict=True)]
    view = np.repeat(np.arange(len(sizes)), sizes)
    return SpotStack(
        pair=view // 2,
        frame=np.array([one.spots.frame for one in poses], dtype=np.int64),
        side=view % 2,
        led=np.concatenate([raw.led for raw in raws]),
        centre=np.concatenate([raw.centre for raw in raws]),
        covariance=np.concatenate([raw.covariance for raw in raws]),
        t=np.concatenate([raw.taken for raw in raws]),
        pan=np.array(pans)[view],
        camera_T_rig=np.array(placed)[view],
        used=np.concatenate([~one.pose.rejected for one in poses]),
    )


@dataclass(frozen=True, slots=True)
class PredictedSpots:
    """The spots' predictions at one set of parameters, and their derivatives, px a unit."""

    residual: Array  # (s, 2), px, observed less predicted
    points_rig: Array  # (s, 3), m
    points_camera: Array  # (s, 3), m
    by_point: Array  # (s, 2, 3), a point's motion in the rig
    by_flange: Array  # (s, 2, 6), a twist of the flange, rig axes, at its origin
    by_joint: Array  # (s, 2, j), the readings
    design: Array  # (s, 2, size), the parameters
    rate: Array  # (s, j), rad/s
    readings: tuple[Index, Array]  # (s, 4) each: what an instant's joints come from


def predict_spots(
    spotted: SpotStack, rig: Rig, arm: robots.Arm, readings: Readings, at: RegistrationParameters
) -> PredictedSpots:
    """Predict every spot and differentiate it by all parameters."""
    t = spotted.t + at.skew * (spotted.side == RIGHT) - at.clock  # on the readings' clock
    q, rate = readings.motion(t)
    base_T_flange = robots.forward(arm, q)
    rig_R_base = at.rig_T_base[:3, :3]
    rig_T_flange = at.rig_T_base @ base_T_flange
    rotation = rig_T_flange[:, :3, :3]
    offset = np.einsum("sij,sj->si", rotation, at.leds[spotted.led])  # LED from flange
    points = offset + rig_T_flange[:, :3, 3]
    inside = np.einsum("sij,sj->si", spotted.camera_T_rig[:, :3, :3], points)
    inside = inside + spotted.camera_T_rig[:, :3, 3]
    pixels = np.empty((len(points), 2))
    by_point = np.empty((len(points), 2, 3))
    for side, camera in enumerate((rig.left, rig.right)):
        mine = spotted.side == side
        pixels[mine], by_camera = project_points(camera, inside[mine])
        by_point[mine] = by_camera @ spotted.camera_T_rig[mine, :3, :3]
    by_flange = by_point @ rigid_columns(offset)
    twist = np.concatenate(
        [rig_R_base @ part for part in np.split(robots.jacobian(arm, q), 2, axis=1)], axis=1
    )
    by_joint = by_flange @ twist
    design = np.zeros((len(points), 2, at.size))
    design[:, :, :6] = by_point @ rigid_columns(points - at.rig_T_base[:3, 3])
    place = 6 + 3 * spotted.led[:, None] + np.arange(3)
    np.put_along_axis(design, np.repeat(place[:, None], 2, axis=1), by_point @ rotation, axis=2)
    moving = np.einsum("sij,sj->si", by_joint, rate)
    design[:, :, -2] = -moving
    design[:, :, -1] = moving * (spotted.side == RIGHT)[:, None]
    return PredictedSpots(
        residual=spotted.centre - pixels,
        points_rig=points,
        points_camera=inside,
        by_point=by_point,
        by_flange=by_flange,
        by_joint=by_joint,
        design=design,
        rate=rate,
        readings=interpolation_weights(readings, t),
    )


def project_points(camera: Camera, points: Array) -> tuple[Array, Array]:
    """Pixels of points in the camera frame (n, 3), and their derivative (n, 2, 3), px/m."""
    xy = points[:, :2] / points[:, 2:3]
    perspective = np.zeros((len(points), 2, 3))
    perspective[:, 0, 0] = perspective[:, 1, 1] = 1 / points[:, 2]
    perspective[:, :, 2] = -xy / points[:, 2:3]
    distorted, by_xy = distort_with_jacobian(xy, camera.distortion)
    return camera.to_pixels(distorted), camera.matrix[:2, :2] @ by_xy @ perspective
