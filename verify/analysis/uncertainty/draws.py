"""Draws of a Monte-Carlo check: inputs drawn by their uncertainties, and the poses that follow.

Cameras, bases and LEDs are moved by whole amounts, and the pose of the drawn spots is found in
every draw, by steps of the measured pose's own gain until it has settled, without linear
propagation. Shapes: d draws, s spots.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robots.transforms import displace, invert, rotation_exp
from verify.analysis.model import SessionComparison
from verify.core.fiducials import Marker
from verify.core.records import POSE_NAMES, Array, Measurement, Pose, Sighting
from verify.core.rig import Camera, Rig, distort
from verify.measurement.pose import motion_columns
from verify.measurement.sensitivities import AXES, LENS
from verify.measurement.systematics import covariance_root
from verify.measurement.track import Track

MAX_ITERATIONS = 8  # each leaves a hundredth or less: two or three suffice
TOL_STEP = 1e-6  # m and rad: that step is taken, and what would follow is nanometres

Values = Mapping[str, Array]  # a parameter's name, as rig.toml has it, to (d,) departures, SI


@dataclass(frozen=True, slots=True)
class CameraDraws:
    """One camera in every draw."""

    focal: Array  # (d, 2, 2), px
    middle: Array  # (d, 2), px
    lens: Array  # (d, 5)
    camera_R_rig: Array  # (d, 3, 3)
    origin: Array  # (d, 3), m, of the rig in the camera


@dataclass(frozen=True, slots=True)
class ViewDraws:
    """Both cameras in every draw, and which of a pair's spots each of them sees."""

    left: CameraDraws
    right: CameraDraws
    number: int  # of spots, the first ones, that are the left camera's


@dataclass(frozen=True, slots=True)
class SpotDraws:
    """The spots of one pair that its pose rests on, s of them, left ones first."""

    left: int  # how many are the left camera's
    led: Array  # (s,) index
    seen: Array  # (s, 2), px, steady motion allowed for
    noise: Array  # (2 s, 2 s), px², a root of the spots' covariance
    by_motion: Array  # (2 s, 18), px: motion that is not known, columns of unit variance
    gain: Array  # (6, 2 s), d pose / d spot in rig axes


def used_spots(measurement: Measurement, rig: Rig, marker: Marker) -> SpotDraws:
    """Collect the spots that a measured pair's pose rests on.

    Raises:
        ValueError: the pair has no pose, or none that pictures gave.
    """
    pose, left, right = measurement.pose, measurement.left, measurement.right
    if pose is None or left is None or right is None:
        raise ValueError("only a pair of pictures with a pose has spots")
    used = ~pose.rejected
    led = np.concatenate([left.led, right.led])[used]
    covariance = np.concatenate([left.covariance, right.covariance])[used]
    lever = np.concatenate([left.lever, right.lever])[used]
    count = len(led)
    root = np.zeros((count, 2, count, 2))
    np.einsum("iaib->iab", root)[:] = np.linalg.cholesky(covariance)
    noise = root.reshape(2 * count, -1)
    by_point, arm = pose.sensitivity[used], marker.leds[led] @ pose.rig_T_flange[:3, :3].T
    by_pose = np.concatenate([by_point, np.cross(arm[:, None, :], by_point)], axis=-1)
    moved = motion_columns(by_pose, lever, pose.acceleration_prior).reshape(2 * count, -1)
    number = int(used[: len(left)].sum())
    rows = np.repeat(used, 2)
    return SpotDraws(
        left=number,
        led=led,
        seen=_predict_spots(pose, left, right, number, led, rig, marker) + pose.residual[used],
        noise=noise,
        by_motion=moved,
        gain=pose.gain[:, rows],
    )


def _predict_spots(
    pose: Pose, left: Sighting, right: Sighting, number: int, led: Array, rig: Rig, marker: Marker
) -> Array:
    """Where the pose puts the used spots, (s, 2), px."""
    place = marker.leds[led] @ pose.rig_T_flange[:3, :3].T + pose.rig_T_flange[:3, 3]
    pixels = []
    for camera, sighting, points in (
        (rig.left, left, place[:number]),
        (rig.right, right, place[number:]),
    ):
        camera_T_rig = camera.camera_T_rig(sighting.pan)
        pixels.append(camera.project(points @ camera_T_rig[:3, :3].T + camera_T_rig[:3, 3]))
    return np.concatenate(pixels)


def camera_draws(camera: Camera, side: str, values: Values, pan: Array) -> CameraDraws:
    """One camera moved by what was drawn; parameters that are missing stay.

    `side` left or right heads its parameters' names; `pan` (d,), rad: the reading with its drawn
    error.
    """
    zero = np.zeros(len(pan))

    def of(key: str) -> Array:
        return values.get(f"{side}.{key}", zero)

    def three(stem: str, suffix: str) -> Array:
        return np.stack([of(f"{stem}{name}_{suffix}") for name in AXES], axis=1)

    axis: Array = rotation_exp(three("pan_axis_r", "deg")) @ camera.pan_axis
    angle = pan + camera.pan_zero + of("pan_zero_deg")
    turn = rotation_exp(axis * angle[:, None])
    mount = rotation_exp(three("mount_r", "deg")) @ camera.mount[:3, :3]
    shift = camera.mount[:3, 3] + three("mount_", "mm")
    rig_R_camera = turn @ mount
    centre = camera.pan_center + three("pan_center_", "mm") + (turn @ shift[..., None])[..., 0]
    camera_R_rig = np.swapaxes(rig_R_camera, 1, 2)
    focal = np.tile(camera.matrix[:2, :2], (len(pan), 1, 1))
    focal[:, 0, 0] += of("fx_px")
    focal[:, 1, 1] += of("fy_px")
    return CameraDraws(
        focal=focal,
        middle=camera.matrix[:2, 2] + np.stack([of("cx_px"), of("cy_px")], axis=1),
        lens=camera.distortion + np.stack([of(key) for key in LENS], axis=1),
        camera_R_rig=camera_R_rig,
        origin=-(camera_R_rig @ centre[..., None])[..., 0],
    )


def led_draws(marker: Marker, values: Values, draws: int) -> Array:
    """Where the LEDs sit on the flange in every draw, (d, leds, 3), m."""
    zero = np.zeros(draws)

    def three(stem: str, suffix: str) -> Array:
        return np.stack([values.get(f"{stem}{axis}_{suffix}", zero) for axis in AXES], axis=1)

    turn, shift = rotation_exp(three("body.r", "deg")), three("body.", "mm")
    places = marker.leds @ np.swapaxes(turn, 1, 2) + shift[:, None]
    for i, name in enumerate(marker.names):
        places[:, i] += three(f"led.{name}.", "mm") + three(f"centre.{name}.", "mm")
    return places


def refit_pose(start: Array, points: Array, seen: Array, views: ViewDraws, gain: Array) -> Array:
    """The pose that spots ask for, in every draw: rig_T_flange (d, 4, 4), from `start` (4, 4).

    `points` (d, s, 3), m: LEDs on the flange; `seen` (d, s, 2), px; `gain` (6, 2 s), d pose / d
    spot at the measured pose. A gain renewed at each step moves no draw of the samples by more than
    0.015 of their scatter.
    """
    poses, left = np.tile(start, (len(points), 1, 1)), views.number
    for _ in range(MAX_ITERATIONS):
        shown = [
            _project(poses, points[:, :left], views.left),
            _project(poses, points[:, left:], views.right),
        ]
        step = (seen - np.concatenate(shown, axis=1)).reshape(len(poses), -1) @ gain.T
        poses = displace(poses, step)
        if np.abs(step).max() < TOL_STEP:
            break
    return poses


def _project(poses: Array, points: Array, camera: CameraDraws) -> Array:
    """Where one camera shows LEDs of the flange, (d, s, 2), px."""
    rig_points = points @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3]
    ahead = rig_points @ camera.camera_R_rig.swapaxes(1, 2) + camera.origin[:, None]
    distorted = distort(ahead[..., :2] / ahead[..., 2:], camera.lens.T[..., None])
    return distorted @ camera.focal.swapaxes(1, 2) + camera.middle[:, None]


class WorldDraws:
    """What is drawn once and holds for all pairs, and the chance for the rest; d draws."""

    def __init__(self, rng: np.random.Generator, draws: int, compared: SessionComparison) -> None:
        systematics, clock = compared.systematics, compared.clock
        self.rng, self.draws, self.session = rng, draws, compared.session
        spread = covariance_root(systematics.covariance)
        self.stated = rng.standard_normal((draws, spread.shape[1])) @ spread.T
        self.values = dict(zip(systematics.names, self.stated.T, strict=True))
        self.late = rng.standard_normal(draws) * (clock.standard_uncertainty or 0.0)
        self.misaligned = rng.standard_normal(draws)
        self.tilted = rng.standard_normal((draws, compared.comparison.tilt.shape[2]))
        self.pan_sigma = np.nan_to_num(systematics.pan)
        self._pan: dict[tuple[int, float], Array] = {}
        self._cameras: dict[tuple[int, float], CameraDraws] = {}

    def pan(self, side: int, reading: float) -> Array:
        """Error of a pan reading, (d,), rad; one for all pairs that share the reading."""
        key = side, reading
        if key not in self._pan:
            self._pan[key] = self.rng.standard_normal(self.draws) * self.pan_sigma[side]
        return self._pan[key]

    def camera(self, side: int, reading: float) -> CameraDraws:
        """One camera in every draw, for all pairs that share the pan reading."""
        key, rig = (side, reading), self.session.rig
        if key not in self._cameras:
            name, camera = (("left", rig.left), ("right", rig.right))[side]
            pan = reading + self.pan(side, reading)
            self._cameras[key] = camera_draws(camera, name, self.values, pan)
        return self._cameras[key]

    def readings(self, rate: Array, noise: Array) -> Array:
        """Errors of the readings, (d, j), rad: noise, last digit, time stamps, the clock."""
        session, shape = self.session, (self.draws, len(rate))
        error = self.rng.standard_normal(shape) * noise - np.outer(self.late, rate)
        if session.encoder_resolution is not None:
            error += session.encoder_resolution * self.rng.uniform(-0.5, 0.5, shape)
        stamps = session.encoder_time_standard_uncertainty
        if stamps is not None:
            error += np.outer(stamps * self.rng.standard_normal(self.draws), rate)
        return error

    def poses(self, seen: Measurement, track: Track, row: int, scale: float) -> tuple[Array, Array]:
        """The flange in the base, (d, 4, 4), and what linear propagation makes of it, (d, 6)."""
        if seen.pose is None:
            raise ValueError("only a measured pair has a pose")
        if seen.left is None or seen.right is None:
            rig_T_flange, twist = self._instrument(seen.pose.rig_T_flange, track, row)
        else:
            rig_T_flange, twist = self._pictures(seen, track, row, scale)
        count = len(self.values)
        twist = twist + self.stated @ track.systematic[row][:, :count].T
        return self._base_T_rig @ rig_T_flange, twist

    def _pictures(
        self, seen: Measurement, track: Track, row: int, scale: float
    ) -> tuple[Array, Array]:
        rig, pose = self.session.rig, seen.pose
        assert pose is not None
        spots = used_spots(seen, rig, self.session.marker)
        moved = self.rng.standard_normal((self.draws, len(spots.noise))) @ spots.noise.T
        motion = self.rng.standard_normal((self.draws, spots.by_motion.shape[1]))
        moved += scale * motion @ spots.by_motion.T
        pan = [self.pan(side, float(reading)) for side, reading in enumerate(track.pan[row])]
        left, right = (
            self.camera(side, float(reading)) for side, reading in enumerate(track.pan[row])
        )
        poses = refit_pose(
            pose.rig_T_flange,
            self._leds[:, spots.led],
            spots.seen + moved.reshape(self.draws, -1, 2),
            ViewDraws(left, right, spots.left),
            spots.gain,
        )
        by_spots = moved @ spots.gain.T
        base_R_rig = rig.rig_T_base[:3, :3].T
        twist = np.concatenate([by_spots[:, :3] @ base_R_rig.T, by_spots[:, 3:] @ base_R_rig.T], 1)
        return poses, twist + np.stack(pan, axis=1) @ track.systematic[row][:, -2:].T

    def _instrument(self, rig_T_flange: Array, track: Track, row: int) -> tuple[Array, Array]:
        """Another instrument's pose: its noise, and where the body sits on the flange."""
        lower = np.linalg.cholesky(track.covariance_pixels[row])
        twist = self.rng.standard_normal((self.draws, 6)) @ lower.T  # base axes
        rig_R_base = self.session.rig.rig_T_base[:3, :3]
        body = displace(np.tile(np.eye(4), (self.draws, 1, 1)), self._departure("body"))
        moved = np.concatenate([twist[:, :3] @ rig_R_base.T, twist[:, 3:] @ rig_R_base.T], axis=1)
        return displace(rig_T_flange @ invert(body), moved), twist

    @cached_property
    def _leds(self) -> Array:
        """Where the LEDs sit on the flange in every draw, (d, leds, 3), m."""
        return led_draws(self.session.marker, self.values, self.draws)

    @cached_property
    def _base_T_rig(self) -> Array:
        """The rig in the robot's base in every draw, (d, 4, 4)."""
        base = np.tile(self.session.rig.rig_T_base, (self.draws, 1, 1))
        return invert(displace(base, self._departure("robot_base")))

    def _departure(self, group: str) -> Array:
        zero = np.zeros(self.draws)
        return np.stack([self.values.get(f"{group}.{n}", zero) for n in POSE_NAMES], axis=1)

    def aligned(self, poses: Array, error: Array, tilt: Array) -> tuple[Array, Array]:
        """Move poses against what alignment and a tilted camera may have left; and that, (d, 6).

        Of xi: `error` (6,) of alignment, `tilt` (6, k).
        """
        left = np.outer(self.misaligned, error) + self.tilted @ tilt.T
        return displace(poses, -left), left
