"""Both images as the search needs them: undistorted spots, their noise, and which LED each may be.

Image coordinates here are ideal: the lens undone, the principal point at zero, focal length in px.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from verify.core.fiducials import Marker
from verify.core.records import Array, Spots
from verify.core.rig import Camera, Rig
from verify.measurement.correspondence.kernels import views as kernel

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
    merged: NDArray[np.bool_]  # (2, s)
    allowed: NDArray[np.bool_]  # (2, n, s), this spot may be that LED, as far as colour tells
    camera_R_rig: Array  # (2, 3, 3)
    center: Array  # (2, 3), m, optical centres in the rig
    focal: Array  # (2, 2), px
    mean_focal: float  # px
    leds: Array  # (n, 3), m, flange frame
    led_play: float  # m, how far an LED's light may be from its place in the marker file
    skew: float  # px, by how much the whole marker may have moved between the two images

    @property
    def cameras(self) -> tuple[Array, Array, Array]:
        """What a projection needs: camera_R_rig, centres and focal lengths."""
        return self.camera_R_rig, self.center, self.focal


def prepare_views(
    spots: tuple[Spots, Spots], rig: Rig, pans: tuple[float, float], marker: Marker, skew: float
) -> SpotViews:
    """Bring spots, cameras and marker into the form that the search works on.

    Spots come brightest first; those past the first 48 are left out. `pans`, rad, are readings of
    the bases; `skew`, px: how far LEDs may have moved in the image between the two exposures.
    """
    most = min(max(map(len, spots)), MAX_SPOTS)
    pixels, covariance = np.empty((2, most, 2)), np.empty((2, most, 2, 2))
    merged = np.empty((2, most), dtype=np.bool_)
    allowed = np.empty((2, len(marker), most), dtype=np.bool_)
    matrix, lens, focal = _optics(rig.left, rig.right)
    light = np.array([LED_COLOURS.get(colour or "", kernel.ANY) for colour in marker.colours])
    for side, found in enumerate(spots):
        uneven = side * (SKEW_SHARE * skew) ** 2
        kernel.prepare_image(
            (
                np.ascontiguousarray(found.centre),
                np.ascontiguousarray(found.covariance),
                np.ascontiguousarray(found.merged),
                np.ascontiguousarray(found.saturated),
                np.ascontiguousarray(found.colour),
            ),
            (matrix[side], lens[side]),
            (MODEL_PX**2 + uneven, MERGED_PX**2),
            light,
            pixels[side],
            covariance[side],
            merged[side],
            allowed[side],
        )
    placed = rig.left.rig_T_camera(pans[0]), rig.right.rig_T_camera(pans[1])
    return SpotViews(
        pixels=pixels,
        covariance=covariance,
        merged=merged,
        allowed=allowed,
        camera_R_rig=np.array([pose[:3, :3].T for pose in placed]),
        center=np.array([pose[:3, 3] for pose in placed]),
        focal=focal,
        mean_focal=float(focal.mean()),
        leds=np.array(marker.leds, order="C"),
        led_play=led_sigma(marker),
        skew=skew,
    )


@lru_cache(maxsize=4)  # two cameras are the same ones for many pairs
def _optics(left: Camera, right: Camera) -> tuple[Array, Array, Array]:
    """Camera matrices (2, 3, 3), lenses (2, 5) and focal lengths (2, 2)."""
    matrix = np.array([left.matrix, right.matrix])
    return matrix, np.array([left.distortion, right.distortion]), matrix[:, [0, 1], [0, 1]]


def led_sigma(marker: Marker) -> float:
    """Say how far (m) an LED's light may be from where the marker file has it, one deviation."""
    if marker.led_standard_uncertainty is None:
        return DEFAULT_LED_SIGMA
    shift = marker.centre_shift_standard_uncertainty or 0.0
    return max(MIN_LED_SIGMA, math.hypot(marker.led_standard_uncertainty, shift))
