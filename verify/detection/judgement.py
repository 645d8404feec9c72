"""What a fit says about its spot: place, covariance, size, and whether it is one clean LED."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from verify.detection.kernel import PEAK, SENSOR_LIMIT, UNTOLD, XX, XY, YY, X, Y, tally
from verify.detection.model import Fit
from verify.detection.patches import Cut
from verify.records import Array

FITTED = 8  # parameters that a spot's own pixels pay for; the slopes live on the surroundings
MISFIT = 6.0  # reduced chi² of a shape that no clean LED has
ROUGH = 0.035  # rms residual over peak, likewise; both must hold: a bright LED shows every flaw
FAINTEST = 8.0  # sigma of the peak: chance does not reach it in a picture
WANDERED = 1.5  # half-widths: a fit that left its candidate has found something else
LONGEST = 2.0  # axis ratio of the fitted profile; a blurred LED stays below, streaks do not
CHANCE = 3.0  # standard deviations of a reduced chi² that noise alone reaches
TOGETHER = 20.0  # pixels that a wrong shape lifts together, so that they do not average
BORDER = 1.2  # half-widths that must be inside the image


@dataclass(frozen=True, slots=True)
class Judgement:
    """One row a fitted candidate."""

    centre: Array  # (n, 2), px
    covariance: Array  # (n, 2, 2), px²
    peak: Array  # (n,), DN
    diameter: Array  # (n,), px
    elongation: Array  # (n,)
    misfit: Array  # (n,)
    saturated: NDArray[np.bool_]  # (n,)
    merged: NDArray[np.bool_]  # (n,)
    sound: NDArray[np.bool_]  # (n,), a spot at all: found where it was looked for, compact, whole


def judge(cut: Cut, state: Fit, shape: tuple[int, ...]) -> Judgement:
    """Judge one batch of fits; `shape` is the image's height and width."""
    patches, p = cut.patches, state.parameters
    offset = p[:, [X, Y]]
    centre = cut.origin + offset
    told = state.information + UNTOLD * np.eye(state.information.shape[1])
    covariance = np.asarray(np.linalg.inv(told)[:, :2, :2], dtype=np.float64)
    mean, split = (p[:, XX] + p[:, YY]) / 2, np.hypot((p[:, XX] - p[:, YY]) / 2, p[:, XY])
    positive = mean > split
    half_long = patches.scale / np.sqrt(np.where(positive, mean - split, 1.0))
    half_short = patches.scale / np.sqrt(np.where(positive, mean + split, 1.0))
    count, squares, square_dn, full = tally(patches.pixels, state.known).T
    freedom = count - FITTED
    # few pixels are left of a spot far over the limit, and its foot pays for the parameters
    misfit = np.where(freedom >= FITTED, squares / np.maximum(freedom, 1), 1.0)
    rough = np.sqrt(square_dn / np.maximum(freedom, 1))
    merged = (misfit > MISFIT) & (rough > ROUGH * np.minimum(p[:, PEAK], SENSOR_LIMIT))
    # A shape that the profiles lack (a stalk before the LED, a reflection beside it) leaves errors
    # larger than noise, in neighbouring pixels alike: said in the covariance too.
    excess = np.maximum(misfit - 1 - CHANCE * np.sqrt(2 / np.maximum(freedom, 1)), 0.0)
    saturated: NDArray[np.bool_] = full > 0
    excess[saturated] = 0.0  # what is left of a clipped spot is too little to judge its shape by
    inflation = np.where(merged, TOGETHER * misfit, 1 + TOGETHER * excess)
    covariance = covariance * inflation[:, None, None]
    inside = np.all(
        (centre > BORDER * half_long[:, None] - 0.5)
        & (centre < np.array(shape[1::-1]) - 0.5 - BORDER * half_long[:, None]),
        axis=1,
    )
    sound = (
        positive
        & inside
        & np.all(np.isfinite(p), axis=1)
        & (p[:, PEAK] * np.sqrt(state.information[:, PEAK, PEAK]) > FAINTEST)
        & (half_long < LONGEST * half_short)
        & (np.hypot(*offset.T) < WANDERED * patches.scale + 1)
    )
    return Judgement(
        centre=centre,
        covariance=covariance,
        peak=p[:, PEAK],
        diameter=half_long + half_short,
        elongation=half_long / half_short,
        misfit=misfit,
        saturated=saturated,
        merged=merged,
        sound=sound,
    )


def joined(parts: list[Judgement]) -> Judgement:
    """Several batches as one."""
    return Judgement(
        *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Judgement))
    )
