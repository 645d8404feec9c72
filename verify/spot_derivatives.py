"""How spots move when a stated parameter does: derivatives of predicted pixels, all at once."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.marker import Marker
from verify.records import Array, Sighting
from verify.rig import Camera, Rig, distort

AXES = ("x", "y", "z")
LENS = ("k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True, slots=True)
class Views:
    """Everything about the spots that a derivative needs."""

    side: tuple[tuple[str, Camera, Sighting, slice, Array], ...]  # …, (m, 3) points in the camera
    points_rig: Array  # (s, 3)
    led: Array  # (s,) index
    names: tuple[str, ...]
    offset: Array  # (s, 3), LED from flange, rig axes
    rig_R_flange: Array  # (3, 3)
    by_point: Array  # (s, 2, 3), d px / d point in the rig
    by_led: Array  # (s, 2, 3), d px / d LED in the flange


def look_at(
    rig_T_flange: Array, left: Sighting, right: Sighting, by_point: Array, rig: Rig, marker: Marker
) -> Views:
    """Prepare the spots of a pose.

    Args:
        rig_T_flange: (4, 4), the pose.
        left: LEDs in the left image.
        right: LEDs in the right image.
        by_point: (s, 2, 3), d px / d point in the rig, left spots first.
        rig: the cameras.
        marker: the LEDs.
    """
    led = np.concatenate([left.led, right.led])
    rig_R_flange = rig_T_flange[:3, :3]
    offset = marker.leds[led] @ rig_R_flange.T
    points = offset + rig_T_flange[:3, 3]
    sides = []
    for name, camera, sighting, spots in (
        ("left", rig.left, left, slice(0, len(left))),
        ("right", rig.right, right, slice(len(left), None)),
    ):
        camera_T_rig = camera.camera_T_rig(sighting.pan)
        inside = points[spots] @ camera_T_rig[:3, :3].T + camera_T_rig[:3, 3]
        sides.append((name, camera, sighting, spots, inside))
    return Views(
        tuple(sides),
        points,
        led,
        marker.names,
        offset,
        rig_R_flange,
        by_point,
        by_point @ rig_R_flange,
    )


def moved_spots(views: Views, names: tuple[str, ...]) -> Array:
    """Derivative of the predicted spots by parameters, (p, s, 2), px a SI unit.

    Args:
        views: the spots.
        names: of the parameters; the robot's base moves no spot.
    """
    plan = _planned(names, views.names)
    moved = np.zeros((len(names), len(views.led), 2))
    by_axis = views.by_led.transpose(2, 0, 1)  # (3, s, 2)
    column, led, axis = plan.leds
    moved[column] = by_axis[axis] * (views.led == led[:, None])[:, :, None]
    column, axis = plan.shifts
    moved[column] = by_axis[axis]
    for column, axis in plan.turns.T:
        sweep = swept(views.rig_R_flange[:, axis], views.offset)
        moved[column] = (views.by_point @ sweep[:, :, None])[:, :, 0]
    for side, camera, sighting, spots, inside in views.side:
        points, by_point = views.points_rig[spots], views.by_point[spots]
        for column, key in plan.camera[side]:
            moved[column, spots] = camera_pixels(key, camera, sighting, inside, points, by_point)
    return moved


@dataclass(frozen=True, slots=True)
class _Plan:
    """Parameters by kind: the column of each, and what it moves along or about."""

    leds: NDArray[np.intp]  # (3, .): column, LED, axis
    shifts: NDArray[np.intp]  # (2, .): column, axis, of the LED body along the flange's axes
    turns: NDArray[np.intp]  # (2, .), of the LED body about them
    camera: dict[str, list[tuple[int, str]]]


@lru_cache(maxsize=16)
def _planned(names: tuple[str, ...], leds: tuple[str, ...]) -> _Plan:
    one: list[tuple[int, int, int]] = []
    shifts: list[tuple[int, int]] = []
    turns: list[tuple[int, int]] = []
    camera: dict[str, list[tuple[int, str]]] = {"left": [], "right": []}
    for column, name in enumerate(names):
        head, _, key = name.partition(".")
        if head in camera:
            camera[head].append((column, key))
        elif head == "body":
            axis = AXES.index(key.split("_")[0][-1])
            (turns if key.startswith("r") else shifts).append((column, axis))
        elif head in ("led", "centre"):
            led, _, axis_name = key.rpartition(".")
            one.append((column, leds.index(led), AXES.index(axis_name[0])))
    moved, body_shifts, body_turns = (
        np.array(rows, dtype=np.intp).reshape(-1, width).T
        for rows, width in ((one, 3), (shifts, 2), (turns, 2))
    )
    return _Plan(moved, body_shifts, body_turns, camera)


def camera_pixels(
    key: str, camera: Camera, sighting: Sighting, inside: Array, points: Array, by_point: Array
) -> Array:
    """Derivative of one camera's pixels by one of its parameters, (m, 2)."""
    xy = inside[:, :2] / inside[:, 2:3]
    if key in ("cx_px", "cy_px"):
        return np.tile([float(key == "cx_px"), float(key == "cy_px")], (len(xy), 1))
    if key in ("fx_px", "fy_px"):
        return distort(xy, camera.distortion) * [float(key == "fx_px"), float(key == "fy_px")]
    if key in LENS:  # the model is linear in its coefficients
        unit = np.array([float(key == k) for k in LENS])
        lens: Array = (distort(xy, unit) - xy) @ camera.matrix[:2, :2].T
        return lens
    shift, turn, origin = _camera_motion(key, camera, sighting.pan)
    moved = -(shift + swept(turn, points - origin))  # the world moves against the camera
    pixels: Array = (by_point @ moved[:, :, None])[:, :, 0]
    return pixels


def swept(turn: Array, points: Array) -> Array:
    """Cross product turn x points, (..., 3); numpy's own takes five times as long."""
    x, y, z = turn.tolist()
    swept: Array = points @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    return swept


def _camera_motion(key: str, camera: Camera, pan: float) -> tuple[Array, Array, Array]:
    """Translation, rotation vector and its origin, in rig axes, of a camera a unit parameter."""
    none = np.zeros(3)
    turned = cv2.Rodrigues(camera.pan_axis * (pan + camera.pan_zero))[0]
    if key == "pan_zero_deg":
        return none, camera.pan_axis, camera.pan_center
    what, axis, _ = key.rsplit("_", 2)
    unit = np.eye(3)[AXES.index(axis[-1])]
    if what == "pan_center":
        return unit, none, none
    if what == "pan_axis":
        return none, unit - turned @ unit, camera.pan_center
    if axis.startswith("r"):
        return none, turned @ unit, camera.rig_T_camera(pan)[:3, 3]
    return turned @ unit, none, none
