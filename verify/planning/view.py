"""Which LEDs either camera would see well enough to tell one from the other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.planning.wishes import Bench
from verify.records import Array
from verify.rig import Camera

Flags = NDArray[np.bool_]

BEYOND = 1.1  # of the picture's corner: farther out the lens' polynomial may fold back
NEAREST = 0.1  # m: no camera of this kind focuses nearer
APART = 1.5  # diameters between LED images that do not merge


@dataclass(frozen=True, slots=True)
class View:
    """What one camera would see of m poses of n LEDs."""

    pixels: Array  # (m, n, 2), px; nan behind the camera or far outside
    inside: Flags  # (m, n), clear of the picture's rim
    facing: Flags  # (m, n), the camera stands within the LEDs' angle of view
    apart: Flags  # (m, n), no other LED's image touches

    @property
    def seen(self) -> Flags:
        """All three, (m, n)."""
        return self.inside & self.facing & self.apart


def views(bench: Bench, base_T_flange: Array, margin: float, angle: float) -> tuple[View, View]:
    """Look at poses of the flange with both cameras.

    Args:
        bench: rig and marker; the bases stand at the rig's own pan.
        base_T_flange: (m, 4, 4), m.
        margin: px between an LED's centre and the picture's rim.
        angle: rad from the flange's z within which LEDs are seen.
    """
    rig_T_flange = bench.rig.rig_T_base @ base_T_flange
    points = bench.marker.leds @ np.swapaxes(rig_T_flange[:, :3, :3], 1, 2)
    points += rig_T_flange[:, None, :3, 3]
    left, right = (
        _view(bench, camera, points, rig_T_flange[:, :3, 2], margin, angle)
        for camera in (bench.rig.left, bench.rig.right)
    )
    return left, right


def _view(
    bench: Bench, camera: Camera, points: Array, normal: Array, margin: float, angle: float
) -> View:
    placed = camera.camera_T_rig(camera.pan)
    local = points @ placed[:3, :3].T + placed[:3, 3]
    depth = local[..., 2]
    near = np.maximum(depth, NEAREST)[..., None]
    size = np.array(bench.rig.image_size, dtype=float) - 1
    corners = np.array([[0.0, 0.0], [size[0], 0.0], [0.0, size[1]], size])
    widest = BEYOND * float(np.linalg.norm(camera.normalise(corners), axis=1).max())
    known = (depth > NEAREST) & (np.linalg.norm(local[..., :2] / near, axis=-1) < widest)
    pixels = camera.project(np.concatenate([local[..., :2], near], axis=-1))
    pixels[~known] = np.nan
    inside = np.all((pixels > margin) & (pixels < size - margin), axis=-1)  # nan is outside
    toward = camera.rig_T_camera(camera.pan)[:3, 3] - points
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    facing = np.einsum("mni,mi->mn", toward, normal) > np.cos(angle)
    diameter = camera.matrix[0, 0] * bench.marker.led_diameter / near[..., 0]
    gaps = np.linalg.norm(pixels[:, :, None] - pixels[:, None], axis=-1)
    gaps[:, range(len(bench.marker)), range(len(bench.marker))] = np.inf
    merged = gaps < APART * diameter[:, :, None]  # of one that is not in view, nan: none
    return View(pixels, inside, facing, ~merged.any(axis=2))
