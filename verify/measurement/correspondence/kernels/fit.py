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
    led: Array,
    rotation: Array,
    position: Array,
    camera_R_rig: Array,
    center: Array,
    focal: Array,
    nearest: float,
    pixel: Array,
    derivative: Array,
) -> float:
    """Predict one LED's image in one camera, without the shift; gives the depth, m.

    `led` (3,), m, flange frame; `rotation` (3, 3), rig_R_flange, and `position` (3,), m;
    `camera_R_rig` (3, 3); `center` (3,), m, rig frame; `focal` (2,), px; `nearest`, m: depth below
    which nothing is imaged. Filled: `pixel` (2,), and of `derivative` (2, 8) the first six columns,
    by position and rotation vector.
    """
    arm, local = np.empty(3), np.empty(3)
    for i in range(3):
        arm[i] = rotation[i, 0] * led[0] + rotation[i, 1] * led[1] + rotation[i, 2] * led[2]
    for i in range(3):
        local[i] = 0.0
        for j in range(3):
            local[i] += camera_R_rig[i, j] * (arm[j] + position[j] - center[j])
    depth = local[2]
    if depth <= nearest:
        local[0], local[1], local[2] = 0.0, 0.0, 1.0
    for axis in range(2):
        scale = focal[axis] / local[2]
        pixel[axis] = scale * local[axis]
        lean = -pixel[axis] / local[2]
        a = scale * camera_R_rig[axis, 0] + lean * camera_R_rig[2, 0]
        b = scale * camera_R_rig[axis, 1] + lean * camera_R_rig[2, 1]
        c = scale * camera_R_rig[axis, 2] + lean * camera_R_rig[2, 2]
        derivative[axis, 0], derivative[axis, 1], derivative[axis, 2] = a, b, c
        derivative[axis, 3] = c * arm[1] - b * arm[2]
        derivative[axis, 4] = a * arm[2] - c * arm[0]
        derivative[axis, 5] = b * arm[0] - a * arm[1]
    return float(depth)


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
    camera_R_rig, center, focal, pixels, noise, _, _, leds = scene
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
                        leds[led], rotation, position, camera_R_rig[side], center[side],
                        focal[side], nearest, pixel, derivative,
                    )  # fmt: skip
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
                            for b in range(a + 1):
                                information[a, b] += white[a] * white[b]
            for a in range(N_FREE):
                information[a, a] += state[h, HOLD + a] if a < 6 else shift_weight
                for b in range(a):
                    information[b, a] = information[a, b]
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
