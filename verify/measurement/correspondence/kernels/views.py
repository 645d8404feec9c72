"""Bring the spots of one image into ideal coordinates, with noise, and say which LED each may be.

A spot's ideal pixel is its own, the lens undone by Newton's method, from the principal point. It
may be an LED unless their colours clearly differ.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.records import Array

Flags = NDArray[np.bool_]
# centres (m, 2) px, covariance (m, 2, 2) px², merged (m,), saturated (m,) and colour (m, 3)
ImageSpots = tuple[Array, Array, Flags, Flags, Array]

BLUE, GREEN, RED = 0, 1, 2  # channels of a colour, and LEDs that shine in them
WHITE, ANY = 3, 4  # LEDs without a hue, and those that may have any
# (largest - second) / largest channel: warm white stays under 0.2, LEDs above 0.4
MIN_HUE_CONTRAST = 0.3
MAX_STEPS = 30  # quadratic convergence: three or four suffice for any sane lens
TOL_STEP = 1e-9  # the next step would be about the square of this one: below rounding


@compiled
def undistort(x: float, y: float, lens: Array) -> tuple[float, float]:
    """Invert OpenCV's distortion k1, k2, p1, p2, k3 (5,) by Newton's method, as `rig.undistort`."""
    k1, k2, p1, p2, k3 = lens[0], lens[1], lens[2], lens[3], lens[4]
    a, b = x, y
    for _ in range(MAX_STEPS):
        r2 = a * a + b * b
        higher = r2 * k3 + k2
        slope = 2.0 * (k1 + r2 * (higher + higher + r2 * k3))  # d radial / d r2, times 2
        straight = 1.0 + r2 * (k1 + r2 * higher) + 2.0 * (p1 * b + p2 * a)
        off_x, off_y = a * straight + p2 * r2 - x, b * straight + p1 * r2 - y
        xx = straight + a * a * slope + 4.0 * p2 * a
        xy = a * b * slope + 2.0 * (p1 * a + p2 * b)
        yy = straight + b * b * slope + 4.0 * p1 * b
        determinant = xx * yy - xy * xy
        step_x = (off_x * yy - off_y * xy) / determinant
        step_y = (off_y * xx - off_x * xy) / determinant
        a, b = a - step_x, b - step_y
        if not (abs(step_x) > TOL_STEP or abs(step_y) > TOL_STEP):
            break
    return a, b


@compiled
def prepare_images(
    spots: tuple[ImageSpots, ImageSpots],
    optics: tuple[Array, Array],
    model: tuple[float, float, float],
    light: NDArray[np.int64],
    most: int,
) -> tuple[Array, Array, Flags, Flags]:
    """Prepare both images' spots, the first s of them, or fewer where there are no more.

    `optics`: camera matrices (2, 3, 3), px, and lenses (2, 5); `model`: px², variance beside the
    noise, that of a merged spot and of the right image's in addition; `light` (n,), of each LED:
    BLUE to ANY; `most`: s. Gives what `prepare_image` fills, for the left and the right one.
    """
    pixels, covariance = np.empty((2, most, 2)), np.empty((2, most, 2, 2))
    merged, allowed = np.empty((2, most), np.bool_), np.empty((2, len(light), most), np.bool_)
    for side in range(2):
        prepare_image(
            spots[side], (optics[0][side], optics[1][side]), (model[0] + side * model[2], model[1]),
            light, pixels[side], covariance[side], merged[side], allowed[side],
        )  # fmt: skip
    return pixels, covariance, merged, allowed


@compiled
def prepare_image(
    spots: ImageSpots,
    camera: tuple[Array, Array],
    model: tuple[float, float],
    light: NDArray[np.int64],
    pixels: Array,
    covariance: Array,
    merged: Flags,
    allowed: Flags,
) -> None:
    """Fill in one image's spots, the first s of them, or fewer where there are no more.

    `camera`: matrix (3, 3), px, and lens (5,). `model`: px², variance beside the noise, and
    that of a merged spot in addition. `light` (n,), of each LED: BLUE to ANY. Filled: `pixels`
    (s, 2), ideal px, NaN where there is no spot; `covariance` (s, 2, 2), px²; `merged` (s,);
    `allowed` (n, s): this spot may be that LED.

    Only clear contradictions count. A spot with no clear hue may be white, infrared (cameras show
    it whitish or violet) or, where saturated, any overexposed LED; in a grey image every spot may
    be any LED.
    """
    centre, noise, dragged, saturated, colour = spots
    matrix, lens = camera
    grey = True
    for spot in colour:
        grey = grey and spot[0] == spot[1] and spot[1] == spot[2]
    for k in range(len(pixels)):
        exists = k < len(centre)
        merged[k] = exists and dragged[k]
        for led in range(len(light)):
            allowed[led, k] = exists
        if not exists:
            pixels[k, 0] = pixels[k, 1] = math.nan
            covariance[k, 0, 0] = covariance[k, 1, 1] = 1.0
            covariance[k, 0, 1] = covariance[k, 1, 0] = 0.0
            continue
        y = (centre[k, 1] - matrix[1, 2]) / matrix[1, 1]
        x = (centre[k, 0] - matrix[0, 2] - matrix[0, 1] * y) / matrix[0, 0]
        x, y = undistort(x, y, lens)
        pixels[k, 0], pixels[k, 1] = x * matrix[0, 0], y * matrix[1, 1]
        beside = model[0] + model[1] * merged[k]
        covariance[k, 0, 0], covariance[k, 1, 1] = noise[k, 0, 0] + beside, noise[k, 1, 1] + beside
        covariance[k, 0, 1], covariance[k, 1, 0] = noise[k, 0, 1], noise[k, 1, 0]
        if not grey:
            most, second = 0, -math.inf
            for channel in range(1, 3):
                if colour[k, channel] > colour[k, most]:
                    most, second = channel, colour[k, most]
                else:
                    second = max(second, colour[k, channel])
            clear = colour[k, most] - second > MIN_HUE_CONTRAST * abs(colour[k, most])
            hue = most if clear else WHITE
            any_hue = saturated[k] and hue == WHITE
            for led in range(len(light)):
                allowed[led, k] = light[led] in (ANY, hue) or any_hue
