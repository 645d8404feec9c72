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
        columns, keys = plan.camera[side]
        moved[columns, spots] = camera_pixels(keys, camera, sighting.pan, inside, points, by_point)
    return moved


@dataclass(frozen=True, slots=True)
class _Plan:
    """Parameters by kind: the column of each, and what it moves along or about."""

    leds: NDArray[np.intp]  # (3, .): column, LED, axis
    shifts: NDArray[np.intp]  # (2, .): column, axis, of the LED body along the flange's axes
    turns: NDArray[np.intp]  # (2, .), of the LED body about them
    camera: dict[str, tuple[NDArray[np.intp], tuple[str, ...]]]  # columns, and the parameters' keys


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
    sides = {
        side: (np.array([c for c, _ in found], dtype=np.intp), tuple(key for _, key in found))
        for side, found in camera.items()
    }
    return _Plan(moved, body_shifts, body_turns, sides)


def camera_pixels(
    keys: tuple[str, ...],
    camera: Camera,
    pan: float,
    inside: Array,
    points: Array,
    by_point: Array,
) -> Array:
    """Derivative of one camera's pixels by some of its parameters, (k, m, 2).

    Args:
        keys: k parameters, by their names in rig.toml.
        camera: theirs.
        pan: rad, as read.
        inside: (m, 3), m, the points in the camera.
        points: (m, 3), m, the same in the rig.
        by_point: (m, 2, 3), d px / d point in the rig.
    """
    kinds = _sorted(keys)
    moved = np.zeros((len(keys), *by_point.shape[:2]))
    xy = inside[:, :2] / inside[:, 2:3]
    rows, axis = kinds.middle
    moved[rows, :, axis] = 1.0
    rows, axis = kinds.focal
    if len(rows):
        moved[rows, :, axis] = distort(xy, camera.distortion).T[axis]
    rows, which = kinds.lens
    if len(rows):
        moved[rows] = (_by_lens(xy) @ camera.matrix[:2, :2].T)[which]
    if len(kinds.motion):
        twist = _twists(tuple(keys[row] for row in kinds.motion), camera, pan)
        x, y, z = points[:, None, 0], points[:, None, 1], points[:, None, 2]
        a, b, c = by_point[..., 0], by_point[..., 1], by_point[..., 2]
        by_twist = np.stack([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a])
        pixels = twist @ by_twist.reshape(6, by_point.shape[0] * by_point.shape[1])
        moved[kinds.motion] = -pixels.reshape(len(twist), *by_point.shape[:2])
    return moved


@dataclass(frozen=True, slots=True)
class _Kinds:
    """One camera's parameters by kind: the row of each, and which one of its kind it is."""

    middle: tuple[NDArray[np.intp], ...]
    focal: tuple[NDArray[np.intp], ...]
    lens: tuple[NDArray[np.intp], ...]
    motion: NDArray[np.intp]


@lru_cache(maxsize=32)
def _sorted(keys: tuple[str, ...]) -> _Kinds:
    middle, focal, lens = (
        _places(keys, kind) for kind in (("cx_px", "cy_px"), ("fx_px", "fy_px"), LENS)
    )
    others = set(range(len(keys))).difference(*(rows.tolist() for rows, _ in (middle, focal, lens)))
    return _Kinds(middle, focal, lens, np.array(sorted(others), dtype=np.intp))


def _places(keys: tuple[str, ...], kind: tuple[str, ...]) -> tuple[NDArray[np.intp], ...]:
    """Rows of the keys that are of a kind, and which of it each is."""
    rows = [row for row, key in enumerate(keys) if key in kind]
    which = [kind.index(keys[row]) for row in rows]
    return np.array(rows, dtype=np.intp), np.array(which, dtype=np.intp)


def _by_lens(xy: Array) -> Array:
    """Derivative of distorted coordinates (m, 2) by the coefficients, in which they are linear."""
    x, y = xy.T
    r2, twice = x * x + y * y, 2 * x * y
    radial = r2[:, None] * xy
    tangential = np.stack([twice, r2 + 2 * y * y], -1), np.stack([r2 + 2 * x * x, twice], -1)
    fourth = r2[:, None] * radial
    return np.stack([radial, fourth, *tangential, r2[:, None] * fourth])


def swept(turn: Array, points: Array) -> Array:
    """Cross product turn x points, (..., 3); numpy's own takes five times as long."""
    x, y, z = turn.tolist()
    swept: Array = points @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    return swept


def _twists(keys: tuple[str, ...], camera: Camera, pan: float) -> Array:
    """How the camera moves a unit parameter: (k, 6), translation at the rig's origin and turn.

    The world moves against it.
    """
    turned = np.asarray(cv2.Rodrigues(camera.pan_axis * (pan + camera.pan_zero))[0], dtype=float)
    return np.array([_twist(key, camera, pan, turned) for key in keys])


def _twist(key: str, camera: Camera, pan: float, turned: Array) -> list[float]:
    if key == "pan_zero_deg":
        return _about(camera.pan_axis, camera.pan_center)
    what, axis, _ = key.rsplit("_", 2)
    along = AXES.index(axis[-1])
    if what == "pan_center":
        return [float(i == along) for i in range(6)]
    if what == "pan_axis":
        turn = -turned[:, along]
        turn[along] += 1.0
        return _about(turn, camera.pan_center)
    if axis.startswith("r"):
        return _about(turned[:, along], camera.rig_T_camera(pan)[:3, 3])
    return [*turned[:, along].tolist(), 0.0, 0.0, 0.0]


def _about(turn: Array, origin: Array) -> list[float]:
    """A turn about a point, as translation at the rig's origin and turn."""
    (a, b, c), (x, y, z) = turn.tolist(), origin.tolist()
    return [c * y - b * z, a * z - c * x, b * x - a * y, a, b, c]
