"""What a fit says about its spot: place, covariance, size, and whether it is one clean LED."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from verify.detection import kernel_judgement as kernel
from verify.detection.kernel_pixels import PEAK
from verify.detection.model import Fit
from verify.detection.patches import Cut
from verify.records import Array

# parameters that a spot's own pixels pay for; the slopes live on the surroundings. With few pixels
# left, of a spot far over the limit, its foot pays for them
FITTED = 8
MISFIT = 6.0  # reduced chi² of a shape that no clean LED has
ROUGH = 0.035  # rms residual over peak, likewise; both must hold: a bright LED shows every flaw
FAINTEST = 8.0  # sigma of the peak: chance does not reach it in a picture
WANDERED = 1.5  # half-widths: a fit that left its candidate has found something else
LONGEST = 2.0  # axis ratio of the fitted profile; a blurred LED stays below, streaks do not
# A shape that the profiles lack (a stalk before the LED, a reflection beside it) leaves errors
# larger than noise, in neighbouring pixels alike: said in the covariance too. What is left of a
# clipped spot is too little to judge its shape by.
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
    told = np.empty((len(p), kernel.TOLD))
    kernel.tell_all(
        p,
        state.information,
        patches.pixels,
        state.known,
        patches.scale,
        cut.origin,
        (shape[1], shape[0]),
        (float(FITTED), MISFIT, ROUGH, CHANCE, TOGETHER),
        (FAINTEST, LONGEST, WANDERED, BORDER),
        told,
    )
    xx, xy, yy = told[:, kernel.COVARIANCE_XX : kernel.COVARIANCE_YY + 1].T
    return Judgement(
        centre=told[:, kernel.CENTRE_X : kernel.CENTRE_Y + 1],
        covariance=np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2),
        peak=p[:, PEAK],
        diameter=told[:, kernel.DIAMETER],
        elongation=told[:, kernel.ELONGATION],
        misfit=told[:, kernel.MISFIT],
        saturated=told[:, kernel.SATURATED] > 0,
        merged=told[:, kernel.MERGED] > 0,
        sound=told[:, kernel.SOUND] > 0,
    )


def joined(parts: list[Judgement]) -> Judgement:
    """Several batches as one."""
    return Judgement(
        *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Judgement))
    )
