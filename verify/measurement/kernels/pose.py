"""Predict the spots of a pose, and fit a pose to spots by Gauss-Newton.

With z the spots of both images, u(T) their prediction, D its derivative by the pose, C the spots'
covariance from pixels and a from an unknown acceleration, each step is

    (D' (C + a)⁻¹ D)⁻¹ D' (C + a)⁻¹ (z - u(T))

restricted to the directions that the spots determine.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import dot, factor, invert, rotate, solve
from verify.core.records import Array

Flags = NDArray[np.bool_]
SpotPlaces = tuple[Array, Array, Array, Array, Array, Array]  # as `predict_spots` takes them

N_FREE = 6
LEVER = 0.1  # m, the size of a marker: makes metres and radians comparable
SCALE = np.repeat([LEVER, 1.0], 3)  # m and rad: units in which both are alike
# LEDs nearly on a line: a turn less certain than this is no measurement, and too large
# for the linearisation that its uncertainty rests on.
MAX_UNCERTAINTY = 0.1  # rad, or 10 mm at the marker's size
MIN_INFORMATION = 1e-10  # information a direction, relative to the best: rounding, not measurement
MAX_ITERATIONS = 25
# Acceleration assumed a speed, 1/s: arms move in sines near 0.5 Hz (2 pi f = 3) or in ramps of a
# third of a second. The session's own motion corrects it afterwards (comparison.py).
ACCELERATION_PER_SPEED = 3.0
MOTION_RATE = 3.0  # likewise: of jerk an acceleration, of snap a jerk, 1/s
MIN_ACCELERATION = (0.02, 0.1)  # m/s², rad/s²: a slow arm still starts and stops
TIME_STEP = 0.01  # s, of the image's acceleration: long against rounding, short against the motion
TOL_STEP = 1e-10  # m and rad: a thousandth of the smallest uncertainty that pixels allow
RIDGE = 1e-6  # of the mean information: keeps the motion of one or two LEDs solvable
CLEAN_PX = 0.1  # px, standard uncertainty up to which the velocities of spots count alike
MIN_VARIANCE = 1e-6  # px²: against 0/0 where nothing else checks a spot


@compiled
def predict_spots(
    rig_T_flange: Array,
    points: Array,
    camera_R_rig: Array,
    origin: Array,
    lens: Array,
    focal: Array,
    middle: Array,
    pixels: Array,
    by_point: Array,
    by_pose: Array,
) -> None:
    """Fill in s spots' images and how they change with the point and with the pose.

    `rig_T_flange` (4, 4); `points` (s, 3), m, LEDs in the flange frame; of each spot's camera
    `camera_R_rig` (s, 3, 3), `origin` (s, 3), m, of the rig in the camera, `lens` (5, s), k1, k2,
    p1, p2, k3, `focal` (s, 2, 2), px, and `middle` (s, 2), px, principal points. Filled: `pixels`
    (s, 2); `by_point` (s, 2, 3), px/m, by the point in the rig; `by_pose` (s, 2, 6), by a
    translation and a rotation vector in rig axes.
    """
    for s in range(len(points)):
        px, py, pz = points[s, 0], points[s, 1], points[s, 2]
        a = rig_T_flange[0, 0] * px + rig_T_flange[0, 1] * py + rig_T_flange[0, 2] * pz
        b = rig_T_flange[1, 0] * px + rig_T_flange[1, 1] * py + rig_T_flange[1, 2] * pz
        c = rig_T_flange[2, 0] * px + rig_T_flange[2, 1] * py + rig_T_flange[2, 2] * pz
        u, v, w = a + rig_T_flange[0, 3], b + rig_T_flange[1, 3], c + rig_T_flange[2, 3]
        turn = camera_R_rig[s]
        depth = turn[2, 0] * u + turn[2, 1] * v + turn[2, 2] * w + origin[s, 2]
        x = (turn[0, 0] * u + turn[0, 1] * v + turn[0, 2] * w + origin[s, 0]) / depth
        y = (turn[1, 0] * u + turn[1, 1] * v + turn[1, 2] * w + origin[s, 1]) / depth
        k1, k2, p1, p2, k3 = lens[0, s], lens[1, s], lens[2, s], lens[3, s], lens[4, s]
        r2 = x * x + y * y
        higher = r2 * k3 + k2
        radial = 1.0 + r2 * (k1 + r2 * higher)
        slope = 2.0 * (k1 + r2 * (higher + higher + r2 * k3))  # d radial / d r2, times 2
        straight = radial + 2.0 * (p1 * y + p2 * x)
        distorted_x, distorted_y = x * straight + p2 * r2, y * straight + p1 * r2
        xx = straight + x * x * slope + 4.0 * p2 * x
        xy = x * y * slope + 2.0 * (p1 * x + p2 * y)
        yy = straight + y * y * slope + 4.0 * p1 * y
        for i in range(2):
            f, g = focal[s, i, 0], focal[s, i, 1]
            pixels[s, i] = f * distorted_x + g * distorted_y + middle[s, i]
            by_x, by_y = (f * xx + g * xy) / depth, (f * xy + g * yy) / depth
            by_depth = -(by_x * x + by_y * y)
            d = by_x * turn[0, 0] + by_y * turn[1, 0] + by_depth * turn[2, 0]
            e = by_x * turn[0, 1] + by_y * turn[1, 1] + by_depth * turn[2, 1]
            h = by_x * turn[0, 2] + by_y * turn[1, 2] + by_depth * turn[2, 2]
            by_point[s, i, 0], by_point[s, i, 1], by_point[s, i, 2] = d, e, h
            by_pose[s, i, 0], by_pose[s, i, 1], by_pose[s, i, 2] = d, e, h
            by_pose[s, i, 3], by_pose[s, i, 4] = h * b - e * c, d * c - h * a
            by_pose[s, i, 5] = e * a - d * b


@compiled
def move_pose(pose: Array, step: Array) -> None:
    """Move a pose (4, 4) in place by translation and rotation vector (6,)."""
    rotate(pose, step[3:])
    for j in range(3):
        pose[j, 3] += step[j]


@compiled
def image_acceleration(places: SpotPlaces, pose: Array, twist: Array) -> Array:
    """Image acceleration of spots (s, 2), px/s², at a pose under a steady twist (6,), m/s, rad/s.

    LEDs that turn about the flange, and points that come nearer, do not cross the image at a steady
    rate even then. It points one way, so it would not average out. `places` as `predict_spots`
    takes them.
    """
    count = len(places[0])
    pixels, second = np.empty((count, 2)), np.zeros((count, 2))
    by_point, by_pose = np.empty((count, 2, 3)), np.empty((count, 2, 6))
    for h, share in ((-TIME_STEP, 1.0), (0.0, -2.0), (TIME_STEP, 1.0)):
        moved = pose.copy()
        move_pose(moved, twist * h)
        predict_spots(moved, *places, pixels, by_point, by_pose)
        for s in range(count):
            for i in range(2):
                second[s, i] += share * pixels[s, i] / TIME_STEP**2
    return second


@compiled
def covariance_of(information: Array, inverse: Array, vectors: Array, known: Flags) -> None:
    """Fill in the covariance in the directions that an information matrix (6, 6) determines.

    The information matrix, 1/m² and 1/rad², of one or two LEDs (or of LEDs on one line) is
    singular; its null vectors are the motions that no picture shows. Filled: `inverse` (6, 6);
    `vectors` (6, 6), columns, directions in units of SCALE, only where one of them is not known;
    `known` (6,).
    """
    scaled, root, trace = np.empty((N_FREE, N_FREE)), np.empty((N_FREE, N_FREE)), 0.0
    for i in range(N_FREE):
        for j in range(N_FREE):
            scaled[i, j] = information[i, j] * SCALE[i] * SCALE[j]
        trace += scaled[i, i]
    known[:], inverse[:] = True, 0.0
    # no eigenvalue is so small: the usual case, decided without the eigenvalues
    if factor(scaled, max(MIN_INFORMATION * trace, MAX_UNCERTAINTY**-2), root):
        factor(scaled, 0.0, root)
        invert(root, inverse)
    else:
        values, found = np.linalg.eigh(scaled)
        for k in range(N_FREE):
            known[k] = values[k] > max(MIN_INFORMATION * values[-1], MAX_UNCERTAINTY**-2)
            for i in range(N_FREE):
                vectors[i, k] = found[i, k]
                for j in range(N_FREE):
                    if known[k]:
                        inverse[i, j] += found[i, k] * found[j, k] / values[k]
    for i in range(N_FREE):
        for j in range(N_FREE):
            inverse[i, j] *= SCALE[i] * SCALE[j]


@compiled
def twist_from_velocities(
    design: Array, velocity: Array, covariance: Array, rows: NDArray[np.int64], twist: Array
) -> tuple[float, float]:
    """Fill in how the flange moves, `twist` (6,), m/s and rad/s, from the spots' velocities.

    `design` (2 s, 6), derivative of the spots by the pose; `velocity` (2 s,), px/s; `covariance`
    (s, 2, 2), px², of the spots: clean ones count alike, doubtful ones hardly; `rows` (2 k,), those
    of the kept spots. Gives the acceleration that this suggests, a component, m/s² and rad/s².
    """
    linear, angular = MIN_ACCELERATION
    twist[:] = 0.0
    moving = False
    for row in rows:
        moving = moving or velocity[row] != 0.0
    if not moving:
        return linear, angular
    square, root, trace = np.zeros((N_FREE, N_FREE)), np.empty((N_FREE, N_FREE)), 0.0
    for row in rows:
        share = CLEAN_PX**2 / (CLEAN_PX**2 + covariance[row // 2, row % 2, row % 2])
        for i in range(N_FREE):
            scaled = share * design[row, i] * SCALE[i]
            twist[i] += scaled * velocity[row]
            for j in range(N_FREE):
                square[i, j] += scaled * design[row, j] * SCALE[j]
            trace += scaled * design[row, i] * SCALE[i]
    factor(square, -RIDGE * trace / N_FREE, root)
    solve(root, twist)
    for i in range(N_FREE):
        twist[i] *= SCALE[i]
    linear += ACCELERATION_PER_SPEED * math.sqrt(dot(twist[:3], twist[:3]))
    angular += ACCELERATION_PER_SPEED * math.sqrt(dot(twist[3:], twist[3:]))
    return linear / math.sqrt(3.0), angular / math.sqrt(3.0)


@compiled
def spot_covariance(
    design: Array,
    spots: tuple[Array, Array, Array],
    rows: NDArray[np.int64],
    prior: tuple[float, float],
    spread: tuple[Array, Array, Array],
) -> None:
    """Fill in the covariance of the spots (2 s, 2 s), px², by its sources, and its inverse.

    `design` (2 s, 6), derivative of the spots by the pose; `spots`: covariance (s, 2, 2) px²,
    velocity, and levers (s, 3) of acceleration, jerk, snap; `rows` (2 k,), those of the kept spots;
    `prior`: acceleration, m/s² and rad/s² a component. `spread`: from the pixels, from motion that
    is not known, and the inverse of their sum: that of the kept spots, 0 for the others.
    """
    covariance, _, lever = spots
    noise, acceleration, weight = spread
    noise[:], weight[:] = 0.0, 0.0
    moved, levers = np.empty((len(noise), N_FREE)), lever.copy()
    for s in range(len(covariance)):
        for a in range(2):
            for b in range(2):
                noise[2 * s + a, 2 * s + b] = covariance[s, a, b]
            for k in range(N_FREE):
                moved[2 * s + a, k] = prior[k // 3] * design[2 * s + a, k]
        for order in range(1, lever.shape[1]):
            levers[s, order] *= MOTION_RATE**order
    for i in range(len(noise)):
        for j in range(i + 1):
            shared = 0.0
            for k in range(N_FREE):
                shared += moved[i, k] * moved[j, k]
            shared *= dot(levers[i // 2], levers[j // 2])
            acceleration[i, j] = acceleration[j, i] = shared
    count = len(rows)
    kept, root = np.empty((count, count)), np.empty((count, count))
    for i in range(count):
        for j in range(count):
            kept[i, j] = noise[rows[i], rows[j]] + acceleration[rows[i], rows[j]]
    factor(kept, 0.0, root)
    invert(root, kept)
    for i in range(count):
        for j in range(count):
            weight[rows[i], rows[j]] = kept[i, j]


@compiled
def pose_information(design: Array, weight: Array, weighted: Array, information: Array) -> None:
    """Fill in what the spots weigh in the pose (6, 2 s), and its information (6, 6)."""
    information[:], weighted[:] = 0.0, 0.0
    for row in range(len(design)):
        for i in range(N_FREE):
            for column in range(len(design)):
                weighted[i, column] += design[row, i] * weight[row, column]
    for i in range(N_FREE):
        for column in range(len(design)):
            for j in range(N_FREE):
                information[i, j] += weighted[i, column] * design[column, j]


@compiled
def fit_spots(
    places: SpotPlaces,
    centre: Array,
    spots: tuple[Array, Array, Array],
    rows: NDArray[np.int64],
    pose: Array,
) -> tuple[
    tuple[Array, Array, Array],
    tuple[Array, Array, Array],
    Array,
    tuple[Array, Flags],
    Array,
    tuple[float, float],
    Array,
    tuple[Array, Array, Array, float],
]:
    """Fit a pose (4, 4), rig_T_flange, to s spots by Gauss-Newton; it is changed.

    `places`: what `predict_spots` needs after the pose; `centre` (s, 2), px, as measured; `spots`:
    covariance (s, 2, 2) px², velocity (s, 2) px/s and the levers (s, 3) of acceleration, jerk and
    snap, s², s³, s⁴; `rows` (2 k,), those of the spots that count.

    Returns:
        Residual (s, 2) px, and the derivatives of the spots by the point (s, 2, 3) and by the pose
        (s, 2, 6), before the last step; those of `spot_covariance`, (2 s, 2 s) each; the gain
        (6, 2 s), d pose / d spot, 0 for spots that do not count; the directions of `covariance_of`,
        (6, 6) and (6,); the twist (6,), m/s and rad/s; the acceleration assumed, a component, m/s²
        and rad/s²; the image acceleration of that twist, corrected for, (s, 2), px/s²; what
        `fit_covariances` gives.
    """
    count, lever = len(centre), spots[2]
    residual, by_point = np.empty((count, 2)), np.empty((count, 2, 3))
    by_pose, size = np.empty((count, 2, N_FREE)), (2 * count, 2 * count)
    spread = np.empty(size), np.empty(size), np.empty(size)
    gain, twist, prior = np.empty((N_FREE, 2 * count)), np.empty(N_FREE), (0.0, 0.0)
    directions, known = np.empty((N_FREE, N_FREE)), np.empty(N_FREE, np.bool_)
    design, off = by_pose.reshape(-1, N_FREE), residual.reshape(-1)
    weighted, step = np.empty((N_FREE, len(off))), np.empty(N_FREE)
    information, inverse = np.empty((N_FREE, N_FREE)), np.empty((N_FREE, N_FREE))
    curvature, straight = np.zeros((count, 2)), False
    for s in range(count):
        straight = straight or lever[s, 0] != 0.0
    for iteration in range(MAX_ITERATIONS):
        predict_spots(pose, *places, residual, by_point, by_pose)
        # velocities and their lever change nothing measurable in later rounds
        if iteration == 0 or (iteration == 1 and straight):
            prior = twist_from_velocities(design, spots[1].reshape(-1), spots[0], rows, twist)
            spot_covariance(design, spots, rows, prior, spread)
            if straight:
                curvature = image_acceleration(places, pose, twist)
        for s in range(count):
            for axis in range(2):
                measured = centre[s, axis] - lever[s, 0] * curvature[s, axis]
                residual[s, axis] = measured - residual[s, axis]
        pose_information(design, spread[2], weighted, information)
        covariance_of(information, inverse, directions, known)
        largest = 0.0
        for i in range(N_FREE):
            step[i] = 0.0
            for column in range(len(off)):
                gain[i, column] = 0.0
                for j in range(N_FREE):
                    gain[i, column] += inverse[i, j] * weighted[j, column]
                step[i] += gain[i, column] * off[column]
            largest = max(largest, abs(step[i]))
        move_pose(pose, step)
        if largest < TOL_STEP:
            break
    motion = twist, prior, curvature, fit_covariances(off, spread, gain)
    return (residual, by_point, by_pose), spread, gain, (directions, known), *motion


@compiled
def fit_covariances(
    off: Array, spread: tuple[Array, Array, Array], gain: Array
) -> tuple[Array, Array, Array, float]:
    """Give the pose's covariances (6, 6), spots' uncertainty (s,), px, and the residuals' chi².

    Of the pose by the pixels' noise and by motion that is not known; of a spot in a coordinate by
    both. `off` (2 s,), px; `spread` and `gain` are those of `fit_spots`.
    """
    noise, acceleration, weight = spread
    pixels, alignment = np.zeros((N_FREE, N_FREE)), np.zeros((N_FREE, N_FREE))
    uncertainty, chi2, half = np.empty(len(off) // 2), 0.0, np.empty(len(off))
    for source, covariance in ((noise, pixels), (acceleration, alignment)):
        for i in range(N_FREE):
            half[:] = 0.0
            for row in range(len(off)):
                for column in range(len(off)):
                    half[column] += gain[i, row] * source[row, column]
            for j in range(N_FREE):
                for column in range(len(off)):
                    covariance[i, j] += half[column] * gain[j, column]
    for row in range(len(off)):
        for column in range(len(off)):
            chi2 += off[row] * weight[row, column] * off[column]
    for s in range(len(uncertainty)):
        a, b = 2 * s, 2 * s + 1
        variance = noise[a, a] + acceleration[a, a] + noise[b, b] + acceleration[b, b]
        uncertainty[s] = math.sqrt(variance / 2.0)
    return pixels, alignment, uncertainty, chi2


@compiled
def judge_fit(
    predicted: tuple[Array, Array, Array],
    spread: tuple[Array, Array, Array],
    gain: Array,
    rows: NDArray[np.int64],
    tolerance: Array,
    chi2: tuple[float, float],
) -> tuple[int, float, bool]:
    """Find the kept spot that fits worst, and say whether the kept ones agree as a whole.

    `predicted`, `spread` and `gain` (6, 2 s) are those of `fit_spots`; `rows` (2 k,), those of the
    kept spots; `tolerance` (2 s, 2 s), px²: what spots may be off beside their noise; `chi2`: that
    of the residuals, and the greatest that noise, motion and tolerance reach.

    Returns:
        The worst spot; its residual in its own uncertainty, squared; whether they agree.
    """
    residual, _, by_pose = predicted
    design, count = by_pose.reshape(-1, N_FREE), len(rows)
    total, root, off = np.empty((count, count)), np.empty((count, count)), np.empty(count)
    for i in range(count):
        off[i] = residual[rows[i] // 2, rows[i] % 2]
        for j in range(count):
            a, b = rows[i], rows[j]
            total[i, j] = spread[0][a, b] + spread[1][a, b] + tolerance[a, b]
    hat, half, block = np.empty((2, count)), np.empty((2, count)), np.empty((2, 2))
    worst, most = 0, -math.inf
    for first in range(0, count, 2):
        block[:], half[:] = 0.0, 0.0
        for axis in range(2):
            for i in range(count):
                hat[axis, i] = 1.0 if i == first + axis else 0.0
                for k in range(N_FREE):
                    hat[axis, i] -= design[rows[first + axis], k] * gain[k, rows[i]]
            for i in range(count):
                for j in range(count):
                    half[axis, j] += hat[axis, i] * total[i, j]
        for i in range(count):
            for axis in range(2):
                block[axis, 0] += half[axis, i] * hat[0, i]
                block[axis, 1] += half[axis, i] * hat[1, i]
        a, d = block[0, 0] + MIN_VARIANCE, block[1, 1] + MIN_VARIANCE
        x, y = off[first], off[first + 1]
        across = (block[0, 1] + block[1, 0]) * x * y
        size = (d * x * x - across + a * y * y) / (a * d - block[0, 1] * block[1, 0])
        if size > most:
            worst, most = rows[first] // 2, size
    own, most_chi2 = chi2
    if not own < most_chi2:
        solved = off.copy()
        factor(total, 0.0, root)
        solve(root, solved)
        own = 0.0
        for i in range(count):
            own += off[i] * solved[i]
    return worst, most, own < most_chi2
