"""What a registration from motion found, and all that its report says."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.marker import Marker
from verify.records import Array
from verify.rig import Rig


@dataclass(frozen=True, slots=True)
class SpotResiduals:
    """Every spot that was taken for an LED's, one row each."""

    frame: NDArray[np.int64]  # (r,)
    camera: NDArray[np.int64]  # (r,), 0 left, 1 right
    led: NDArray[np.int64]  # (r,), index into the marker's LEDs
    seen: Array  # (r, 2), px
    residual: Array  # (r, 2), px, seen less predicted
    used: NDArray[np.bool_]  # (r,), false: the others contradict it


@dataclass(frozen=True, slots=True)
class MotionRegistration:
    """Base and LEDs from a motion, with what that hides."""

    rig: Rig  # with robot base, absorption and the covariance of all that was found
    marker: Marker
    clock_offset: float  # s, added to the readings' time gives the cameras'
    clock_standard_uncertainty: float | None  # s; None: the motion does not show it, held
    skew: float  # s, by how much the right camera's stamps are early
    skew_standard_uncertainty: float | None  # s; None: the motion does not show it, held at 0
    visible_fractions: Array  # (j,), of a constant offset that was there already
    rms_px: float  # of the adjustment on all pairs
    fit_rms_px: float | None  # registered on every other part of the session …
    held_out_rms_px: float | None  # … and judged on the rest; None: too few pairs for that
    misfit: float  # chi² a degree of freedom, before uncertainties were enlarged by it
    pairs_used: int
    left_out: dict[int, str]  # by frame: why a pair does not count
    residuals: SpotResiduals
    decisions: tuple[str, ...]
    warnings: tuple[str, ...]
