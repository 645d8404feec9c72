"""Project corners of boards, and differentiate their pixels by all that moves them.

Of each corner of one camera (whitened, two rows): 40 columns,

    0 - 21   the camera's parameters, as in `parameters`
    22 - 24  the board's bow
    25 - 38  the board's own: pose (6), pan errors (2), motion (3), bend (3)
    39       observed less predicted

An adjustment sets these up dozens of times for thousands of corners: in numpy each time would pass
over all of them a hundred times.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.records import Array

COL_FOCAL, COL_PRINCIPAL, COL_LENS, COL_CENTER, COL_AXIS, COL_ZERO = 0, 2, 4, 9, 12, 15
COL_TURN, COL_OFFSET, COL_BOW, COL_POSE, COL_PAN, COL_MOTION, COL_BEND = 16, 19, 22, 25, 31, 33, 36
COL_RESIDUAL = 39
N_COLUMNS = 40
Index = NDArray[np.int64]


@compiled
def see_corners(
    board: Index,
    shape: tuple[Array, Array],
    boards: tuple[Array, Array],
    camera: tuple[Array, Array],
    side: int,
    places: tuple[Array, Array, Array],
    pixels: Array,
) -> None:
    """Place corners (n, 3), m, from the board's origin, the rig's and the camera's; project them.

    `board` (n,) is each corner's; `shape` its place on a flat board (n, 3) and the modes of the bow
    (n, 3); `boards` rig_T_board (b, 4, 4) and (b, 6): motion from left to right, and the bow with
    the bend; `camera` fx, fy, cx, cy, k1, k2, p1, p2, k3 and rig_T_camera (b, 4, 4); `side`: 0
    left, 1 right. Pixels (n, 2) are NaN behind the camera.
    """
    (flat, modes), (poses, moved), (lens, placed) = shape, boards, camera
    arms, points, seen = places
    for n in range(len(board)):
        b = board[n]
        x, y, z = flat[n, 0], flat[n, 1], flat[n, 2]
        for i in range(3):
            z += moved[b, 3 + i] * modes[n, i]
        for i in range(3):
            arms[n, i] = poses[b, i, 0] * x + poses[b, i, 1] * y + poses[b, i, 2] * z
            points[n, i] = arms[n, i] + poses[b, i, 3] + side * moved[b, i]
        for i in range(3):
            seen[n, i] = 0.0
            for j in range(3):
                seen[n, i] += placed[b, j, i] * (points[n, j] - placed[b, j, 3])
        depth = seen[n, 2] if seen[n, 2] > 0.0 else math.nan
        x, y = seen[n, 0] / depth, seen[n, 1] / depth
        r2, across = x * x + y * y, 2.0 * x * y
        radial = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
        u = x * radial + lens[6] * across + lens[7] * (r2 + 2.0 * x * x)
        v = y * radial + lens[6] * (r2 + 2.0 * y * y) + lens[7] * across
        pixels[n, 0], pixels[n, 1] = lens[0] * u + lens[2], lens[1] * v + lens[3]


@compiled
def fill_columns(
    board: Index,
    facing: tuple[Array, Array],
    base: tuple[Array, Array, Array],
    camera: tuple[Array, Array],
    side: int,
    places: tuple[Array, Array, Array],
    root: Array,
    columns: Array,
) -> None:
    """Fill in the derivatives (n, 2, 40) of corners whose residuals (n, 2), px, stand behind them.

    `facing`: rig_T_board (b, 4, 4) and the modes; `base`: the turntable's axes in the rig's
    (b, 3, 3), pan centre, pan axis; `root` (n, 2, 2) whitens; the others as in `see_corners`.
    """
    (poses, modes), (turned, center, axis), (lens, placed) = facing, base, camera
    arms, points, seen = places
    inside, by_point, about, spun = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(board)):
        b = board[n]
        x, y, depth = seen[n, 0] / seen[n, 2], seen[n, 1] / seen[n, 2], seen[n, 2]
        xx, yy, across = x * x, y * y, 2.0 * x * y
        r2 = xx + yy
        radial = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
        slope = 2.0 * (lens[4] + r2 * (2.0 * lens[5] + r2 * 3.0 * lens[8]))
        mixed = x * y * slope + 2.0 * (lens[6] * x + lens[7] * y)
        by_x = radial + xx * slope + 2.0 * lens[6] * y + 6.0 * lens[7] * x
        by_y = radial + yy * slope + 6.0 * lens[6] * y + 2.0 * lens[7] * x
        off_x, off_y = columns[n, 0, COL_RESIDUAL], columns[n, 1, COL_RESIDUAL]
        for row in range(2):
            c = columns[n, row]
            one, two = root[n, row, 0], root[n, row, 1]
            fx, fy = one * lens[0], two * lens[1]
            c[COL_RESIDUAL] = one * off_x + two * off_y
            c[COL_FOCAL] = one * (x * radial + lens[6] * across + lens[7] * (r2 + 2.0 * xx))
            c[COL_FOCAL + 1] = two * (y * radial + lens[6] * (r2 + 2.0 * yy) + lens[7] * across)
            c[COL_PRINCIPAL], c[COL_PRINCIPAL + 1] = one, two
            c[COL_LENS] = (fx * x + fy * y) * r2
            c[COL_LENS + 1] = (fx * x + fy * y) * r2 * r2
            c[COL_LENS + 2] = fx * across + fy * (r2 + 2.0 * yy)
            c[COL_LENS + 3] = fx * (r2 + 2.0 * xx) + fy * across
            c[COL_LENS + 4] = (fx * x + fy * y) * r2 * r2 * r2
            inside[0] = (fx * by_x + fy * mixed) / depth
            inside[1] = (fx * mixed + fy * by_y) / depth
            inside[2] = -(inside[0] * x + inside[1] * y)
            height = 0.0
            for i in range(3):
                by_point[i] = 0.0
                for j in range(3):
                    by_point[i] += inside[j] * placed[b, i, j]
                height += by_point[i] * poses[b, i, 2]
            # points move against the camera: a turn u about o moves a point r from o by -(u × r)
            c[COL_ZERO] = 0.0
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                about[i] = by_point[j] * (points[n, k] - center[k])
                about[i] -= by_point[k] * (points[n, j] - center[j])
                spun[i] = by_point[j] * (points[n, k] - placed[b, k, 3])
                spun[i] -= by_point[k] * (points[n, j] - placed[b, j, 3])
                c[COL_ZERO] += axis[i] * about[i]
                c[COL_POSE + 3 + i] = arms[n, j] * by_point[k] - arms[n, k] * by_point[j]
            c[COL_PAN + side] = c[COL_ZERO]
            for i in range(3):
                c[COL_CENTER + i], c[COL_POSE + i] = -by_point[i], by_point[i]
                c[COL_AXIS + i], c[COL_TURN + i], c[COL_OFFSET + i] = about[i], 0.0, 0.0
                for j in range(3):
                    c[COL_AXIS + i] -= about[j] * turned[b, j, i]
                    c[COL_TURN + i] += spun[j] * turned[b, j, i]
                    c[COL_OFFSET + i] -= by_point[j] * turned[b, j, i]
                c[COL_MOTION + i] = side * by_point[i]
                c[COL_BOW + i] = c[COL_BEND + i] = height * modes[n, i]
