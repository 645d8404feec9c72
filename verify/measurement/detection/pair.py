"""Find the spots of both pictures of a pair, with the noise that pairs before have shown.

One picture's few spots show its noise to a tenth or so, and estimating it takes a fifth of finding
and measuring them. So it is estimated on a camera's first pictures, then on one in many, and on
those whose spots contradict it: a camera may change its gain by itself.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from verify.core.records import Array, Noise, Spots, StereoPair, take_rows
from verify.measurement.detection.detect import detect

# Standard uncertainty of a spot that may be an LED. Texture of a room gives blobs of 1 to 4 px,
# which fit wherever an LED may be; a limit of 1 px loses LEDs of which half is hidden.
MAX_VAGUE_PX = 1.4
FIRST_PICTURES = 4  # each estimates its own noise
ESTIMATE_EVERY = 32  # pictures after them
MAX_ESTIMATES = 8  # that the mean holds; of more, the earlier ones fade
# Of a picture's spots, to what was usual: beyond, its noise is another. Chance brings the median of
# four small spots there in one picture of a hundred; of a noise a quarter larger, in one of ten.
MAX_MISFIT_RATIO = 1.5

# of the left picture and of the right: windows (m, 4) px, None for all; noise, None: not known
Windows = tuple[Array | None, Array | None]
PairNoise = tuple[Noise | None, Noise | None]
Detector = Callable[[StereoPair, Windows, PairNoise], tuple[Spots, Spots]]
EVERYWHERE: Windows = (None, None)
NOT_KNOWN: PairNoise = (None, None)


def detect_in_turn(
    pair: StereoPair, windows: Windows = EVERYWHERE, noise: PairNoise = NOT_KNOWN
) -> tuple[Spots, Spots]:
    """Find the spots of both pictures of a pair, of the left one first."""
    left = detect(pair.left, windows[0], noise=noise[0], lossy=pair.lossy[0])
    return left, detect(pair.right, windows[1], noise=noise[1], lossy=pair.lossy[1])


def warm_up(detector: Detector = detect_in_turn) -> None:
    """Load what measuring takes, in another process too, by a black picture."""
    black = np.zeros((64, 64), dtype=np.uint8)
    detector(StereoPair(0, 0.0, 0.0, 0.0, 0.0, black, black), EVERYWHERE, NOT_KNOWN)


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """Mean of the noise that one camera's pictures showed."""

    mean: Noise | None = None  # None: not yet
    misfit: float = 1.0  # reduced chi² of clean spots under a picture's own noise
    estimates: int = 0
    pictures: int = 0  # since the last estimate

    @property
    def known(self) -> Noise | None:
        """What the next picture is to be measured with; None: it is to estimate its own."""
        due = self.estimates < FIRST_PICTURES or self.pictures + 1 >= ESTIMATE_EVERY
        return None if due else self.mean

    def contradicted(self, spots: Spots) -> bool:
        """Whether spots that were measured with the mean have another noise."""
        ratio = _usual_misfit(spots) / self.misfit
        return ratio > MAX_MISFIT_RATIO or ratio * MAX_MISFIT_RATIO < 1

    def after(self, spots: Spots, *, own: bool) -> "CameraNoise":
        """What is known with one more picture; `own`: it was measured with its own noise."""
        misfit = _usual_misfit(spots)
        if not misfit > 0:  # nothing clean has shown it
            return self
        if not own:
            return replace(self, pictures=self.pictures + 1)
        now, mean, count = spots.noise, self.mean or spots.noise, self.estimates + 1
        steps = (
            (mean.read**2, now.read**2),
            (mean.gain, now.gain),
            (mean.black, now.black),
            (self.misfit, misfit),
        )
        share = 1 / min(count, MAX_ESTIMATES)
        read2, gain, black, misfit = (old + share * (new - old) for old, new in steps)
        return CameraNoise(Noise(math.sqrt(read2), gain, black), misfit, count)


def _usual_misfit(spots: Spots) -> float:
    """Median misfit of clean spots; nan without any."""
    columns = spots.misfit.tolist(), spots.merged.tolist(), spots.saturated.tolist()
    clean = [misfit for misfit, *flags in zip(*columns, strict=True) if not any(flags)]
    return median(clean) if clean else math.nan


@dataclass(frozen=True, slots=True)
class PairSpots:
    """What may be LEDs in the two pictures of a pair."""

    spots: tuple[Spots, Spots]  # left and right
    noise: tuple[CameraNoise, CameraNoise]  # by this pair and those before
    whole_frame: bool


def find_spots(
    pair: StereoPair,
    detector: Detector,
    windows: Windows,
    least: Array,
    noise: tuple[CameraNoise, CameraNoise],
) -> PairSpots:
    """Find the spots of both pictures that may be LEDs.

    `least` (2,), DN, peak of an LED in either picture, nan where it is not known; `noise` as the
    pairs before have shown it: of a whole frame each picture estimates its own.
    """
    whole = windows[0] is None
    known = NOT_KNOWN if whole else (noise[0].known, noise[1].known)
    left, right = detector(pair, windows, known)
    spots = _likely(left, least[0]), _likely(right, least[1])
    one, other = (
        CameraNoise() if used and before.contradicted(some) else before.after(some, own=not used)
        for before, used, some in zip(noise, known, spots, strict=True)
    )
    if (known[0] and not one.mean) or (known[1] and not other.mean):
        return find_spots(pair, detector, windows, least, (one, other))
    return PairSpots(spots, (one, other), whole)


def _likely(spots: Spots, least: float) -> Spots:
    """Leave out the spots whose place is hardly known, and those far dimmer than any LED."""
    sure = (spots.covariance <= MAX_VAGUE_PX**2).all(axis=(1, 2))  # a variance is the largest entry
    sure &= ~(spots.peak < least)
    return spots if sure.all() else take_rows(spots, np.flatnonzero(sure))
