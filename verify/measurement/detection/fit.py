"""Fit centre and shape of LED spots to their pixels by Gauss-Newton, many spots at once.

Model of the pixel at column c and row r, px from the patch's centre pixel:

    value = clip(round(mu + noise), 0, 255),   noise ~ N(0, read² + gain (mu - black))
    mu    = floor + slope_x c + slope_y r + peak f(t; e^s)
    t²    = xx u² + 2 xy u w + yy w²,   u = (c - x) / scale,   w = (r - y) / scale

f is the radial profile of profile.py: f(0) = 1, f(1) = 1/2. `scale` is the half-width, px, that the
fit starts from. Parameter vector, one row a spot:

    index  name         meaning                                      unit
    0, 1   x, y         centre                                       px from the centre pixel
    2      peak         height of the profile                        DN
    3      floor        background at the centre pixel               DN
    4, 5   slope_x, _y  slope of the background                      DN/px
    6-8    xx, xy, yy   inverse square of the half-width ellipse     scale^-2
    9      s            ln of the steepness -d ln f / d ln t at t=1  1

Mean and variance of a clipped pixel have closed forms; (observed - mean) / variance times the
derivative of the mean is the quasi-score. Weights come from the model, not from the observed value,
which would favour pixels whose noise happened to be low. A pixel deep in saturation or below black
has a mean that no parameter changes: it carries no information and needs no mask.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Noise, take_rows
from verify.measurement.detection.kernels import fit as kernels_fit
from verify.measurement.detection.kernels import pixels as kernels_pixels
from verify.measurement.detection.kernels.pixels import (
    N_PARAMETERS,
    PAR_FLOOR,
    PAR_PEAK,
    PAR_STEEPNESS,
    PAR_XX,
    PAR_YY,
    SENSOR_LIMIT,
)
from verify.measurement.detection.profile import profile_table

START_STEEPNESS = np.log(2.2)  # between a Gaussian (1.39) and an in-focus LED (5)
# Priors, standard deviations. All but the slopes' concern terms that are even about the centre and
# leave it alone; they only keep a dim or a fully saturated spot from drifting off.
PRIOR_STEEPNESS = 1.0
PRIOR_PEAK = 2000.0  # DN: eight times the sensor's range
PRIOR_FLOOR = 10.0  # DN: a floor below black does not show
PRIOR_SHAPE = 2.0  # of (half-width / start)^-2


def _default_prior() -> tuple[Array, Array]:
    """Mean and inverse variance of what every spot is expected to have, (10,) each."""
    mean, weight = np.zeros(N_PARAMETERS), np.zeros(N_PARAMETERS)
    mean[PAR_STEEPNESS], mean[PAR_XX], mean[PAR_YY] = START_STEEPNESS, 1.0, 1.0
    weight[PAR_PEAK], weight[PAR_FLOOR] = PRIOR_PEAK**-2, PRIOR_FLOOR**-2
    weight[PAR_STEEPNESS], weight[PAR_XX : PAR_YY + 1] = PRIOR_STEEPNESS**-2, PRIOR_SHAPE**-2
    return mean, weight


DEFAULT_PRIOR = _default_prior()


@dataclass(frozen=True, slots=True)
class Patches:
    """Pixels around candidates, as many for each, with their noise."""

    # (n, 4, p): value, DN; 1 where inside the image and not clipped in part; column and row, px
    # from the cut-out's centre pixel
    pixels: Array
    scale: Array  # (n,), px, half-width that the fit starts from
    read_share: Array  # (n,), by which combining colours changes a channel's read variance
    gain_share: Array  # (n,), the same for its shot-noise gain
    noise: Noise  # of one channel

    @property
    def value(self) -> Array:
        """DN, (n, p)."""
        return self.pixels[:, 0]


@dataclass(frozen=True, slots=True)
class Priors:
    """How firmly each parameter is held, and where; and where the fit starts."""

    mean: Array  # (n, 10)
    weight: Array  # (n, 10), inverse variance
    start: Array  # (n, 10), as the pixels suggest
    saturated: NDArray[np.bool_]  # (n,), whether some pixels on the spot are at the sensor's limit


@dataclass(frozen=True, slots=True)
class SpotFit:
    """Parameters of each patch's spot and the state of the pixels at them."""

    parameters: Array  # (n, 10), x and y in px from the cut-out's centre pixel
    information: Array  # (n, 10, 10), inverse covariance, priors included
    gradient: Array  # (n, 10), of the quasi-likelihood
    model: Array  # (n, 10, p), of the pixels before the last small step, but for their means
    whitened: Array  # (n, 11, p), derivatives of mu by the parameters and residuals, over sigma
    chi2: Array  # (n,)
    priors: Priors

    def put(
        self, which: NDArray[np.intp], other: "SpotFit", whose: NDArray[np.intp] | None = None
    ) -> None:
        """Put another fit's patches, all or some, in the place of these; priors stay."""
        for mine, theirs in zip(self.state, other.state, strict=True):
            mine[which] = theirs if whose is None else theirs[whose]

    @property
    def state(self) -> tuple[Array, ...]:
        """All that a fit changes."""
        return (
            self.parameters, self.information, self.gradient, self.model, self.whitened, self.chi2
        )  # fmt: skip


def expected_priors(patches: Patches) -> Priors:
    """Set the priors and the start of each patch's spot from its pixels."""
    arguments = patches.pixels, patches.scale, patches.noise.read, DEFAULT_PRIOR
    return Priors(*kernels_fit.priors_from_pixels(*arguments))


def solve_patches(
    patches: Patches, start: Array, priors: Priors, steps: int = 0, settled: float = 0.0
) -> SpotFit:
    """Fit every patch by Gauss-Newton, from `start` (n, 10), held by the priors.

    `steps`: at most; 0 evaluates the pixels at the start. `settled`: of chi² that a step may still
    gain.
    """
    n, _, size = patches.pixels.shape
    fit = SpotFit(
        parameters=start.copy(),
        information=np.empty((n, N_PARAMETERS, N_PARAMETERS)),
        gradient=np.empty((n, N_PARAMETERS)),
        model=np.empty((n, kernels_pixels.N_ROWS, size)),
        whitened=np.empty((n, kernels_pixels.ROW_WHITENED, size)),
        chi2=np.empty(n),
        priors=priors,
    )
    continue_fit(patches, fit, patches.noise, steps, settled)
    return fit


def continue_fit(
    patches: Patches, fit: SpotFit, noise: Noise, steps: int, settled: float = 0.0
) -> None:
    """Continue a fit in place under that noise of a channel; other arguments as `solve_patches`."""
    kernels_fit.fit_patches(
        fit.parameters, patches.pixels, patches.scale, (patches.read_share, patches.gain_share),
        (noise.read**2, noise.gain, noise.black), profile_table(),
        (fit.priors.mean, fit.priors.weight), (steps, settled),
        (fit.model, fit.whitened, fit.information, fit.gradient, fit.chi2),
    )  # fmt: skip


TOL_LAST_STEP = 10.0  # of chi² that the last step may gain: it is taken, and nothing looked at anew
MAX_STEPS = 8  # from a first look on; a clean spot takes two
MAX_STEPS_SATURATED = 20  # its top is hidden, the valley long
TOL_SATURATED = 0.001  # of chi², for saturated spots: a step may gain little and the next more
MAX_STEPS_FIRST_LOOK = 6  # steps of a first look; what has not taken shape by then is no spot
TOL_FIRST_LOOK = 1.0  # of chi² in a first look: the place is good to a sigma
START_STEEPNESS_SATURATED = np.log(5.0)  # an in-focus LED, whose flat top is real


def fit_spots(patches: Patches, start: Array | None = None) -> SpotFit:
    """Fit one spot to each patch, from `start` (n, 10) where a first look gave one.

    A clear spot comes within a step of its optimum: `detect` continues once it knows the noise. A
    saturated spot is fitted from two starts, as its hidden top may be steep or flat.
    """
    priors = expected_priors(patches)
    fit = solve_patches(
        patches, priors.start if start is None else start, priors, MAX_STEPS, TOL_LAST_STEP
    )
    full = np.flatnonzero(priors.saturated)
    if not len(full):
        return fit
    part, held, flat = take_rows(patches, full), take_rows(priors, full), fit.parameters[full]
    steep = held.mean.copy()
    steep[:, PAR_STEEPNESS] = START_STEEPNESS_SATURATED
    steep[:, PAR_PEAK] = SENSOR_LIMIT - steep[:, PAR_FLOOR]
    fit.put(full, solve_patches(part, flat, held, MAX_STEPS_SATURATED, TOL_SATURATED))
    other = solve_patches(part, steep, held, MAX_STEPS_SATURATED, TOL_SATURATED)
    better = np.flatnonzero(~(fit.chi2[full] <= other.chi2))
    fit.put(full[better], other, better)
    return fit


def first_look(patches: Patches) -> SpotFit:
    """Fit with few steps: enough to see whether a spot is there, and where."""
    priors = expected_priors(patches)
    return solve_patches(patches, priors.start, priors, MAX_STEPS_FIRST_LOOK, TOL_FIRST_LOOK)
