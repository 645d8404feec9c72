"""The flange of an arm that stands about where it was told to: measured in one pair of pictures.

The chain of `verify run`, but for two things: nothing moves between the pictures, and where the
arm was told to stand says where to look, and which of several LEDs a spot can be. That is a choice:
its value enters no result.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from verify.detection import detect
from verify.grab.hand_off import LARGEST
from verify.identification import Prediction, identify
from verify.marker import Marker
from verify.pose import fit_pose
from verify.records import Array, Image, Measurement, Sighting, Spots, StereoPair
from verify.rig import Camera, Rig
from verify.systematics import spot_columns, stated

SEARCHED = 1.5 * LARGEST  # m: LEDs that are farther from where they are told are not looked for
TURNED = 0.1  # rad: no offset that moves the hand by so little turns it so far
SURROUNDINGS_PX = 14.0  # about an LED: the background that is fitted with it


def measured_still(pair: StereoPair, rig: Rig, marker: Marker, told: Array) -> Measurement:
    """Measure where the flange stands.

    Args:
        pair: taken while it stood.
        rig: the cameras.
        marker: the LEDs.
        told: rig_T_flange, (4, 4), within SEARCHED and TURNED.

    Returns:
        Its status is "measured", "too_few_leds", "ambiguous_leds" or "outlier".
    """
    pans = pair.pan_left, pair.pan_right
    spots = (
        detect(pair.left, _window(told, marker, rig.left, pans[0], pair.left)),
        detect(pair.right, _window(told, marker, rig.right, pans[1], pair.right)),
    )
    near = Prediction(told, SEARCHED, TURNED)
    found = identify(spots[0], spots[1], rig, pans[0], pans[1], marker, prediction=near)
    seen = len({*found.left_led.tolist(), *found.right_led.tolist()})
    if found.status != "measured" or found.rig_T_flange is None:
        return Measurement(pair.frame, pair.t_left, found.status, seen)
    left = _sighting(spots[0], found.left_led, found.left_spot, pair.t_left, pair.pan_left)
    right = _sighting(spots[1], found.right_led, found.right_spot, pair.t_left, pair.pan_right)
    doubt = partial(_doubt, rig, marker, left, right)
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


def _doubt(
    rig: Rig, marker: Marker, left: Sighting, right: Sighting, rig_T_flange: Array, by_point: Array
) -> Array:
    """What rig and marker state of themselves, as the spots would show it."""
    parameters = stated(rig, marker, turning=True)
    return spot_columns(parameters, left, right, rig_T_flange, by_point, rig, marker)


def _window(told: Array, marker: Marker, camera: Camera, pan: float, image: Image) -> Array:
    """One box around all LEDs, (1, 4) px: x0, y0, x1, y1; pan is rad, as read."""
    camera_T_flange = camera.camera_T_rig(pan) @ told
    points = marker.leds @ camera_T_flange[:3, :3].T + camera_T_flange[:3, 3]
    points = points[points[:, 2] > 0]  # behind the camera there is nothing to look for
    if not len(points):
        return np.zeros((0, 4))
    wide = SEARCHED + marker.led_diameter
    border = SURROUNDINGS_PX + camera.matrix[0, 0] * wide / points[:, 2].min()
    pixels = camera.project(points)
    box = np.concatenate([pixels.min(axis=0) - border, pixels.max(axis=0) + border])
    height, width = image.shape[:2]
    kept: Array = np.clip(box, 0, [width, height, width, height])
    return kept[None] if np.all(kept[2:] > kept[:2]) else np.zeros((0, 4))
