"""The second pose of a marker of which two LEDs are in both images and others in one.

Two LEDs in both images leave a turn open, about the line through them. An LED in one image is on a
circle about that line, and on a ray from the camera that meets the circle's cylinder twice:

    r' = r - 2 (r . u) u

    symbol  meaning                                                            unit
    r       from the circle's centre to the LED                                m
    r'      to where the ray meets the cylinder again                          m
    u       direction of the ray across the line                               1

Where the ray lies in the circle's plane, nearly, both poses explain the spots alike.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from verify.core.records import Array

MIN_ACROSS = 1e-6  # m and 1: an LED on the line, or a ray along it, shows no turn


def second_start(
    pose: Array, leds: tuple[Sequence[int], Sequence[int]], points: Array, cameras: Array
) -> Array | None:
    """Turn a pose to where LEDs in one image alone are explained a second time; None: nowhere.

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
