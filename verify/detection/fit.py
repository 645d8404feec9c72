"""Every spot's centre at once: Gauss-Newton on a clipped-normal model of the pixels (model.py)."""

import numpy as np

from verify.detection.kernel_clip import SENSOR_LIMIT
from verify.detection.kernel_pixels import FLOOR, PEAK, STEEPNESS
from verify.detection.model import Fit, Patches, expected, solve
from verify.records import Array

NEARLY = 10.0  # of chi² that the last step may gain: it is taken, and nothing looked at anew
STEPS = 8  # from a first look on; a clean spot takes two
STEPS_SATURATED = 20  # its top is hidden, the valley long
SETTLED_SATURATED = 0.001  # likewise: a step may gain little and the next one more
GLANCES = 6  # steps of a first look; what has not taken shape by then is no spot
GLANCED = 1.0  # of chi², likewise: the place is good to a sigma
STEEP_START = np.log(5.0)  # an in-focus LED: where a saturated spot's flat top is real


def fit_spots(patches: Patches, start: Array | None = None) -> Fit:
    """Fit one spot to each patch, from the parameters of a first look where there was one.

    What is clear comes within a step of its place: `detect` goes on once it knows the noise. A
    saturated spot is approached from two sides, as its hidden top may be steep or flat.
    """
    priors = expected(patches)
    fit = solve(patches, priors.start if start is None else start, priors, STEPS, NEARLY)
    full = np.flatnonzero(priors.saturated)
    if not len(full):
        return fit
    part, held, flat = patches.taken(full), priors.taken(full), fit.parameters[full]
    steep = held.mean.copy()
    steep[:, STEEPNESS], steep[:, PEAK] = STEEP_START, SENSOR_LIMIT - steep[:, FLOOR]
    fit.put(full, solve(part, flat, held, STEPS_SATURATED, SETTLED_SATURATED))
    other = solve(part, steep, held, STEPS_SATURATED, SETTLED_SATURATED)
    better = np.flatnonzero(~(fit.chi2[full] <= other.chi2))
    fit.put(full[better], other, better)
    return fit


def first_look(patches: Patches) -> Fit:
    """Fit with few steps: enough to see whether a spot is there, and where."""
    priors = expected(patches)
    return solve(patches, priors.start, priors, GLANCES, GLANCED)
