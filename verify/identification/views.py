"""Both images as the search needs them: undistorted spots, their noise, and which LED each may be.

Image coordinates here are ideal: the lens undone, the principal point at zero, focal length in px.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.marker import Marker
from verify.records import Array, Spots
from verify.rig import Rig

MOST_SPOTS = 48  # an image; the brightest: bounds the work, twice the clutter of a bad scene
MODEL_PX = 0.1  # px, what lens and pan leave unexplained after a fair calibration
MERGED_PX = 1.0  # px, by how much a neighbour's light drags a spot's centre, order of magnitude
UNSTATED_PLAY = 2e-4  # m, of an LED's light where marker.toml states nothing: a good jig's
LEAST_PLAY = 1e-4  # m, where it does: domes and solder joints do no better
UNEVEN_SKEW = 0.25  # of the motion tolerance: what differs between LEDs as the flange also turns
CLEAR_HUE = 0.3  # (largest - second) / largest channel: warm white stays under 0.2, LEDs above 0.4
CHANNELS = {"blue": 0, "green": 1, "red": 2}


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
    cameras = (rig.left, rig.right)
    counts = [min(len(seen), MOST_SPOTS) for seen in spots]
    most = max(counts)
    pixels = np.full((2, most, 2), np.nan)
    covariance = np.broadcast_to(np.eye(2), (2, most, 2, 2)).copy()
    merged = np.zeros((2, most), dtype=bool)
    allowed = np.zeros((2, len(marker), most), dtype=bool)
    placed = [camera.rig_T_camera(pan) for camera, pan in zip(cameras, pans, strict=True)]
    focal = np.array([np.diag(camera.matrix)[:2] for camera in cameras])
    for side, (seen, count) in enumerate(zip(spots, counts, strict=True)):
        pixels[side, :count] = cameras[side].normalise(seen.centre[:count]) * focal[side]
        merged[side, :count] = seen.merged[:count]
        model = MODEL_PX**2 + (MERGED_PX * merged[side, :count]) ** 2
        uneven = side * (UNEVEN_SKEW * skew) ** 2
        covariance[side, :count] = seen.covariance[:count] + np.multiply.outer(
            model + uneven, np.eye(2)
        )
        allowed[side, :, :count] = may_be(marker.colours, seen)[:, :count]
    return Views(
        pixels=pixels,
        covariance=covariance,
        merged=merged,
        allowed=allowed,
        camera_R_rig=np.array([pose[:3, :3].T for pose in placed]),
        center=np.array([pose[:3, 3] for pose in placed]),
        focal=focal,
        mean_focal=float(focal.mean()),
        leds=marker.leds,
        led_play=led_play(marker),
        skew=skew,
    )


def led_play(marker: Marker) -> float:
    """Say how far (m) an LED's light may be from where the marker file has it, one deviation."""
    if marker.led_standard_uncertainty is None:
        return UNSTATED_PLAY
    shift = marker.centre_shift_standard_uncertainty or 0.0
    return max(LEAST_PLAY, float(np.hypot(marker.led_standard_uncertainty, shift)))


def may_be(colours: tuple[str | None, ...], spots: Spots) -> NDArray[np.bool_]:
    """Say which LED (rows) each spot (columns) may be by its colour.

    Only clear contradictions count. A spot with no clear hue may be white, infrared (cameras show
    it whitish or violet) or, where saturated, any overexposed LED. A grey image tells nothing.
    """
    possible = np.ones((len(colours), len(spots)), dtype=bool)
    if len(spots) == 0 or not np.any(np.ptp(spots.colour, axis=1) > 0):
        return possible
    ordered = np.sort(spots.colour, axis=1)
    clear = ordered[:, 2] - ordered[:, 1] > CLEAR_HUE * np.abs(ordered[:, 2])
    hue = np.argmax(spots.colour, axis=1)
    for led, colour in enumerate(colours):
        if colour == "white":
            possible[led] = ~clear
        elif colour in CHANNELS:
            possible[led] = np.where(clear, hue == CHANNELS[colour], spots.saturated)
    return possible
