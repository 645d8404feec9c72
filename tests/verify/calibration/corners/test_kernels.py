"""The compiled corner: its picture against scipy's normal law, its derivatives by differences."""

import numpy as np
import pytest
from scipy.special import ndtr

from tests.support.kernels import (
    COL_COLUMN,
    COL_ROW,
    COL_VALUE,
    EDGE_SCALE,
    N_EDGE_VALUES,
    fill_edges,
    predict_pixels,
    window_pixels,
)
from verify.calibration.corners.find import N_PARAMETERS
from verify.core.records import Array

ROW_RESIDUAL = N_PARAMETERS  # the row behind the derivatives
N_ROWS = N_PARAMETERS + 1
JACOBIAN = np.array([[38.0, 6.0], [-9.0, 33.0]])  # px / square
BEND = np.array([[0.8, -0.5], [0.3, 1.1]])  # px / square²
CENTRE = np.array([61.3, 47.8])
NO_MARKERS = (0.0, 0.0)
MADE = np.array(
    [0.31, -0.22, 0.02, -0.03, np.log(1.1), np.log(0.8), 0.07, 112.0, 3.0, -4.0, 71.0, 5.0, 2.0]
)


def setting() -> tuple[Array, Array, Array]:
    """Pixels, edges, and parameters with the edges' directions."""
    grey = np.random.default_rng(1).integers(0, 256, (100, 130), dtype=np.uint8)
    pixels, edges = window_pixels(grey, CENTRE, JACOBIAN, NO_MARKERS), np.empty(N_EDGE_VALUES)
    fill_edges(JACOBIAN, BEND, edges)
    parameters = MADE.copy()
    parameters[2:4] += edges[:2]
    return pixels, edges, parameters


def rows_at(pixels: Array, edges: Array, parameters: Array) -> Array:
    rows = np.empty((N_ROWS, pixels.shape[1]))
    predict_pixels(pixels, edges, parameters, rows)
    return rows


def picture(pixels: Array, edges: Array, parameters: Array) -> Array:
    """The formula at the head of corner_kernel_model.py, by scipy."""
    x, y = pixels[COL_COLUMN], pixels[COL_ROW]
    above, below = [], []
    for turn, log_blur, bend in zip(parameters[2:4], parameters[4:6], edges[2:4], strict=True):
        normal = np.array([np.cos(turn), np.sin(turn)])
        off = np.stack([x - parameters[0], y - parameters[1]], axis=1)
        along = off @ [-normal[1], normal[0]]
        distance = off @ normal - bend * along**2 / 2
        above.append(ndtr((distance - parameters[6]) / np.exp(log_blur)))
        below.append(ndtr((-distance - parameters[6]) / np.exp(log_blur)))
    cross = 1 - 2 * above[0] * below[1] - 2 * below[0] * above[1]
    linear = np.stack([np.ones(len(x)), x / edges[EDGE_SCALE], y / edges[EDGE_SCALE]])
    shown: Array = parameters[7:10] @ linear + (parameters[10:] @ linear) * cross
    return shown


def test_a_corner_s_picture_is_scipy_s() -> None:
    pixels, edges, parameters = setting()
    assert pixels.shape[1] > 800
    expected = picture(pixels, edges, parameters)
    residual = rows_at(pixels, edges, parameters)[ROW_RESIDUAL]
    np.testing.assert_allclose(pixels[COL_VALUE] - residual, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("parameter", range(N_PARAMETERS))
def test_its_derivatives_are_differences_of_the_picture(parameter: int) -> None:
    pixels, edges, parameters = setting()
    step = 1e-5 * np.eye(N_PARAMETERS)[parameter]
    ends = [picture(pixels, edges, parameters + sign * step) for sign in (1, -1)]
    expected = (ends[0] - ends[1]) / 2e-5
    found = rows_at(pixels, edges, parameters)[parameter]
    # DN a unit: rounding of 1e-13 DN over the step, and its square times the third derivative
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * max(1, np.abs(expected).max()))


@pytest.mark.parametrize("place", [(-500.0, 20.0), (np.nan, 20.0), (np.inf, -np.inf), (1e30, 0.0)])
def test_a_corner_that_is_nowhere_in_the_picture_has_no_pixels(place: tuple[float, float]) -> None:
    found = window_pixels(
        np.zeros((100, 130), dtype=np.uint8), np.array(place), JACOBIAN, NO_MARKERS
    )
    assert found.shape == (4, 0)
