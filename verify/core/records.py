"""Values passed along the measuring chain: StereoPair, Spots, Sighting, Pose, Measurement.

Metres, radians and seconds throughout; image coordinates in pixels, (x, y), pixel centres at
whole numbers. `a_T_b` carries coordinates in b to coordinates in a.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Flags = NDArray[np.bool_]
Index = NDArray[np.int64]
ROW_STEP = 45  # of rows that show whether pictures differ: a camera's noise is in each
Record = TypeVar("Record")
SIDES = ("left", "right")  # of the cameras
POSE_NAMES = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")  # of six figures in files
Progress = Callable[[int, int], None]  # called with what is done and what is to be done


def no_progress(_done: int, _total: int) -> None:
    """Report no progress."""


def rigid_transform(rotation: NDArray[Any], translation: NDArray[Any]) -> Array:
    """Put together a_T_b (..., 4, 4) of a_R_b (..., 3, 3) and b's origin in a, (..., 3), m.

    One of the two may be the same for all.
    """
    a_T_b = np.zeros((*(rotation.shape[:-2] or translation.shape[:-1]), 4, 4))
    a_T_b[..., :3, :3], a_T_b[..., :3, 3], a_T_b[..., 3, 3] = rotation, translation, 1.0
    return a_T_b


def take_rows(record: Record, rows: Index | Flags | slice) -> Record:
    """Take some rows of each array of a dataclass, by index or mask; other fields stay."""
    kind: Any = type(record)
    values = ((name, getattr(record, name)) for name in kind.__match_args__)
    taken: Record = kind(**{k: v[rows] if isinstance(v, np.ndarray) else v for k, v in values})
    return taken


@dataclass(frozen=True, slots=True)
class StereoPair:
    """Two pictures with their instants and the pan readings of their bases."""

    frame: int
    t_left: float  # s, cameras' clock, mid-exposure
    t_right: float
    pan_left: float  # rad, as read; the rig adds pan_zero
    pan_right: float
    left: Image  # (h, w) grey or (h, w, 3) BGR
    right: Image
    lossy: tuple[bool, bool] = (False, False)  # left, right: decoded from a JPEG


@dataclass(frozen=True, slots=True)
class Noise:
    """The variance of a pixel of signal s above black: read² + gain · s, in DN²."""

    read: float  # DN, standard deviation in the dark, quantisation included
    gain: float  # DN² of variance a DN of signal (shot noise)
    black: float  # DN, level at which the signal is zero


@dataclass(frozen=True, slots=True)
class Spots:
    """The bright spots found in one image, brightest first."""

    centre: Array  # (n, 2), px
    covariance: Array  # (n, 2, 2), px²
    peak: Array  # (n,), DN above background of the fitted profile (may exceed 255 when saturated)
    diameter: Array  # (n,), px, full width at half height of the fitted profile, mean of both axes
    misfit: Array  # (n,), reduced chi² of the profile fit: near 1 for one clean LED
    saturated: Flags  # (n,), some pixels are at the sensor's limit
    merged: Flags  # (n,), shape or misfit show that it is not one clean spot
    colour: Array  # (n, 3), mean B, G, R above background; equal for a grey image
    noise: Noise

    def __len__(self) -> int:
        return len(self.centre)


@dataclass(frozen=True, slots=True)
class Sighting:
    """LEDs found in one camera's image, by their index in the marker."""

    led: Index  # (m,), index into marker.leds
    centre: Array  # (m, 2), px, distorted, carried to the instant t
    covariance: Array  # (m, 2, 2), px²
    t: float  # s, the instant that `centre` belongs to
    pan: float  # rad, camera base angle as read
    peak: Array  # (m,), DN
    velocity: Array  # (m, 2), px/s, from neighbouring pairs; 0 where the arm stands still
    # (m, 3), s², s³, s⁴: px by which one px/s² of acceleration, px/s³ of jerk or px/s⁴ of snap
    # displaces `centre`
    lever: Array

    def __len__(self) -> int:
        return len(self.led)


@dataclass(frozen=True, slots=True)
class Pose:
    """The flange's pose in the rig at one instant, with its covariance.

    A perturbation is a translation and a small rotation vector, both in rig axes, applied on the
    left: R' = exp(phi) R, p' = p + rho.
    """

    rig_T_flange: Array  # (4, 4)
    covariance_pixels: Array  # (6, 6), m and rad: from the spots' noise alone
    covariance_alignment: Array  # (6, 6): from bringing the right image to the left's instant
    twist: Array  # (6,), m/s and rad/s: how the flange moves, from the spots' velocities
    acceleration_prior: tuple[float, float]  # m/s², rad/s²: what covariance_alignment assumed
    determined: Array  # (6, known_dof), orthonormal: functionals that the visible LEDs determine
    gain: Array  # (6, 2 s): d pose / d spot centre, left sightings then right; 0 for rejected ones
    sensitivity: Array  # (s, 2, 3): d px / d point in the rig, the same order
    curvature: Array  # (s, 2), px/s²: image acceleration of a steady twist, already corrected for
    residual: Array  # (s, 2), px, measured less predicted
    spot_uncertainty: Array  # (s,), px a coordinate: noise, and what alignment adds to it
    rejected: Flags  # (s,), sightings that the fit rejected as outliers
    consistent: bool  # no spots left contradict the others
    chi2: float  # whitened residual sum of squares
    degrees_of_freedom: int

    @property
    def known_dof(self) -> int:
        """Count the degrees of freedom that the visible LEDs determine: 0, 3, 5 or 6."""
        return int(self.determined.shape[1])

    @property
    def covariance(self) -> Array:
        """Covariance of what varies from pair to pair, (6, 6), m and rad."""
        return self.covariance_pixels + self.covariance_alignment

    @property
    def reprojection_rms_px(self) -> float:
        """Root mean square distance of the used spots from those that the pose predicts."""
        used = self.residual[~self.rejected] if np.count_nonzero(self.rejected) else self.residual
        return math.sqrt(float(np.vdot(used, used)) / len(used)) if len(used) else math.nan


def same_picture(one: Image, other: Image) -> bool:
    """Whether two pictures are the same in every pixel; a few rows tell those with noise apart."""
    rows = slice(None, None, ROW_STEP)
    return np.array_equal(one[rows], other[rows]) and np.array_equal(one, other)


@dataclass(frozen=True, slots=True)
class Measurement:
    """The result of one stereo pair; the status of an unusable pair gives the reason."""

    frame: int
    t: float  # s, the left camera's instant
    status: str  # measured, too_few_leds, ambiguous_leds, outlier, unaligned
    leds_seen: int  # LEDs seen by at least one camera
    pose: Pose | None = None
    left: Sighting | None = None
    right: Sighting | None = None
    choice: str = ""  # how identification was settled: geometry, colour, continuity, encoders
    whole_frame: bool = False  # the LEDs were searched in the whole picture
    settled: bool = True  # by the pairs before and after; False: by those before alone

    def __repr__(self) -> str:
        fit = "" if self.pose is None else f", {self.pose.reprojection_rms_px:.3f} px"
        return f"<Measurement of pair {self.frame}: {self.status}, {self.leds_seen} LEDs{fit}>"
