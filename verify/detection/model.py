"""The pixels of each patch as a spot's parameters would have them, and what they say of these.

A pixel is mu + noise, rounded and clipped to 0 … 255, with mu = floor + slope · d + peak · f(t).
Its mean and variance after clipping have closed forms, and (observed - mean) / variance, led
through the mean's derivative, is the quasi-score. Weights come from the model, never from the
observed value: that would favour pixels whose noise happened to be low. A pixel deep in saturation
or below black has a mean that no parameter moves; it carries no information and needs no mask.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from verify.detection.noise import QUANTISATION
from verify.detection.profile import look_up
from verify.records import Array, Noise

X, Y, PEAK, FLOOR, SLOPE_X, SLOPE_Y, XX, XY, YY, STEEPNESS = range(10)
PARAMETERS = 10
ROWS = 12  # parameters, residuals, and one of nothing: linear algebra is much quicker by fours
SENSOR_LIMIT = 255.0  # DN
FOOT = 1.7  # half-widths; beyond, what does not fit is a neighbour and is left out
OUTLIER = 5.0  # sigma, likewise
CLIP_REACH = 4.5  # sigma from a limit within which clipping is computed
START_STEEPNESS = np.log(2.2)  # between a Gaussian (1.39) and an in-focus LED (5)
# Priors, standard deviations. All but the slopes' concern terms that are even about the centre and
# leave it alone; they only keep a dim or a fully saturated spot from drifting off.
PRIOR_STEEPNESS = 1.0
PRIOR_PEAK = 2000.0  # DN: eight times the sensor's range
PRIOR_FLOOR = 10.0  # DN: a floor below black is not seen
PRIOR_SHAPE = 2.0  # of (half-width / start)^-2


@dataclass(frozen=True, slots=True)
class Patches:
    """Pixels around candidates, as many for each, with what is known of their noise."""

    value: Array  # (n, p), DN
    valid: NDArray[np.bool_]  # (n, p), inside the image and not clipped in part
    column: Array  # (n, p), px from the cut-out's centre pixel
    row: Array  # (n, p)
    scale: Array  # (n,), px, half-width that the fit starts from
    read_share: Array  # (n,), by which combining colours changes a channel's read variance
    gain_share: Array  # (n,), likewise its shot-noise gain
    noise: Noise  # of one channel


@dataclass(frozen=True, slots=True)
class Priors:
    """Where the fit starts and how firmly each parameter is held there."""

    mean: Array  # (n, 10)
    weight: Array  # (n, 10), inverse variance

    def taken(self, which: NDArray[np.intp]) -> "Priors":
        """Those of some of the patches."""
        return Priors(self.mean[which], self.weight[which])


@dataclass(frozen=True, slots=True)
class Shape:
    """The pixels on their spots, (n, p) each."""

    u: Array  # offset from the centre, start half-widths
    w: Array
    lean_u: Array  # half the derivative of t² by u
    lean_w: Array
    radius2: Array  # t²
    value: Array  # f(t)
    slope: Array  # df / d(t²)
    change: Array  # df / d(ln steepness)


@dataclass(frozen=True, slots=True)
class Fit:
    """Parameters of each patch's spot and the state of the pixels at them."""

    parameters: Array  # (n, 10), x and y in px from the cut-out's centre pixel
    information: Array  # (n, 10, 10), inverse covariance, priors included
    gradient: Array  # (n, 10), of the quasi-likelihood
    mean: Array  # (n, p), expected pixel
    variance: Array  # (n, p), of the pixel
    signal: Array  # (n, p), DN above black, before clipping
    used: NDArray[np.bool_]  # (n, p)
    visible: Array  # (n, p), d mean / d mu: 1 in range, 0 clipped away
    shape: Shape
    chi2: Array  # (n,)
    priors: Priors

    def overwrite(self, which: NDArray[np.intp], part: "Fit") -> None:
        """Take the state of some patches, in place, from a fit of those alone."""
        for name in STATE:
            getattr(self, name)[which] = getattr(part, name)
        for name in Shape.__slots__:
            getattr(self.shape, name)[which] = getattr(part.shape, name)


STATE = [name for name in Fit.__slots__ if name not in ("shape", "priors")]  # a row a patch each


def expected(patches: Patches) -> Priors:
    """Say what is expected of each patch's spot before it is fitted."""
    n = len(patches.value)
    value, scale = patches.value, patches.scale[:, None]
    distance2 = patches.column**2 + patches.row**2
    third = value.shape[1] * 3 // 10
    floor = np.partition(value, third, axis=1)[:, third]
    core = (distance2 <= (0.5 * scale + 0.5) ** 2) & patches.valid
    top = (value * core).sum(axis=1) / np.maximum(core.sum(axis=1), 1)
    peak = np.where(top > SENSOR_LIMIT - 3, 1.3, 1.05) * np.maximum(top - floor, 1.0)
    mean = np.zeros((n, PARAMETERS))
    mean[:, PEAK], mean[:, FLOOR], mean[:, STEEPNESS] = peak, floor, START_STEEPNESS
    mean[:, XX] = mean[:, YY] = 1.0
    weight = np.zeros((n, PARAMETERS))
    weight[:, PEAK], weight[:, FLOOR] = PRIOR_PEAK**-2, PRIOR_FLOOR**-2
    weight[:, STEEPNESS], weight[:, XX : YY + 1] = PRIOR_STEEPNESS**-2, PRIOR_SHAPE**-2
    # A slope costs the centre information, so it is let in as far as the surroundings have one.
    ring = (distance2 > (2.3 * scale + 1) ** 2) & patches.valid
    # DN: a neighbour is not a slope
    excess = np.minimum(np.maximum(value - floor[:, None], -30.0), 30.0) * ring
    for parameter, axis in ((SLOPE_X, patches.column), (SLOPE_Y, patches.row)):
        slope = (excess * axis).sum(axis=1) / np.maximum((ring * axis**2).sum(axis=1), 1)
        weight[:, parameter] = 1 / (slope**2 + 1e-8)
    return Priors(mean, weight)


def evaluate(patches: Patches, parameters: Array, priors: Priors) -> Fit:
    """State of all patches at the parameters."""
    return weighed(patches, parameters, placed(patches, parameters), priors)


def placed(patches: Patches, parameters: Array) -> Shape:
    """Place the pixels on the spots that the parameters describe."""
    x, y, _, _, _, _, xx, xy, yy, _ = parameters.T[:, :, None]
    scale = patches.scale[:, None]
    u, w = (patches.column - x) / scale, (patches.row - y) / scale
    lean_u, lean_w = xx * u + xy * w, xy * u + yy * w
    radius2 = np.maximum(lean_u * u + lean_w * w, 0.0)
    return Shape(u, w, lean_u, lean_w, radius2, *look_up(radius2, parameters[:, STEEPNESS]))


def weighed(patches: Patches, parameters: Array, shape: Shape, priors: Priors) -> Fit:
    """Weigh the pixels by the patches' noise; `shape` is where they lie at the parameters."""
    _, _, peak, floor, slope_x, slope_y, *_ = parameters.T[:, :, None]
    mu = floor + slope_x * patches.column + slope_y * patches.row + peak * shape.value
    signal = np.maximum(mu - patches.noise.black, 0.0)
    read_variance = patches.read_share * patches.noise.read**2
    gain = patches.gain_share * patches.noise.gain
    noise = read_variance[:, None] + gain[:, None] * signal
    mean, variance, visible = clipped(mu, noise)
    residual = patches.value - mean
    outside = (shape.radius2 > FOOT**2) & (residual**2 > OUTLIER**2 * noise)
    used = patches.valid & ~outside

    root = np.sqrt(used / variance)
    rows = whitened(patches, parameters, shape, root * visible, root * residual)
    products = rows @ rows.transpose(0, 2, 1)
    information = products[:, :PARAMETERS, :PARAMETERS]
    np.einsum("nii->ni", information)[:] += priors.weight
    off = priors.mean - parameters
    held = priors.weight * off
    gradient = products[:, PARAMETERS, :PARAMETERS] + held
    chi2 = products[:, PARAMETERS, PARAMETERS] + (off * held).sum(axis=1)
    chi2 += OUTLIER**2 * np.count_nonzero(patches.valid & outside, axis=1)
    return Fit(
        parameters,
        information,
        gradient,
        mean,
        variance,
        signal,
        used,
        visible,
        shape,
        chi2,
        priors,
    )


def whitened(
    patches: Patches, parameters: Array, shape: Shape, weight: Array, residual: Array
) -> Array:
    """Derivatives of mu by the parameters times weights (n, p), residuals, zeros: (n, 12, p)."""
    peak = parameters[:, PEAK, None]
    rows = np.empty((len(parameters), ROWS, weight.shape[1]))
    bend = peak * weight * shape.slope
    bend_u, bend_w = bend * shape.u, bend * shape.w
    pull = bend * (-2 / patches.scale[:, None])
    np.multiply(pull, shape.lean_u, out=rows[:, X])
    np.multiply(pull, shape.lean_w, out=rows[:, Y])
    np.multiply(weight, shape.value, out=rows[:, PEAK])
    rows[:, FLOOR] = weight
    np.multiply(weight, patches.column, out=rows[:, SLOPE_X])
    np.multiply(weight, patches.row, out=rows[:, SLOPE_Y])
    np.multiply(bend_u, shape.u, out=rows[:, XX])
    np.multiply(2 * bend_u, shape.w, out=rows[:, XY])
    np.multiply(bend_w, shape.w, out=rows[:, YY])
    np.multiply(peak * weight, shape.change, out=rows[:, STEEPNESS])
    rows[:, PARAMETERS], rows[:, PARAMETERS + 1] = residual, 0.0
    return rows


def clipped(mu: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Mean, variance and d mean / d mu of a normal variable clipped to the sensor's range."""
    from_above = SENSOR_LIMIT - mu
    room = np.minimum(from_above, mu)  # the farther limit is always out of reach
    sigma = np.sqrt(noise)
    z = room / sigma
    if not np.any(z < CLIP_REACH):
        return mu, noise, np.ones_like(mu)
    inside = ndtr(z)
    density = np.exp(-0.5 * z * z) * (sigma / np.sqrt(2 * np.pi))
    excess = room * inside + density
    # E[u²] less E[u]², u the clipped room. No less than rounding: a deviation there is the
    # model's, not a miracle of the noise.
    variance = noise * inside + excess * (room - excess)
    np.maximum(variance, QUANTISATION, out=variance)
    return np.where(from_above < mu, SENSOR_LIMIT - excess, excess), variance, inside
