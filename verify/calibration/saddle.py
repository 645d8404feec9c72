"""A corner's place as the crossing of two blurred edges, by least squares on its pixels.

What the picture of a corner is stands in corner_model.py, which pixels speak for it in
corner_window.py. All pixels weigh the same: on the recorded boards weights by a usual shot noise
gained a hundredth of the error, weights from a noise line through the picture's own dark and bright
squares lost two. How large the noise is, and how far it ties neighbouring pixels together, is seen
in the residuals of all corners of a view.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.calibration.corner_model import (
    BLUR,
    CONTRAST,
    PARAMETERS,
    SPREAD,
    X,
    Y,
    model,
    start_values,
)
from verify.calibration.corner_window import (
    CELLS,
    HALF_WINDOW,
    Edges,
    Place,
    Window,
    edges_at,
    window_at,
)
from verify.records import Array

START_BLUR = 0.06  # squares: wide enough to draw in a start that is some pixels off
BLUREST = 4.0  # either way, of the log of a blur in px
ITERATIONS = 25  # a good start takes three
SETTLED = 1e-3  # px; the step after it is below 1e-5
STRAY = 0.5  # of the contrast: what differs more is no part of the corner (a border, dirt)
UNEVEN = 0.5  # px that an edge's pixels may be off: sharpening and saturation deform it
OUTLIER = 5.0  # sigma, and more than that
MAD = 0.67449  # median of |x| over sigma, Gaussian
CLEARINGS = 2  # the first fit was led astray by what it leaves out
OWN = 0.6  # of the pixels that must belong to the corner
LEAST_PIXELS = 40  # three a parameter


@dataclass(frozen=True, slots=True)
class Fit:
    """The model fitted to a window's pixels."""

    parameters: Array  # (13,), see corner_model.py
    residual: Array  # (p,), DN, pixels less model
    derivatives: Array  # (p, 13), of the model by the parameters


@dataclass(frozen=True, slots=True)
class Corner:
    """A fitted corner."""

    parameters: Array  # (13,), see corner_model.py
    centre: Array  # (2,), px
    covariance: Array  # (2, 2), px², if its residuals were independent from pixel to pixel
    variance: float  # DN², of the residuals
    scatter: tuple[float, float]  # of the centre's scores from cell to cell: found, expected


def fit_corner(grey: Array, place: Place, parameters: Array | None = None) -> Corner | None:
    """Measure one corner.

    Args:
        grey: (h, w), DN.
        place: where it is expected, to a tenth of a square.
        parameters: of an earlier fit, whose centre is the expected one.

    Returns:
        None where there is no crossing: too few pixels, no convergence, or a place outside the
        window.
    """
    window, edges = window_at(grey, place), edges_at(place)
    if len(window.x) < LEAST_PIXELS:
        return None
    if parameters is None:
        parameters = start_values(window, edges, START_BLUR * edges.scale)
    else:
        parameters = np.append([0.0, 0.0], parameters[2:])
    found = converge(window, edges, parameters)
    for _ in range(CLEARINGS):
        if found is None:
            return None
        own = window.far_from(strays(found))
        if np.count_nonzero(own) < max(LEAST_PIXELS, OWN * len(own)):
            return None  # most of it is something else
        if own.all():
            break
        window = window.only(own)
        found = converge(window, edges, found.parameters)
    if found is None:
        return None
    squares_off = np.linalg.solve(place.jacobian, found.parameters[:2])
    return None if np.abs(squares_off).max() > HALF_WINDOW / 2 else judged(window, found, place)


def strays(found: Fit) -> NDArray[np.bool_]:
    """Which pixels (p,) are no part of the corner that was fitted."""
    residual = np.abs(found.residual)
    sigma = float(np.median(residual)) / MAD
    usual = max(STRAY * abs(found.parameters[CONTRAST]), OUTLIER * sigma)
    return np.asarray(residual > usual + UNEVEN * np.abs(found.derivatives[:, SPREAD]))


def converge(window: Window, edges: Edges, start: Array) -> Fit | None:
    """Find the parameters by Gauss-Newton with Levenberg's damping; None: it does not settle."""
    parameters, damping = start, 1e-3
    mean, derivatives = model(window, edges, parameters)
    residual = window.value - mean
    for _ in range(ITERATIONS):
        normal = derivatives.T @ derivatives
        normal[np.diag_indices(PARAMETERS)] *= 1 + damping
        try:
            step = np.linalg.solve(normal, derivatives.T @ residual)
        except np.linalg.LinAlgError:
            return None
        trial = parameters + step
        if sane(trial, edges):
            mean, slopes = model(window, edges, trial)
            left = window.value - mean
            better = np.sum(left**2) <= residual @ residual
            if better:
                parameters, residual, derivatives = trial, left, slopes
            if np.abs(step[:2]).max() < SETTLED and damping < 1:
                return Fit(parameters, residual, derivatives)
            damping = damping / 10 if better else damping * 30
        else:
            damping *= 30
    return None


def sane(parameters: Array, edges: Edges) -> bool:
    """Whether a fit is still at the corner it started at, with a blur that lenses have."""
    near = np.abs(parameters[[X, Y, SPREAD]]).max() < edges.scale
    return bool(near and np.abs(parameters[BLUR]).max() < BLUREST)


def judged(window: Window, found: Fit, place: Place) -> Corner | None:
    """Covariance of the centre, and how its scores scatter over the window.

    Were residuals independent, the sum over cells of the centre's squared scores would be what
    the information says, less what the fit took. JPEG, demosaicing and sharpening tie neighbours
    together: then it is more. A cell and its mirror image about the corner count as one, so what
    is even about the corner (the blur's true shape, gamma), which moves the centre nowhere,
    cancels. (Sandwich estimator with clusters; Liang and Zeger, Biometrika 73, 1986, with the
    expectation of the meat taken exactly.)
    """
    parameters, residual, derivatives = found.parameters, found.residual, found.derivatives
    try:
        inverse = np.linalg.inv(derivatives.T @ derivatives)
    except np.linalg.LinAlgError:
        return None
    influence = derivatives @ inverse[:, :2]  # (p, 2): d centre / d pixel
    cells = (np.arange(CELLS * CELLS // 2 + 1)[:, None] == window.cell).astype(float)
    scores = cells @ (influence * residual[:, None])
    taken = np.stack([cells @ (influence[:, k, None] * derivatives) for k in range(2)])
    variance = float(residual @ residual) / (len(residual) - PARAMETERS)
    # in units of the centre's variance, so that all corners of a view speak alike
    unit = float(inverse[0, 0] + inverse[1, 1])
    spent = float(np.einsum("kcp,pq,kcq->", taken, inverse, taken))
    return Corner(
        parameters=parameters,
        centre=place.centre + parameters[:2],
        covariance=np.asarray(variance * inverse[:2, :2], dtype=float),
        variance=variance,
        scatter=(float(np.sum(scores**2)) / (unit * variance), 1 - spent / unit),
    )
