"""Angles for turning camera bases that keep the LEDs in view."""

import math
from collections import deque

import numpy as np

from verify.core.fiducials import Marker
from verify.core.records import Array, Measurement, StereoPair
from verify.core.rig import Camera, Rig
from verify.live.protocols import ExpectedPoses

MAX_OFF_AXIS_RATIO = 0.35  # of half the field: LEDs farther from the axis make a base turn
ORDER_PERIOD = 1.0  # s from one order to the next: a base that turns gives no pairs


class PanFollower:
    """Computes orders to the bases, which the thread that owns their line fetches."""

    def __init__(self, rig: Rig, marker: Marker) -> None:
        self._rig = rig
        self._middle = np.append(marker.leds.mean(axis=0), 1.0)
        self._allowed = [
            MAX_OFF_AXIS_RATIO * math.atan(rig.image_size[0] / 2 / camera.matrix[0, 0])
            for camera in (rig.left, rig.right)
        ]
        self._orders: deque[tuple[float, float]] = deque(maxlen=1)
        self._ordered = float("-inf")

    def look(self, pair: StereoPair, measurement: Measurement, expected: ExpectedPoses) -> None:
        """Order a turn if the LEDs are too far from an optical axis.

        The pair has the bases' angles; `expected` is used for pairs that show no pose; of several
        poses none is used.
        """
        if measurement.pose is not None:
            rig_T_flange = measurement.pose.rig_T_flange
        elif len(poses := expected(measurement.t)) == 1:
            rig_T_flange = poses[0]
        else:
            return
        point = rig_T_flange @ self._middle
        left = _off_axis_angle(self._rig.left, pair.pan_left, point)
        right = _off_axis_angle(self._rig.right, pair.pan_right, point)
        far = abs(left) > self._allowed[0] or abs(right) > self._allowed[1]
        if far and pair.t_left >= self._ordered + ORDER_PERIOD:
            self._ordered = pair.t_left
            self._orders.append((pair.pan_left + left, pair.pan_right + right))

    def order(self) -> tuple[float, float] | None:
        """Fetch the newest order, once: angles as read, rad, left and right."""
        return self._orders.pop() if self._orders else None


def _off_axis_angle(camera: Camera, pan: float, point: Array) -> float:
    """Angle to a point (4,), rig axes, about the base's axis from where the camera looks, rad.

    Positive pan turns the optical axis to the image's right.
    """
    x, _, z, _ = camera.camera_T_rig(pan) @ point
    return math.atan2(x, z)
