"""Judge fitted spots: centre, covariance, size, and whether each is one clean LED."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array
from verify.measurement.detection.candidates import LocatedPatches
from verify.measurement.detection.fit import SpotFit
from verify.measurement.detection.kernels import quality as kernel

# parameters that a spot's own pixels pay for; the slopes live on the surroundings. With few pixels
# left, of a spot far over the limit, its foot pays for them
N_FITTED = 8
MAX_REDUCED_CHI2 = 6.0  # reduced chi² of a shape that no clean LED has
MAX_RESIDUAL_RATIO = 0.035  # rms residual over peak; both must hold: a bright LED shows any flaw
MIN_PEAK = 8.0  # sigma of the peak: chance does not reach it in a picture
MAX_SHIFT = 1.5  # half-widths: a fit that left its candidate has found something else
MAX_AXIS_RATIO = 2.0  # axis ratio of the fitted profile; a blurred LED stays below, streaks do not
# A shape that the profiles lack (a stalk before the LED, a reflection beside it) leaves errors
# larger than noise, in neighbouring pixels alike: said in the covariance too. What is left of a
# clipped spot is too little to judge its shape by.
MAX_CHI2_SIGMA = 3.0  # standard deviations of a reduced chi² that noise alone reaches
CORRELATED_PIXELS = 20.0  # pixels that a wrong shape lifts together, so that they do not average
MIN_BORDER = 1.2  # half-widths that must be inside the image


@dataclass(frozen=True, slots=True)
class SpotQuality:
    """What is told of n fitted candidates."""

    told: Array  # (n, 14), columns as in kernel_judgement

    def taken(self, which: NDArray[np.intp]) -> "SpotQuality":
        """Some of the candidates."""
        return SpotQuality(self.told[which])

    @property
    def centre(self) -> Array:
        """Place, (n, 2), px."""
        return self.told[:, kernel.COL_CENTRE_X : kernel.COL_CENTRE_Y + 1]

    @property
    def covariance(self) -> Array:
        """Its covariance, (n, 2, 2), px²."""
        flat = self.told[:, kernel.COL_COVARIANCE_XX : kernel.COL_COVARIANCE_YY + 1]
        return flat.reshape(-1, 2, 2)

    @property
    def peak(self) -> Array:
        """Height, (n,), DN."""
        return self.told[:, kernel.COL_PEAK]

    @property
    def diameter(self) -> Array:
        """Full width at half height, (n,), px."""
        return self.told[:, kernel.COL_DIAMETER]

    @property
    def elongation(self) -> Array:
        """Axis ratio, (n,)."""
        return self.told[:, kernel.COL_ELONGATION]

    @property
    def misfit(self) -> Array:
        """Reduced chi², (n,)."""
        return self.told[:, kernel.COL_MISFIT]

    @property
    def own(self) -> Array:
        """How many of its own pixels clipping leaves alone, (n,)."""
        return self.told[:, kernel.COL_COUNT]

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Whether pixels of it are at the sensor's limit, (n,)."""
        return np.asarray(self.told[:, kernel.COL_SATURATED] > 0)

    @property
    def merged(self) -> NDArray[np.bool_]:
        """Whether its shape is none that a single LED has, (n,)."""
        return np.asarray(self.told[:, kernel.COL_MERGED] > 0)

    @property
    def sound(self) -> NDArray[np.bool_]:
        """Whether it is a spot at all: found where it was looked for, compact, whole, (n,)."""
        return np.asarray(self.told[:, kernel.COL_SOUND] > 0)


def assess_spots(
    batches: Sequence[tuple[LocatedPatches, SpotFit]], shape: tuple[int, ...]
) -> SpotQuality:
    """Judge fits, batch by batch; `shape` is the image's height and width."""
    told = np.empty((sum(len(cut.origin) for cut, _ in batches), kernel.N_COLUMNS))
    begin = 0
    for cut, state in batches:
        end = begin + len(cut.origin)
        kernel.assess_all(
            state.parameters,
            state.information,
            cut.patches.pixels,
            state.known,
            cut.patches.scale,
            cut.origin,
            (shape[1], shape[0]),
            (
                float(N_FITTED),
                MAX_REDUCED_CHI2,
                MAX_RESIDUAL_RATIO,
                MAX_CHI2_SIGMA,
                CORRELATED_PIXELS,
            ),
            (MIN_PEAK, MAX_AXIS_RATIO, MAX_SHIFT, MIN_BORDER),
            told[begin:end],
        )
        begin = end
    return SpotQuality(told)


def number_brightest(judgement: SpotQuality, fewest: float, most: int) -> NDArray[np.int64]:
    """Number the brightest of n spots, brightest first, from 0; -1 are the others.

    Args:
        judgement: of the n spots.
        fewest: pixels: a spot has more of its own that clipping leaves alone.
        most: how many are numbered.
    """
    told = judgement.told
    speaks = (told[:, kernel.COL_SOUND] > 0.0) & (told[:, kernel.COL_COUNT] > fewest)
    spots = np.flatnonzero(speaks)
    brightness = told[spots, kernel.COL_PEAK] / told[spots, kernel.COL_ELONGATION]
    brightest = spots[np.argsort(-brightness, kind="stable")[:most]]
    number = np.full(len(told), -1)
    number[brightest] = np.arange(len(brightest))
    return number


def choose_spots(
    judgement: SpotQuality, diameter: tuple[float, float], apart: float, limit: int
) -> NDArray[np.int64]:
    """Choose the most LED-like of n spots, listed by falling peak.

    Args:
        judgement: of the n spots.
        diameter: px, least and largest.
        apart: diameters: closer spots are one spot found twice.
        limit: how many at most.
    """
    told = judgement.told
    width = told[:, kernel.COL_DIAMETER]
    fits = (diameter[0] <= width) & (width <= diameter[1])
    sound = np.flatnonzero((told[:, kernel.COL_SOUND] > 0.0) & fits)
    twin = np.empty(len(sound), np.bool_)
    kernel.mark_duplicates(told[sound], apart, twin)
    single = sound[~twin]
    rows = told[single]
    rank = -rows[:, kernel.COL_PEAK] / (1.0 + rows[:, kernel.COL_MISFIT])
    rank /= rows[:, kernel.COL_ELONGATION]
    best = single[np.argsort(rank, kind="stable")[:limit]]
    chosen: NDArray[np.int64] = best[np.argsort(-told[best, kernel.COL_PEAK], kind="stable")]
    return chosen
