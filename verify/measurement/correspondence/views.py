"""Both images as the search needs them: undistorted spots, their noise, and which LED each may be.

Image coordinates here are ideal: the lens undone, the principal point at zero, focal length in px.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from verify.core.fiducials import Marker
from verify.core.records import Array, Flags, Index, Spots
from verify.core.rig import Camera, Rig
from verify.measurement.correspondence.kernels import entries as kernel
from verify.measurement.correspondence.kernels.entries import Limits, Scene
from verify.measurement.systematics import disparity_uncertainty

MIN_SKEW = 1e-3  # px: in effect simultaneous; avoids a division by zero
MIN_DEPTH = 0.02  # m, depth below which a point cannot be imaged
MAX_SPOTS = 48  # an image; the brightest: bounds the work, twice the clutter of a bad scene
MODEL_PX = 0.1  # px, what lens and pan leave unexplained after a fair calibration
MERGED_PX = 1.0  # px, by how much a neighbour's light drags a spot's centre, order of magnitude
DEFAULT_LED_SIGMA = 2e-4  # m, of an LED's light where marker.toml states nothing: a good jig's
MIN_LED_SIGMA = 1e-4  # m, where it does: domes and solder joints do no better
SKEW_SHARE = 0.25  # of the motion tolerance: what differs between LEDs as the flange also turns
LED_COLOURS = {"blue": kernel.BLUE, "green": kernel.GREEN, "red": kernel.RED, "white": kernel.WHITE}


@dataclass(frozen=True, slots=True)
class SpotViews:
    """The left and the right image, padded to the same number of spots (axis 0: left, right)."""

    pixels: Array  # (2, s, 2), ideal px; NaN where padded
    covariance: Array  # (2, s, 2, 2), px², with the model's and the skew's share
    merged: Flags  # (2, s)
    allowed: Flags  # (2, n, s), this spot may be that LED, as far as colour tells
    camera_R_rig: Array  # (2, 3, 3)
    center: Array  # (2, 3), m, optical centres in the rig
    focal: Array  # (2, 2), px
    mean_focal: float  # px
    leds: Array  # (n, 3), m, flange frame
    led_play: float  # m, how far an LED's light may be from its place in the marker file
    skew: float  # px, by how much the whole marker may have moved between the two images

    @property
    def scene(self) -> Scene:
        """Cameras, spots and marker, as compiled functions take them."""
        return (
            self.camera_R_rig, self.center, self.focal, self.pixels, self.covariance, self.merged,
            self.allowed, self.leds,
        )  # fmt: skip

    @property
    def limits(self) -> Limits:
        """What bounds a fit, as compiled functions take it."""
        return fit_limits(self.led_play * self.mean_focal, self.skew)


def fit_limits(play: float, skew: float) -> Limits:
    """What bounds a fit: `play`, m px, an LED's times the focal length; `skew`, px."""
    return MIN_DEPTH, play, 1 / max(skew, MIN_SKEW) ** 2


def model_variance(rig: Rig) -> float:
    """Variance of a spot, px², by what lens and pan leave unexplained and by what is stated."""
    return MODEL_PX**2 + disparity_uncertainty(rig) ** 2


def skew_variance(skew: float) -> float:
    """Variance of a spot of the right image, px², where the marker may have moved so many px."""
    return (SKEW_SHARE * skew) ** 2


def prepare_views(
    spots: tuple[Spots, Spots], rig: Rig, pans: tuple[float, float], marker: Marker, skew: float
) -> SpotViews:
    """Bring spots, cameras and marker into the form that the search works on.

    Spots come brightest first; those past the first 48 are left out. `pans`, rad, are readings of
    the bases; `skew`, px: how far LEDs may have moved in the image between the two exposures.
    """
    optics = stereo_optics(rig.left, rig.right, pans)
    images = kernel.prepare_images(
        (spot_arrays(spots[0]), spot_arrays(spots[1])),
        (optics.matrix, optics.lens),
        (model_variance(rig), MERGED_PX**2, skew_variance(skew)),
        light_of(marker.colours),
        min(max(map(len, spots)), MAX_SPOTS),
    )
    placed, leds = optics.arrays[2:], np.array(marker.leds, order="C")
    return SpotViews(*images, *placed, optics.mean_focal, leds, led_sigma(marker), skew)


def spot_arrays(spots: Spots) -> kernel.ImageSpots:
    """Give an image's spots as the kernel takes them."""
    return spots.centre, spots.covariance, spots.merged, spots.saturated, spots.colour


@lru_cache(maxsize=8)
def light_of(colours: tuple[str | None, ...]) -> Index:
    """Give the light of each LED, (n,), as the kernel takes it."""
    return np.array([LED_COLOURS.get(colour or "", kernel.ANY) for colour in colours])


@dataclass(frozen=True, slots=True)
class StereoOptics:
    """Left and right camera at their pan readings."""

    matrix: Array  # (2, 3, 3), px
    lens: Array  # (2, 5)
    camera_R_rig: Array  # (2, 3, 3)
    center: Array  # (2, 3), m, optical centres in the rig
    focal: Array  # (2, 2), px
    mean_focal: float  # px

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """All of them, as the kernel takes them."""
        return self.matrix, self.lens, self.camera_R_rig, self.center, self.focal


@lru_cache(maxsize=4)  # two cameras are the same ones for many pairs
def stereo_optics(left: Camera, right: Camera, pans: tuple[float, float]) -> StereoOptics:
    """Optics of both cameras at pan readings, rad."""
    matrix = np.array([left.matrix, right.matrix])
    lens = np.array([left.distortion, right.distortion])
    placed = np.array([left.rig_T_camera(pans[0]), right.rig_T_camera(pans[1])])
    turns = np.ascontiguousarray(np.swapaxes(placed[:, :3, :3], 1, 2))
    focal = np.ascontiguousarray(matrix[:, [0, 1], [0, 1]])
    center = placed[:, :3, 3].copy()
    return StereoOptics(matrix, lens, turns, center, focal, float(focal.mean()))


def led_sigma(marker: Marker) -> float:
    """Say how far (m) an LED's light may be from where the marker file has it, one deviation."""
    if marker.led_standard_uncertainty is None:
        return DEFAULT_LED_SIGMA
    shift = marker.centre_shift_standard_uncertainty or 0.0
    return max(MIN_LED_SIGMA, math.hypot(marker.led_standard_uncertainty, shift))
