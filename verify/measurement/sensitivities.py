"""How spots move when a stated parameter does: derivatives of predicted pixels, all at once."""

from functools import lru_cache

import cv2
import numpy as np

from verify.core.fiducials import Marker
from verify.core.records import Array, Index, Sighting
from verify.core.rig import Camera, Rig
from verify.measurement.kernels import entries as kernel
from verify.measurement.kernels.entries import StatedCamera

AXES = ("x", "y", "z")
LENS = ("k1", "k2", "p1", "p2", "k3")


def spot_derivatives(
    names: tuple[str, ...],
    rig_T_flange: Array,
    sides: tuple[Sighting, Sighting],
    by_point: Array,
    rig: Rig,
    marker: Marker,
) -> Array:
    """Derivative of a pose's predicted spots by parameters, (p, s, 2), px a SI unit, left first.

    `by_point` (s, 2, 3), d px / d point in the rig. The robot's base moves no spot.
    """
    left, right = sides
    led = np.concatenate([left.led, right.led])
    body, by_camera = _group_parameters(names, marker.names)
    moved, spots = np.zeros((len(names), len(led), 2)), (marker.leds, led, rig_T_flange, by_point)
    cameras = (
        _stated_camera(by_camera["left"], rig.left, left.pan),
        _stated_camera(by_camera["right"], rig.right, right.pan),
    )
    kernel.fill_derivatives(spots, len(left), body, cameras, moved)
    return moved


def _stated_camera(
    parameters: tuple[tuple[int, ...], tuple[str, ...]], camera: Camera, pan: float
) -> StatedCamera:
    """One camera's parameters as the kernel takes them; `parameters`: columns and keys."""
    columns, keys = parameters
    kinds, twists = _kinds(keys, columns), _twists(keys, camera, pan)
    return kinds, twists, camera.matrix, camera.distortion, camera.camera_T_rig(pan)


@lru_cache(maxsize=16)
def _group_parameters(
    names: tuple[str, ...], leds: tuple[str, ...]
) -> tuple[Index, dict[str, tuple[tuple[int, ...], tuple[str, ...]]]]:
    """Those of LEDs and body, (., 4): column, kind, LED, axis; each camera's columns and keys."""
    body: list[tuple[int, int, int, int]] = []
    camera: dict[str, list[tuple[int, str]]] = {"left": [], "right": []}
    for column, name in enumerate(names):
        head, _, key = name.partition(".")
        if head in camera:
            camera[head].append((column, key))
        elif head == "body":
            axis = AXES.index(key.split("_")[0][-1])
            body.append((column, kernel.TURN if key.startswith("r") else kernel.SHIFT, 0, axis))
        elif head in ("led", "centre"):
            led, _, axis_name = key.rpartition(".")
            body.append((column, kernel.LED, leds.index(led), AXES.index(axis_name[0])))
    sides = {
        side: (tuple(c for c, _ in found), tuple(key for _, key in found))
        for side, found in camera.items()
    }
    return np.array(body, dtype=np.int64).reshape(-1, 4), sides


def camera_derivatives(
    keys: tuple[str, ...], camera: Camera, pan: float, inside: Array, points: Array, by_point: Array
) -> Array:
    """Derivative of one camera's pixels by some of its parameters, (k, m, 2).

    `keys` are their names in rig.toml; `pan`, rad, as read; `inside` and `points` (m, 3), m, the
    points in the camera and the same in the rig; `by_point` (m, 2, 3), d px / d point in the rig.
    """
    spots = (
        np.ascontiguousarray(inside), np.ascontiguousarray(points), np.ascontiguousarray(by_point)
    )  # fmt: skip
    moved, kinds = np.zeros((len(keys), len(points), 2)), _kinds(keys, tuple(range(len(keys))))
    optics = camera.matrix, camera.distortion
    kernel.fill_by_camera(kinds, _twists(keys, camera, pan), optics, spots, moved)
    return moved


@lru_cache(maxsize=32)
def _kinds(keys: tuple[str, ...], columns: tuple[int, ...]) -> Index:
    """Each of one camera's parameters: its column, what it is, which one of its kind, (k, 3)."""
    kinds = {kernel.MIDDLE: ("cx_px", "cy_px"), kernel.FOCAL: ("fx_px", "fy_px"), kernel.LENS: LENS}
    places = {name: (kind, i) for kind, names in kinds.items() for i, name in enumerate(names)}
    pairs = zip(columns, keys, strict=True)
    found = [(column, *places.get(key, (kernel.MOTION, 0))) for column, key in pairs]
    return np.array(found, dtype=np.int64).reshape(-1, 3)


@lru_cache(maxsize=8)
def _twists(keys: tuple[str, ...], camera: Camera, pan: float) -> Array:
    """How the camera moves a unit parameter: (k, 6), translation at the rig's origin and turn.

    The world moves against it. None for parameters that do not move it.
    """
    turned = np.asarray(cv2.Rodrigues(camera.pan_axis * (pan + camera.pan_zero))[0], dtype=float)
    twists = np.zeros((len(keys), 6))
    for i, kind, _ in _kinds(keys, tuple(range(len(keys)))).tolist():
        if kind == kernel.MOTION:
            twists[i] = _twist(keys[i], camera, pan, turned)
    return twists


def _twist(key: str, camera: Camera, pan: float, turned: Array) -> list[float]:
    if key == "pan_zero_deg":
        return _turn_about(camera.pan_axis, camera.pan_center)
    what, axis, _ = key.rsplit("_", 2)
    along = AXES.index(axis[-1])
    if what == "pan_center":
        return [float(i == along) for i in range(6)]
    if what == "pan_axis":
        turn = -turned[:, along]
        turn[along] += 1.0
        return _turn_about(turn, camera.pan_center)
    if axis.startswith("r"):
        return _turn_about(turned[:, along], camera.rig_T_camera(pan)[:3, 3])
    return [*turned[:, along].tolist(), 0.0, 0.0, 0.0]


def _turn_about(turn: Array, origin: Array) -> list[float]:
    """A turn about a point, as translation at the rig's origin and turn."""
    (a, b, c), (x, y, z) = turn.tolist(), origin.tolist()
    return [c * y - b * z, a * z - c * x, b * x - a * y, a, b, c]
