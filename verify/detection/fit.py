"""Every spot's centre at once: Gauss-Newton on a clipped-normal model of the pixels (model.py)."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from verify.detection.model import (
    FLOOR,
    PEAK,
    SENSOR_LIMIT,
    SLOPE_X,
    SLOPE_Y,
    STEEPNESS,
    XX,
    YY,
    Fit,
    Patches,
    Priors,
    Y,
    evaluate,
    expected,
    weighed,
)
from verify.records import Array

SETTLED = 0.05  # of chi² that a step may still gain: under a quarter sigma, and it is taken
STEPS = 8  # from a first look on; a clean spot takes three
STEPS_SATURATED = 20  # its top is hidden, the valley long
GLANCES = 6  # steps of a first look; what has not taken shape by then is no spot
GLANCED = 1.0  # of chi², likewise: the place is good to a sigma
STEEP_START = np.log(5.0)  # an in-focus LED: where a saturated spot's flat top is real


def fit_spots(patches: Patches, start: Array | None = None) -> Fit:
    """Fit one spot to each patch, from the parameters of a first look where there was one.

    A saturated spot is approached from two sides, as its hidden top may be steep or flat.
    """
    priors = expected(patches)
    fit = solve(patches, priors.mean if start is None else start, priors, STEPS, SETTLED)
    full = np.flatnonzero(saturated(patches))
    if not len(full):
        return fit
    part, held, parameters = taken(patches, full), priors.taken(full), fit.parameters.copy()
    steep = held.mean.copy()
    steep[:, STEEPNESS], steep[:, PEAK] = STEEP_START, SENSOR_LIMIT - steep[:, FLOOR]
    one, other = (
        solve(part, top, held, STEPS_SATURATED, SETTLED) for top in (parameters[full], steep)
    )
    first = (one.chi2 <= other.chi2)[:, None]
    parameters[full] = np.where(first, one.parameters, other.parameters)
    return evaluate(patches, parameters, priors)


def first_look(patches: Patches) -> Fit:
    """Fit with few steps: enough to see whether a spot is there, and where."""
    priors = expected(patches)
    return solve(patches, priors.mean, priors, GLANCES, GLANCED)


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
    here = weighed(patches, state.parameters, state.shape, state.priors)
    step = solved(here.information, here.gradient)
    return replace(here, parameters=here.parameters + bounded(step, here.parameters))


def solve(patches: Patches, start: Array, priors: Priors, steps: int, settled: float) -> Fit:
    """Fit by Gauss-Newton with Levenberg's damping; settled patches drop out."""
    result = start.copy()
    active = np.arange(len(start))
    damping = np.full(len(start), 1e-4)
    part, held = patches, priors
    begun = evaluate(patches, start, priors)
    here = normal_equations(begun)
    state: Fit | None = begun  # at the result, as long as it is known there
    for _ in range(steps):
        old, information, gradient, chi2 = here
        damped = information.copy()
        np.einsum("nii->ni", damped)[:] *= 1 + damping[:, None]
        step = bounded(solved(damped, gradient), old)
        tried = evaluate(part, old + step, held)
        trial = normal_equations(tried)
        # The weights move with the model, so chi² may rise a little on the way to the solution.
        good = trial[3] <= 1.1 * chi2 + 1.0
        if not good.all():
            state = None
        elif len(active) == len(start):
            state = tried
        elif state is not None:
            state.overwrite(active, tried)
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
            part, held, active = taken(part, rows), held.taken(rows), active[rows]
            damping, here = damping[rows], tuple(each[rows] for each in here)
    return evaluate(patches, result, priors) if state is None else state


def normal_equations(state: Fit) -> tuple[Array, ...]:
    """What a step needs of a state: parameters, information, gradient and chi²."""
    return state.parameters, state.information, state.gradient, state.chi2


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
