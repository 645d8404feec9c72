"""Fill in the derivatives of spots by the parameters of cameras, LEDs and their body.

A parameter that moves a camera by the twist (t, w) moves the spot of a point x, g its derivative by
the point, by -(g . t + w . (x x g)); lens and focal length move it by their own derivative.
"""

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import dot
from verify.core.records import Array

MIDDLE, FOCAL, LENS, MOTION = range(4)
LED, SHIFT, TURN = range(3)
Index = NDArray[np.int64]


@compiled
def place_leds(
    leds: Array, led: Index, rig_T_flange: Array, placed: tuple[Array, Array], left: int
) -> tuple[Array, Array, Array]:
    """Place spots' LEDs, (s, 3) each, m: LED from flange, rig axes; in the rig; in the camera.

    `leds` (n, 3), m, flange frame; `led` (s,), of each spot; `placed`: camera_T_rig (4, 4) of the
    left camera, whose spots are the first `left` ones, and of the right one.
    """
    offset, points = np.empty((len(led), 3)), np.empty((len(led), 3))
    inside = np.empty((len(led), 3))
    for s in range(len(led)):
        for i in range(3):
            offset[s, i] = dot(rig_T_flange[i, :3], leds[led[s]])
            points[s, i] = offset[s, i] + rig_T_flange[i, 3]
        camera = placed[0] if s < left else placed[1]
        for i in range(3):
            inside[s, i] = dot(camera[i, :3], points[s]) + camera[i, 3]
    return offset, points, inside


@compiled
def fill_by_camera(
    kinds: Index,
    twists: Array,
    camera: tuple[Array, Array],
    spots: tuple[Array, Array, Array],
    first: int,
    moved: Array,
) -> None:
    """Fill in how one camera's parameters move its s spots.

    `kinds` (k, 3): the parameter's column, what it is, which one of its kind; `twists` (k, 6), how
    it moves the camera: translation at the rig's origin (m) and turn; `camera`: its matrix (3, 3),
    px, and k1, k2, p1, p2, k3; `spots`: points in the camera and the same in the rig, (s, 3), m,
    and d px / d point in the rig, (s, 2, 3); `moved` (p, n, 2), px a SI unit, zeros: those of the
    camera's spots, from `first` on, are filled.
    """
    (matrix, lens), (inside, points, by_point) = camera, spots
    lenses, ideal = np.empty((5, 2)), np.empty(2)
    for s in range(len(points)):
        x, y = inside[s, 0] / inside[s, 2], inside[s, 1] / inside[s, 2]
        r2, twice = x * x + y * y, 2.0 * x * y
        for i, unit in enumerate((x, y)):
            lenses[0, i] = r2 * unit
            lenses[1, i] = r2 * r2 * unit
            lenses[4, i] = r2 * r2 * r2 * unit
        lenses[2, 0], lenses[2, 1] = twice, r2 + 2.0 * y * y
        lenses[3, 0], lenses[3, 1] = r2 + 2.0 * x * x, twice
        for i, unit in enumerate((x, y)):
            ideal[i] = unit
            for c in range(5):
                ideal[i] += lens[c] * lenses[c, i]
        for k in range(len(kinds)):
            column, kind, which = kinds[k, 0], kinds[k, 1], kinds[k, 2]
            if kind == MIDDLE:
                moved[column, first + s, which] = 1.0
            elif kind == FOCAL:
                moved[column, first + s, which] = ideal[which]
            elif kind == LENS:
                for axis in range(2):
                    for i in range(2):
                        moved[column, first + s, axis] += matrix[axis, i] * lenses[which, i]
            else:
                u, v, w = points[s, 0], points[s, 1], points[s, 2]
                for axis in range(2):
                    a, b, c = by_point[s, axis, 0], by_point[s, axis, 1], by_point[s, axis, 2]
                    along = a * twists[k, 0] + b * twists[k, 1] + c * twists[k, 2]
                    about = twists[k, 3] * (v * c - w * b) + twists[k, 4] * (w * a - u * c)
                    about += twists[k, 5] * (u * b - v * a)
                    moved[column, first + s, axis] = -(along + about)


@compiled
def fill_by_body(
    kinds: Index, led: Index, rig_R_flange: Array, offset: Array, by_point: Array, moved: Array
) -> None:
    """Fill in how LEDs, and the body that holds them, move the spots.

    `kinds` (k, 4): the parameter's column, what it is, its LED, its axis of the flange; `led` (s,),
    of each spot; `rig_R_flange` (3, 3); `offset` (s, 3), m, LED from flange, rig axes; `by_point`
    (s, 2, 3), d px / d point in the rig; `moved` (p, s, 2), px a SI unit, its columns filled.
    """
    for column, kind, which, axis in kinds:
        x, y, z = rig_R_flange[0, axis], rig_R_flange[1, axis], rig_R_flange[2, axis]
        for s in range(len(led)):
            if kind == LED and led[s] != which:
                continue
            along = (x, y, z)
            if kind == TURN:
                a, b, c = offset[s, 0], offset[s, 1], offset[s, 2]
                along = (y * c - z * b, z * a - x * c, x * b - y * a)
            for i in range(2):
                slope = by_point[s, i]
                moved[column, s, i] = (
                    slope[0] * along[0] + slope[1] * along[1] + slope[2] * along[2]
                )
