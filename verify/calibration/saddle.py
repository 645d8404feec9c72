"""A corner's place as the crossing of two blurred edges, by least squares on its pixels.

What the picture of a corner is stands in corner_kernel_model.py, which pixels speak for it in
corner_kernel_window.py, the fit in corner_kernel.py. All pixels weigh the same: on the recorded
boards weights by a usual shot noise gained a hundredth of the error, weights from a noise line
through the picture's own dark and bright squares lost two. How large the noise is, and how far it
ties neighbouring pixels together, is seen in the residuals of all corners of a view.
"""

from dataclasses import dataclass

import numpy as np

from verify.calibration.corner_kernel import EXPECTED, FOUND, TOLD, VARIANCE, XX, XY, YY, fit
from verify.calibration.corner_kernel_model import PARAMETERS, STEPS, X, Y
from verify.records import Array


@dataclass(frozen=True, slots=True)
class Place:
    """Where a corner is expected, and the board's plane about it."""

    centre: Array  # (2,), px
    jacobian: Array  # (2, 2), d px / d squares, columns along the board's x and y
    bend: Array  # (2, 2), d² px / d squares², columns likewise
    markers: tuple[float, int] | None = None  # squares between a marker and its square's edge;
    # sign of u · v (from the corner, board's axes) where the white squares are


@dataclass(frozen=True, slots=True)
class Corner:
    """A fitted corner."""

    parameters: Array  # (13,), see corner_kernel_model.py
    centre: Array  # (2,), px
    covariance: Array  # (2, 2), px², if its residuals were independent from pixel to pixel
    variance: float  # DN², of the residuals
    scatter: tuple[float, float]  # of the centre's scores from cell to cell: found, expected


def fit_corner(grey: Array, place: Place, parameters: Array | None = None) -> Corner | None:
    """Measure one corner; other threads run meanwhile.

    Args:
        grey: (h, w), DN.
        place: where it is expected, to a tenth of a square.
        parameters: of an earlier fit, whose centre is the expected one.

    Returns:
        None where there is no crossing: too few pixels, no convergence, or a place outside the
        window.
    """
    found = np.zeros(PARAMETERS) if parameters is None else parameters.copy()
    told = np.empty(TOLD)
    at = (place.centre, place.jacobian, place.bend)
    margin, white = place.markers or (0.0, 0)
    if not fit(grey, at, (float(margin), float(white)), parameters is not None, STEPS, found, told):
        return None
    variance = float(told[VARIANCE])
    return Corner(
        parameters=found,
        centre=place.centre + found[[X, Y]],
        covariance=variance * told[[[XX, XY], [XY, YY]]],
        variance=variance,
        scatter=(float(told[FOUND]), float(told[EXPECTED])),
    )
