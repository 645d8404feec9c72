"""Many drawn worlds of one pair at once: its pose fitted anew in each, without any derivative kept.

What a file states is drawn and taken at its word: cameras, bases, LEDs are moved by whole amounts,
and the pose that the drawn spots ask for is found by Gauss-Newton in every draw. Shapes: d draws,
s spots.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robots.transforms import rotation_exp
from verify.judgement.monte_carlo_kernel import Drawn, fit_all
from verify.marker import Marker
from verify.records import Array, Measurement, Pose, Sighting
from verify.rig import Camera, Rig
from verify.spot_derivatives import AXES, LENS

ITERATIONS = 8  # quadratic from a start that is off by a standard uncertainty: three suffice
CONVERGED = 1e-6  # m and rad: that step is taken, and what would follow is nanometres

Values = Mapping[str, Array]  # a parameter's name, as rig.toml has it, to (d,) departures, SI


@dataclass(frozen=True, slots=True)
class Cameras:
    """One camera in every draw."""

    focal: Array  # (d, 2, 2), px
    middle: Array  # (d, 2), px
    lens: Array  # (d, 5)
    camera_R_rig: Array  # (d, 3, 3)
    origin: Array  # (d, 3), m, of the rig in the camera


@dataclass(frozen=True, slots=True)
class Views:
    """Both cameras in every draw, and which of a pair's spots each of them sees."""

    left: Cameras
    right: Cameras
    number: int  # of spots, the first ones, that are the left camera's


@dataclass(frozen=True, slots=True)
class Spots:
    """The spots of one pair that its pose rests on, s of them, left ones first."""

    left: int  # how many are the left camera's
    led: Array  # (s,) index
    seen: Array  # (s, 2), px, steady motion allowed for
    noise: Array  # (2 s, 2 s), px², a root of the spots' covariance
    by_acceleration: Array  # (2 s, 6), px by m/s² and rad/s²
    weight: Array  # (2 s, 2 s), 1/px²
    gain: Array  # (6, 2 s), d pose / d spot in rig axes


def spots_of(measurement: Measurement, rig: Rig, marker: Marker) -> Spots:
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
    lever = np.concatenate([left.acceleration_lever, right.acceleration_lever])[used]
    count = len(led)
    root = np.zeros((count, 2, count, 2))
    np.einsum("iaib->iab", root)[:] = np.linalg.cholesky(covariance)
    noise = root.reshape(2 * count, -1)
    by_pose = _by_pose(pose.sensitivity[used], marker.leds[led] @ pose.rig_T_flange[:3, :3].T)
    moved = (by_pose * lever[:, None, None]).reshape(-1, 6)
    spread = np.repeat(np.square(pose.acceleration_prior), 3)
    number = int(used[: len(left)].sum())
    rows = np.repeat(used, 2)
    return Spots(
        left=number,
        led=led,
        seen=_predicted(pose, left, right, number, led, rig, marker) + pose.residual[used],
        noise=noise,
        by_acceleration=moved,
        weight=np.asarray(np.linalg.inv(noise @ noise.T + (moved * spread) @ moved.T)),
        gain=pose.gain[:, rows],
    )


def _predicted(
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


def camera_draws(camera: Camera, side: str, values: Values, pan: Array) -> Cameras:
    """One camera moved by what was drawn.

    Args:
        camera: as calibrated.
        side: left or right, the head of its parameters' names.
        values: drawn departures; parameters that are missing stay.
        pan: (d,), rad, the reading with its drawn error.
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
    camera_R_rig = np.ascontiguousarray(np.swapaxes(rig_R_camera, 1, 2))
    focal = np.tile(camera.matrix[:2, :2], (len(pan), 1, 1))
    focal[:, 0, 0] += of("fx_px")
    focal[:, 1, 1] += of("fy_px")
    return Cameras(
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


def refit(start: Array, points: Array, seen: Array, views: Views, weight: Array) -> Array:
    """The pose that spots ask for, in every draw.

    Args:
        start: (4, 4), rig_T_flange.
        points: (d, s, 3), m, LEDs on the flange.
        seen: (d, s, 2), px.
        views: the cameras.
        weight: (2 s, 2 s), 1/px².

    Returns:
        rig_T_flange, (d, 4, 4).
    """
    poses = np.tile(start, (len(points), 1, 1))
    fit_all(
        poses,
        (np.ascontiguousarray(points), np.ascontiguousarray(seen)),
        (_plain(views.left), _plain(views.right)),
        views.number,
        np.ascontiguousarray(weight),
        (ITERATIONS, CONVERGED),
    )
    return poses


def _plain(camera: Cameras) -> Drawn:
    """A camera as the compiled fit takes it."""
    return camera.focal, camera.middle, camera.lens, camera.camera_R_rig, camera.origin


def _by_pose(by_point: Array, arm: Array) -> Array:
    """Derivative by a translation and a rotation vector in rig axes, (..., s, 2, 6)."""
    return np.concatenate([by_point, np.cross(arm[..., None, :], by_point)], axis=-1)
