"""Every spot's centre at once: Gauss-Newton on a clipped-normal model of the pixels.

A pixel is mu + noise, rounded and clipped to 0 … 255, with mu = floor + slope · d + peak · f(t).
Its mean and variance after clipping have closed forms, and (observed - mean) / variance, led
through the mean's derivative, is the quasi-score. Weights come from the model, never from the
observed value: that would favour pixels whose noise happened to be low. A pixel deep in saturation
or below black has a mean that no parameter moves; it carries no information and needs no mask.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from verify.detection.noise import QUANTISATION
from verify.detection.profile import look_up
from verify.records import Array, Noise

X, Y, PEAK, FLOOR, SLOPE_X, SLOPE_Y, XX, XY, YY, STEEPNESS = range(10)
SENSOR_LIMIT = 255.0  # DN
ITERATIONS = 20  # a clean spot takes five, a saturated one ten or more
SETTLED = 0.05  # of chi² that a step may still gain: under a quarter sigma, and it is taken
STEPS = 8  # from a first look on; a clean spot takes three
STEPS_SATURATED = 20  # its top is hidden, the valley long
GLANCES = 6  # steps of a first look; what has not taken shape by then is no spot
GLANCED = 1.0  # of chi², likewise: the place is good to a sigma
FOOT = 1.7  # half-widths; beyond, what does not fit is a neighbour and is left out
OUTLIER = 5.0  # sigma, likewise
CLIP_REACH = 4.5  # sigma from a limit within which clipping is computed
START_STEEPNESS = np.log(2.2)  # between a Gaussian (1.39) and an in-focus LED (5)
STEEP_START = np.log(5.0)  # that LED: where a saturated spot's flat top is real
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
    radius2: Array  # (n, p), t²
    chi2: Array  # (n,)


def fit_spots(patches: Patches, start: Array | None = None) -> Fit:
    """Fit one spot to each patch, from the parameters of a first look where there was one.

    A saturated spot is approached from two sides, as its hidden top may be steep or flat.
    """
    prior_mean, prior_weight = priors(patches)
    begin = prior_mean if start is None else start
    parameters = solve(patches, begin, prior_mean, prior_weight, STEPS, SETTLED)
    full = np.flatnonzero(saturated(patches))
    if len(full):
        part, mean, weight = taken(patches, full), prior_mean[full], prior_weight[full]
        steep = mean.copy()
        steep[:, STEEPNESS], steep[:, PEAK] = STEEP_START, SENSOR_LIMIT - mean[:, FLOOR]
        both = [
            solve(part, top, mean, weight, STEPS_SATURATED, SETTLED)
            for top in (parameters[full], steep)
        ]
        chi2 = [evaluate(part, each, mean, weight).chi2 for each in both]
        parameters[full] = np.where((chi2[0] <= chi2[1])[:, None], both[0], both[1])
    return evaluate(patches, parameters, prior_mean, prior_weight)


def first_look(patches: Patches) -> Fit:
    """Fit with few steps: enough to see whether a spot is there, and where."""
    prior_mean, prior_weight = priors(patches)
    parameters = solve(patches, prior_mean, prior_mean, prior_weight, GLANCES, GLANCED)
    return evaluate(patches, parameters, prior_mean, prior_weight)


def taken(patches: Patches, which: NDArray[np.intp]) -> Patches:
    """Some of the patches."""
    return replace(
        patches,
        value=patches.value[which],
        valid=patches.valid[which],
        column=patches.column[which],
        row=patches.row[which],
        scale=patches.scale[which],
        read_share=patches.read_share[which],
        gain_share=patches.gain_share[which],
    )


def saturated(patches: Patches) -> NDArray[np.bool_]:
    """Whether some pixels on the spot are at the sensor's limit, (n,)."""
    near = patches.column**2 + patches.row**2 <= patches.scale[:, None] ** 2
    return np.asarray(((patches.value >= SENSOR_LIMIT) & near).any(axis=1), dtype=np.bool_)


def reweighted(patches: Patches, state: Fit) -> Fit:
    """One more step from a solution, under the noise that the patches now carry."""
    here = evaluate(patches, state.parameters, *priors(patches))
    step = solved(here.information, here.gradient)
    return replace(here, parameters=here.parameters + bounded(step, here.parameters))


def solve(
    patches: Patches,
    start: Array,
    prior_mean: Array,
    prior_weight: Array,
    steps: int,
    settled: float,
) -> Array:
    """Parameters by Gauss-Newton with Levenberg's damping; settled patches drop out."""
    result = start.copy()
    active = np.arange(len(start))
    damping = np.full(len(start), 1e-4)
    part, here = patches, normal_equations(evaluate(patches, start, prior_mean, prior_weight))
    for _ in range(steps):
        old, information, gradient, chi2 = here
        damped = information.copy()
        np.einsum("nii->ni", damped)[:] *= 1 + damping[:, None]
        step = bounded(solved(damped, gradient), old)
        trial = normal_equations(
            evaluate(part, old + step, prior_mean[active], prior_weight[active])
        )
        # The weights move with the model, so chi² may rise a little on the way to the solution.
        good = trial[3] <= 1.1 * chi2 + 1.0
        result[active[good]] = trial[0][good]
        gained = (step * gradient).sum(axis=1)  # what the step takes from chi²
        going = ~good | (gained > settled * (1 + trial[3] / part.value.shape[1]))
        if not going.any():
            break
        damping = np.where(good, damping / 10, damping * 30)
        if not good.all():
            for new, kept in zip(trial, here, strict=True):
                new[~good] = kept[~good]
        here = trial
        if 2 * np.count_nonzero(going) <= len(going):  # worth the copying
            rows = np.flatnonzero(going)
            part, active, damping = taken(part, rows), active[rows], damping[rows]
            here = tuple(each[rows] for each in here)
    return result


def normal_equations(state: Fit) -> tuple[Array, ...]:
    """What a step needs of a state: parameters, information, gradient and chi²."""
    return state.parameters, state.information, state.gradient, state.chi2


def priors(patches: Patches) -> tuple[Array, Array]:
    """Where the fit starts and how firmly each parameter is held there: (n, 10) each."""
    n = len(patches.value)
    value, scale = patches.value, patches.scale[:, None]
    distance2 = patches.column**2 + patches.row**2
    floor = np.partition(value, value.shape[1] * 3 // 10, axis=1)[:, value.shape[1] * 3 // 10]
    core = (distance2 <= (0.5 * scale + 0.5) ** 2) & patches.valid
    top = (value * core).sum(axis=1) / np.maximum(core.sum(axis=1), 1)
    peak = np.where(top > SENSOR_LIMIT - 3, 1.3, 1.05) * np.maximum(top - floor, 1.0)
    mean = np.zeros((n, 10))
    mean[:, PEAK], mean[:, FLOOR], mean[:, STEEPNESS] = peak, floor, START_STEEPNESS
    mean[:, XX] = mean[:, YY] = 1.0
    weight = np.zeros((n, 10))
    weight[:, PEAK], weight[:, FLOOR] = PRIOR_PEAK**-2, PRIOR_FLOOR**-2
    weight[:, STEEPNESS], weight[:, XX : YY + 1] = PRIOR_STEEPNESS**-2, PRIOR_SHAPE**-2
    # A slope costs the centre information, so it is let in as far as the surroundings have one.
    ring = (distance2 > (2.3 * scale + 1) ** 2) & patches.valid
    excess = np.clip(value - floor[:, None], -30, 30) * ring  # DN: a neighbour is not a slope
    for parameter, axis in ((SLOPE_X, patches.column), (SLOPE_Y, patches.row)):
        slope = (excess * axis).sum(axis=1) / np.maximum((ring * axis**2).sum(axis=1), 1)
        weight[:, parameter] = 1 / (slope**2 + 1e-8)
    return mean, weight


def solved(matrix: Array, right: Array) -> Array:
    """Solve one linear system a patch."""
    return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0], dtype=np.float64)


def bounded(step: Array, parameters: Array) -> Array:
    """Shorten a step that leaves the region in which the linearisation means anything."""
    limit = np.empty_like(step)
    limit[:, : Y + 1] = 1.5  # px
    limit[:, PEAK] = 0.7 * parameters[:, PEAK]
    limit[:, FLOOR] = 30.0  # DN
    limit[:, SLOPE_X : SLOPE_Y + 1] = 5.0  # DN a px
    least = np.minimum(parameters[:, XX], parameters[:, YY])
    limit[:, XX : YY + 1] = 0.45 * least[:, None]
    limit[:, STEEPNESS] = 0.5
    ratio = np.max(np.abs(step) / limit, axis=1)
    shortened: Array = step / np.maximum(ratio, 1.0)[:, None]
    return shortened


def evaluate(patches: Patches, parameters: Array, prior_mean: Array, prior_weight: Array) -> Fit:
    """State of all patches at the parameters."""
    p = parameters[:, :, None]
    place = placed(patches, parameters)
    radius2, profile = place[2], look_up(place[2], parameters[:, STEEPNESS])
    mu = p[:, FLOOR] + p[:, SLOPE_X] * patches.column + p[:, SLOPE_Y] * patches.row
    mu += p[:, PEAK] * profile[0]
    signal = np.maximum(mu - patches.noise.black, 0.0)
    read_variance = patches.read_share * patches.noise.read**2
    gain = patches.gain_share * patches.noise.gain
    noise = read_variance[:, None] + gain[:, None] * signal
    mean, variance, visible = clipped(mu, noise)
    residual = patches.value - mean
    outside = (radius2 > FOOT**2) & (residual**2 > OUTLIER**2 * noise)
    used = patches.valid & ~outside

    jacobian = derivatives(patches, parameters, place, profile)
    weight = used * visible / variance
    weighted = jacobian * (weight * visible)[:, None]
    information = weighted @ jacobian.transpose(0, 2, 1)
    np.einsum("nii->ni", information)[:] += prior_weight
    off = prior_mean - parameters
    gradient = (jacobian @ (weight * residual)[..., None])[..., 0] + prior_weight * off
    chi2 = np.einsum("np,np,np->n", residual, residual, used / variance)
    chi2 += np.einsum("ni,ni,ni->n", off, off, prior_weight)
    chi2 += OUTLIER**2 * np.count_nonzero(patches.valid & outside, axis=1)
    return Fit(
        parameters, information, gradient, mean, variance, signal, used, visible, radius2, chi2
    )


def placed(patches: Patches, parameters: Array) -> tuple[Array, Array, Array]:
    """Where the pixels lie on their spots: offsets in start half-widths and t², (n, p) each."""
    p, scale = parameters[:, :, None], patches.scale[:, None]
    u, w = (patches.column - p[:, X]) / scale, (patches.row - p[:, Y]) / scale
    radius2 = p[:, XX] * u * u + 2 * p[:, XY] * u * w + p[:, YY] * w * w
    return u, w, np.maximum(radius2, 0.0)


def derivatives(
    patches: Patches,
    parameters: Array,
    place: tuple[Array, Array, Array],
    profile: tuple[Array, Array, Array],
) -> Array:
    """Derivatives of mu by the parameters, (n, 10, p); `profile` is what `look_up` says there."""
    p, (u, w, _), (value, slope, change) = parameters[:, :, None], place, profile
    jacobian = np.empty((len(parameters), 10, patches.value.shape[1]))
    bend = p[:, PEAK] * slope
    pull = -2 * bend / patches.scale[:, None]
    jacobian[:, X] = pull * (p[:, XX] * u + p[:, XY] * w)
    jacobian[:, Y] = pull * (p[:, XY] * u + p[:, YY] * w)
    jacobian[:, PEAK] = value
    jacobian[:, FLOOR] = 1.0
    jacobian[:, SLOPE_X], jacobian[:, SLOPE_Y] = patches.column, patches.row
    jacobian[:, XX], jacobian[:, XY] = bend * (u * u), bend * (2 * u * w)
    jacobian[:, YY] = bend * (w * w)
    jacobian[:, STEEPNESS] = p[:, PEAK] * change
    return jacobian


def clipped(mu: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Mean, variance and d mean / d mu of a normal variable clipped to the sensor's range."""
    high = mu > SENSOR_LIMIT / 2
    room = np.where(high, SENSOR_LIMIT - mu, mu)  # the farther limit is always out of reach
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
    return np.where(high, SENSOR_LIMIT - excess, excess), variance, inside
