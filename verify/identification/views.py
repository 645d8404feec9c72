"""Both images as the search needs them: undistorted spots, their noise, and which LED each may be.

Image coordinates here are ideal: the lens undone, the principal point at zero, focal length in px.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from verify.identification import kernel_views as kernel
from verify.marker import Marker
from verify.records import Array, Spots
from verify.rig import Camera, Rig

MOST_SPOTS = 48  # an image; the brightest: bounds the work, twice the clutter of a bad scene
MODEL_PX = 0.1  # px, what lens and pan leave unexplained after a fair calibration
MERGED_PX = 1.0  # px, by how much a neighbour's light drags a spot's centre, order of magnitude
UNSTATED_PLAY = 2e-4  # m, of an LED's light where marker.toml states nothing: a good jig's
LEAST_PLAY = 1e-4  # m, where it does: domes and solder joints do no better
UNEVEN_SKEW = 0.25  # of the motion tolerance: what differs between LEDs as the flange also turns
LIGHTS = {"blue": kernel.BLUE, "green": kernel.GREEN, "red": kernel.RED, "white": kernel.WHITE}


@dataclass(frozen=True, slots=True)
class Views:
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
    led_play: float  # m, how far an LED's light may be from where the marker file says
    skew: float  # px, by how much the whole marker may have moved between the two images

    @property
    def cameras(self) -> tuple[Array, Array, Array]:
        """What a projection needs: camera_R_rig, centres and focal lengths."""
        return self.camera_R_rig, self.center, self.focal


def look(
    spots: tuple[Spots, Spots], rig: Rig, pans: tuple[float, float], marker: Marker, skew: float
) -> Views:
    """Bring spots, cameras and marker into the form that the search works on.

    Args:
        spots: left and right, brightest first; those past the first 48 are left out.
        rig: the calibrated cameras.
        pans: rad, readings of the left and the right base.
        marker: the LEDs.
        skew: px, how far LEDs may have moved in the image between the two exposures.
    """
    most = min(max(len(seen) for seen in spots), MOST_SPOTS)
    pixels, covariance = np.empty((2, most, 2)), np.empty((2, most, 2, 2))
    merged = np.empty((2, most), dtype=np.bool_)
    allowed = np.empty((2, len(marker), most), dtype=np.bool_)
    matrix, lens, focal = _optics(rig.left, rig.right)
    light = np.array([LIGHTS.get(colour or "", kernel.ANY) for colour in marker.colours])
    for side, seen in enumerate(spots):
        uneven = side * (UNEVEN_SKEW * skew) ** 2
        kernel.look_one(
            (
                np.array(seen.centre, order="C"),
                np.array(seen.covariance, order="C"),
                np.array(seen.merged, order="C"),
                np.array(seen.saturated, order="C"),
                np.array(seen.colour, order="C"),
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
    return Views(
        pixels=pixels,
        covariance=covariance,
        merged=merged,
        allowed=allowed,
        camera_R_rig=np.array([pose[:3, :3].T for pose in placed]),
        center=np.array([pose[:3, 3] for pose in placed]),
        focal=focal,
        mean_focal=float(focal.mean()),
        leds=np.array(marker.leds, order="C"),
        led_play=led_play(marker),
        skew=skew,
    )


@lru_cache(maxsize=4)  # two cameras are the same ones for many pairs
def _optics(left: Camera, right: Camera) -> tuple[Array, Array, Array]:
    """Camera matrices (2, 3, 3), lenses (2, 5) and focal lengths (2, 2)."""
    matrix = np.array([left.matrix, right.matrix])
    return matrix, np.array([left.distortion, right.distortion]), matrix[:, [0, 1], [0, 1]]


def led_play(marker: Marker) -> float:
    """Say how far (m) an LED's light may be from where the marker file has it, one deviation."""
    if marker.led_standard_uncertainty is None:
        return UNSTATED_PLAY
    shift = marker.centre_shift_standard_uncertainty or 0.0
    return max(LEAST_PLAY, math.hypot(marker.led_standard_uncertainty, shift))
