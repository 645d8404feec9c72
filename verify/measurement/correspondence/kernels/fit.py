"""Fit a pose and a shift of the right image to the spots of many hypotheses.

With u the LEDs' images predicted at pose T and shift s, z their spots, V the spots' covariance,
H a weight that keeps the pose and S the variance of the shift, each Gauss-Newton step minimises

    chi² = sum (z - u(T, s))' V⁻¹ (z - u(T, s)) + dT' H dT + s' s / S
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import factor, invert, rotate, solve
from verify.core.records import Array

# camera_R_rig (2, 3, 3), optical centres (2, 3) m, focal lengths (2, 2) px; spots (2, s, 2) px, NaN
# where there is none, covariance (2, s, 2, 2) px², which are merged (2, s), which LEDs each may be
# (2, n, s); LEDs (n, 3) m, flange frame
Scene = tuple[Array, Array, Array, Array, Array, NDArray[np.bool_], NDArray[np.bool_], Array]
# nearest depth, m; an LED's play times the focal length, m px; inverse variance of the shift, 1/px²
Limits = tuple[float, float, float]

N_FREE = 8  # pose and shift
# Where the figures of a hypothesis stand in its row: rotation (3, 3), position (3,) m, shift (2,)
# px, inverse variances (6,) by which a step keeps the pose, chi², covariance (8, 8)
POSITION, SHIFT, HOLD, CHI2, COVARIANCE = 9, 12, 14, 20, 21
N_STATE = COVARIANCE + N_FREE**2


@compiled
def predict_image(
    scene: Scene,
    side: int,
    led: int,
    rotation: Array,
    position: Array,
    nearest: float,
    pixel: Array,
    derivative: Array,
) -> float:
    """Predict one LED's image in one camera, without the shift; gives the depth, m.

    `side`: left or right; `rotation` (3, 3), rig_R_flange, and `position` (3,), m; `nearest`, m:
    depth below which nothing is imaged. Filled: `pixel` (2,), and of `derivative` (2, 8) the first
    six columns, by position and rotation vector.
    """
    turn, center, focal, leds = scene[0], scene[1], scene[2], scene[7]
    p, q, r = leds[led, 0], leds[led, 1], leds[led, 2]
    u = rotation[0, 0] * p + rotation[0, 1] * q + rotation[0, 2] * r
    v = rotation[1, 0] * p + rotation[1, 1] * q + rotation[1, 2] * r
    w = rotation[2, 0] * p + rotation[2, 1] * q + rotation[2, 2] * r
    p, q = u + position[0] - center[side, 0], v + position[1] - center[side, 1]
    r = w + position[2] - center[side, 2]
    depth = float(turn[side, 2, 0] * p + turn[side, 2, 1] * q + turn[side, 2, 2] * r)
    ahead = depth if depth > nearest else 1.0
    for axis in range(2):
        d, e, f = turn[side, axis, 0], turn[side, axis, 1], turn[side, axis, 2]
        aside = d * p + e * q + f * r
        scale = focal[side, axis] / ahead
        pixel[axis] = scale * aside if depth > nearest else 0.0
        lean = -pixel[axis] / ahead
        a, b = scale * d + lean * turn[side, 2, 0], scale * e + lean * turn[side, 2, 1]
        c = scale * f + lean * turn[side, 2, 2]
        derivative[axis, 0], derivative[axis, 1], derivative[axis, 2] = a, b, c
        derivative[axis, 3] = c * v - b * w
        derivative[axis, 4] = a * w - c * u
        derivative[axis, 5] = b * u - a * v
    return depth


@compiled
def begin_fit(state: Array, sigmas: tuple[float, float, float]) -> None:
    """Fill in what a hypothesis (85,) has beside its pose before its first fit.

    `sigmas`: standard deviations by which steps keep the pose, m and rad, and of the shift, px.
    """
    for i in range(SHIFT, N_STATE):
        state[i] = 0.0
    state[CHI2] = math.inf
    for i in range(N_FREE):
        state[COVARIANCE + i * (N_FREE + 1)] = sigmas[i // 3] ** 2
    for i in range(6):
        state[HOLD + i] = sigmas[i // 3] ** -2


@compiled
def whitener(spread: Array, play: float, root: Array) -> None:
    """Inverse Cholesky factor of a (2, 2) covariance to whose diagonal `play` is added."""
    root[0, 0], root[0, 1] = 1.0 / math.sqrt(spread[0, 0] + play), 0.0
    slant = spread[1, 0] * root[0, 0]
    root[1, 1] = 1.0 / math.sqrt(spread[1, 1] + play - slant * slant)
    root[1, 0] = -slant * root[0, 0] * root[1, 1]


@compiled
def fit_all(
    scene: Scene, limits: Limits, state: Array, chosen: NDArray[np.int64], steps: int
) -> None:
    """Fit h hypotheses in place by Gauss-Newton, their spots held.

    `state` (h, 85), of which all but what keeps the pose is changed; chi² includes the shift's
    share. `chosen` (h, 2, n): spots, -1 for none. 0 `steps` compute covariance and chi² alone.
    """
    pixels, noise, leds = scene[3], scene[4], scene[7]
    nearest, play, shift_weight = limits
    roots = np.empty((2, len(leds), 2, 2))
    pixel, derivative, white = np.empty(2), np.zeros((2, N_FREE)), np.empty(N_FREE)
    information, root = np.empty((N_FREE, N_FREE)), np.empty((N_FREE, N_FREE))
    pull = np.empty(N_FREE)
    for h in range(len(state)):
        rotation, position = state[h, :POSITION].reshape(3, 3), state[h, POSITION:SHIFT]
        shift, covariance = state[h, SHIFT:HOLD], state[h, COVARIANCE:].reshape(N_FREE, N_FREE)
        total = 0.0
        for step in range(steps + 1):
            information[:], pull[:], total = 0.0, 0.0, 0.0
            for side in range(2):
                for led in range(len(leds)):
                    which = chosen[h, side, led]
                    if which < 0:
                        continue
                    depth = predict_image(
                        scene, side, led, rotation, position, nearest, pixel, derivative
                    )
                    derivative[0, 6] = derivative[1, 7] = float(side)
                    own = roots[side, led]
                    if step == 0:
                        whitener(noise[side, which], (play / max(depth, nearest)) ** 2, own)
                    off_x = pixels[side, which, 0] - pixel[0] - side * shift[0]
                    off_y = pixels[side, which, 1] - pixel[1] - side * shift[1]
                    for axis in range(2):
                        x, y = own[axis, 0], own[axis, 1]
                        residual = x * off_x + y * off_y
                        total += residual * residual
                        for a in range(N_FREE):
                            white[a] = x * derivative[0, a] + y * derivative[1, a]
                            pull[a] += white[a] * residual
                        for a in range(N_FREE):
                            for b in range(N_FREE):
                                information[a, b] += white[a] * white[b]
            for a in range(N_FREE):
                information[a, a] += state[h, HOLD + a] if a < 6 else shift_weight
            factor(information, 0.0, root)
            if step < steps:
                pull[6] -= shift_weight * shift[0]
                pull[7] -= shift_weight * shift[1]
                solve(root, pull)
                rotate(rotation, pull[3:6])
                for i in range(3):
                    position[i] += pull[i]
                shift[0] += pull[6]
                shift[1] += pull[7]
        invert(root, covariance)
        state[h, CHI2] = total + shift_weight * (shift[0] * shift[0] + shift[1] * shift[1])
