"""How well each view of the board fits, and which views stand out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.calibration.records import Residuals
from verify.records import Array

SIGMA_A_MAD = 1.4826  # standard deviation of a normal law over its median absolute deviation
STRANGE = 3.5  # robust standard deviations above the median: Iglewicz and Hoaglin's own limit
WORSE = 1.5  # times the median: a smaller excess does no harm, however regular the others are
FEWEST = 5  # views of a camera that can be said to agree


@dataclass(frozen=True, slots=True)
class View:
    """One board in one camera, as the adjustment left it."""

    camera: int  # 0 left, 1 right
    frame: int
    corners: int  # that were used
    refused: int  # as outliers
    rms: float  # px, root mean square distance of the used corners, as OpenCV counts
    largest: float  # px
    mean: Array  # (2,), px
    poor: bool  # stands out among its camera's views


def rms(residual: Array) -> float:
    """Root mean square length of residuals (n, 2), px; NaN where there are none."""
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1)))) if len(residual) else float("nan")


def views(residuals: Residuals) -> tuple[View, ...]:
    """Sum the residuals up by camera and frame, in that order."""
    found = []
    for camera in np.unique(residuals.camera).tolist():
        own = residuals.camera == camera
        frames = np.unique(residuals.frame[own]).tolist()
        parts = [residuals.residual[own & (residuals.frame == f) & residuals.used] for f in frames]
        poor = standing_out(np.array([rms(part) for part in parts]))
        for frame, part, bad in zip(frames, parts, poor.tolist(), strict=True):
            every = int(np.sum(own & (residuals.frame == frame)))
            largest = float(np.linalg.norm(part, axis=1).max()) if len(part) else float("nan")
            mean = part.mean(axis=0) if len(part) else np.full(2, np.nan)
            found.append(
                View(camera, frame, len(part), every - len(part), rms(part), largest, mean, bad)
            )
    return tuple(found)


def standing_out(values: Array) -> NDArray[np.bool_]:
    """Tell which of some rms values (n,) are out of line with the others.

    Median and median absolute deviation stand for what is usual, so nearly half of the views may
    be bad without hiding themselves.

    Source: the modified z-score of Iglewicz and Hoaglin, How to Detect and Handle Outliers, 1993.
    """
    known = np.isfinite(values) & (values > 0)
    out = np.zeros(len(values), dtype=bool)
    if known.sum() < FEWEST:
        return out
    usual = float(np.median(values[known]))
    spread = SIGMA_A_MAD * float(np.median(np.abs(values[known] - usual)))
    out[known] = values[known] > max(usual + STRANGE * spread, WORSE * usual)
    return out
