"""Angles for turning camera bases that keep the LEDs in view."""

import math
import threading
from collections.abc import Callable, Sequence

import numpy as np

from verify.core.fiducials import Marker
from verify.core.records import Array, Measurement, StereoPair
from verify.core.rig import Camera, Rig

MAX_OFF_AXIS_RATIO = 0.35  # of half the field: so far may the LEDs wander before a base turns
ORDER_PERIOD = 1.0  # s from one order to the next: a base that turns gives no pairs


class PanFollower:
    """Says where to turn the bases. Orders are fetched by the thread that owns the line.

    Args:
        rig: the cameras.
        marker: the LEDs.
    """

    def __init__(self, rig: Rig, marker: Marker) -> None:
        self._rig = rig
        self._middle = np.append(marker.leds.mean(axis=0), 1.0)
        self._allowed = [
            MAX_OFF_AXIS_RATIO * math.atan(rig.image_size[0] / 2 / camera.matrix[0, 0])
            for camera in (rig.left, rig.right)
        ]
        self._lock = threading.Lock()
        self._order: tuple[float, float] | None = None
        self._ordered = float("-inf")

    def look(
        self,
        pair: StereoPair,
        measurement: Measurement,
        expected: Callable[[float], Sequence[Array]],
    ) -> None:
        """See where the LEDs are, and order a turn if they are too far aside.

        Args:
            pair: says how the bases stood.
            measurement: what was seen in it.
            expected: gives rig_T_flange from the readings at an instant, for pairs that show no
                pose; of several none is believed.
        """
        if measurement.pose is not None:
            rig_T_flange = measurement.pose.rig_T_flange
        elif len(found := expected(measurement.t)) == 1:
            rig_T_flange = found[0]
        else:
            return
        point = rig_T_flange @ self._middle
        stands = (pair.pan_left, pair.pan_right)
        cameras = (self._rig.left, self._rig.right)
        aside = [
            _off_axis_angle(camera, pan, point) for camera, pan in zip(cameras, stands, strict=True)
        ]
        far = any(abs(a) > most for a, most in zip(aside, self._allowed, strict=True))
        if not far or pair.t_left < self._ordered + ORDER_PERIOD:
            return
        self._ordered = pair.t_left
        with self._lock:
            self._order = (stands[0] + aside[0], stands[1] + aside[1])

    def order(self) -> tuple[float, float] | None:
        """Fetch the newest order, once: angles as read, rad, left and right."""
        with self._lock:
            order, self._order = self._order, None
        return order


def _off_axis_angle(camera: Camera, pan: float, point: Array) -> float:
    """Angle to a point (4,), rig axes, about the base's axis from where the camera looks, rad.

    Positive pan turns the optical axis to the image's right.
    """
    x, _, z, _ = camera.camera_T_rig(pan) @ point
    return math.atan2(x, z)
