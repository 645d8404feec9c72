"""The smooth map from a board to one image of it: a homography and two radial terms."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from verify.records import Array

PRIOR_RADIAL = 0.3  # at half the image's width: a strongly distorting lens
PRIOR_WEIGHT = 0.5  # px: how well few corners would have to fit before they speak on the lens
STEP = 0.05  # squares, of numerical derivatives


@dataclass(frozen=True, slots=True)
class CornerMap:
    """Squares to pixels; for the surroundings of corners, not for calibration."""

    parameters: Array  # (10,), homography without its last entry, r² and r⁴ terms
    middle: Array  # (2,), px, of the image, which stands in for the lens's axis
    scale: float  # px

    def __call__(self, squares: Array) -> Array:
        """Carry points of the board (n, 2), in squares from the first corner, to pixels (n, 2)."""
        return _carry(self.parameters, squares) * self.scale + self.middle

    def jacobian(self, squares: Array) -> Array:
        """Derivative d px / d squares, (n, 2, 2), columns along the board's x and y."""
        sides = [(self(squares + e) - self(squares - e)) / (2 * STEP) for e in np.eye(2) * STEP]
        return np.stack(sides, axis=-1)

    def bend(self, squares: Array) -> Array:
        """Second derivatives along the board's x and along its y, px, (n, 2, 2) in columns."""
        here = self(squares)
        sides = [
            (self(squares + e) - 2 * here + self(squares - e)) / STEP**2 for e in np.eye(2) * STEP
        ]
        return np.stack(sides, axis=-1)


def fit_map(squares: Array, pixels: Array, shape: tuple[int, ...]) -> CornerMap | None:
    """Fit the map to corners; None where they determine no homography.

    Args:
        squares: (n, 2), at least four, not three on a line.
        pixels: (n, 2).
        shape: of the image.
    """
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    scale = max(shape[:2]) / 2
    seen = (pixels - middle) / scale
    homography, _ = cv2.findHomography(squares, seen)
    if homography is None or abs(homography[2, 2]) < 1e-9:
        return None
    start = np.append(homography.ravel()[:8] / homography[2, 2], [0.0, 0.0])

    def misses(parameters: Array) -> Array:
        prior = parameters[8:] / PRIOR_RADIAL * PRIOR_WEIGHT / scale
        return np.append((_carry(parameters, squares) - seen).ravel(), prior)

    found = least_squares(misses, start, method="lm", x_scale="jac")
    return CornerMap(np.asarray(found.x), middle, scale)


def _carry(parameters: Array, squares: Array) -> Array:
    h = np.append(parameters[:8], 1.0).reshape(3, 3)
    flat = squares @ h[:, :2].T + h[:, 2]
    xy = flat[:, :2] / flat[:, 2:]
    r2 = np.sum(xy**2, axis=1, keepdims=True)
    bent: Array = xy * (1 + r2 * (parameters[8] + r2 * parameters[9]))
    return bent
