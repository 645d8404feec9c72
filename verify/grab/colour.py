"""What colour a target has: a weight for every hue and saturation, gated by saturation and value.

Hue is what light leaves alone; saturation tells a colour from grey. Value (brightness) changes with
the light and is a gate only: pixels too dark to have a hue of their own count for nothing.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.errors import InputError
from verify.records import Array, Image

HUES, SATURATIONS = 180, 256  # of OpenCV's 8-bit HSV: hue in steps of 2°
HUE_BINS, SATURATION_BINS = 30, 8  # of the histograms that are compared: 12° by 32 DN
DARKEST = 25  # DN of value; below it a DN of noise turns the hue by more than 2°
PALEST = 50  # DN of saturation; white paper in tinted light stays below it
LIGHTS = (0.2, 4.0)  # of the light when the target was learned: beyond, 8 bits hold too little
SOFT_HUE_DEG = 5.0  # over which a named colour's weight fades at either end of its hues

# name -> hues in degrees from, to (through 0 where from > to), and least saturation in DN. The hues
# are the names' usual places on the hexagonal colour circle, cut halfway between neighbours.
NAMED_HUES_DEG: dict[str, tuple[float, float, int]] = {
    "red": (345.0, 12.0, 110),
    "orange": (12.0, 40.0, 130),  # skin and wood have these hues, but pale
    "yellow": (40.0, 68.0, 110),
    "green": (68.0, 165.0, 80),
    "cyan": (165.0, 195.0, 80),
    "blue": (195.0, 255.0, 80),
    "violet": (255.0, 290.0, 70),
    "magenta": (290.0, 345.0, 80),
}

Mask = NDArray[np.uint8]  # 255 where it holds


@dataclass(frozen=True, slots=True)
class ColourModel:
    """How well each colour fits the target, and what the target's own mixture of colours is."""

    weight: NDArray[np.float32]  # (180, 256), 0 to 255, by hue and saturation: back projection
    mixture: Array | None = None  # (30, 8), sums to 1: the target as seen; None: only its name
    values: tuple[float, float] = (DARKEST, 255.0)  # DN, gate of the value, in the light of then
    value: float = 128.0  # DN, median of the target's value, in the light of then
    light: float = 1.0  # of now, over that of then: the gate goes with it

    def back_project(self, hsv: Image) -> Image:
        """Weigh each pixel of an (h, w, 3) HSV picture: (h, w), 0 to 255 for "like the target"."""
        ranges = [0, HUES, 0, SATURATIONS]
        weights = cv2.calcBackProject([hsv], [0, 1], self.weight, ranges, 1.0)
        low = max(self.values[0] * self.light, DARKEST)
        gate = cv2.inRange(hsv[..., 2], low, max(self.values[1] * self.light, low))
        return np.asarray(cv2.bitwise_and(weights, gate), dtype=np.uint8)

    def in_light(self, value: float) -> "ColourModel":
        """Let the gate of the value follow a target whose median value is now this, DN."""
        return replace(self, light=float(np.clip(value / self.value, *LIGHTS)))

    def similarity(self, hsv: Image, mask: Mask) -> float:
        """Compare a region's mixture of colours with the target's: 1 alike, 0 nothing in common.

        Source: the Bhattacharyya coefficient, as in Comaniciu, Ramesh and Meer, IEEE TPAMI 25(5),
        2003, eq. 6. It is 1 where only the colour's name is known.
        """
        if self.mixture is None:
            return 1.0
        return float(np.sum(np.sqrt(self.mixture * mixture(hsv, mask))))


def to_hsv(bgr: Image) -> Image:
    """Convert (h, w, 3) BGR to OpenCV's 8-bit HSV: hue in steps of 2°, saturation and value in DN.

    Raises:
        InputError: the picture is grey.
    """
    if bgr.ndim != 3:
        remedy = "Set the cameras to colour (grey = false)."
        raise InputError("pictures", "are grey", "a target is told by its colour", remedy)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV), dtype=np.uint8)


def named(name: str) -> ColourModel:
    """Make the model of a colour that is known by name alone.

    Raises:
        InputError: nobody here knows the name.
    """
    if name not in NAMED_HUES_DEG:
        known = ", ".join(NAMED_HUES_DEG)
        raise InputError("--target", f'"{name}" is not known', f"known colours: {known}")
    low, high, palest = NAMED_HUES_DEG[name]
    degrees = np.arange(HUES) * (360.0 / HUES)
    half = ((high - low) % 360.0) / 2
    away = np.abs((degrees - low - half + 180.0) % 360.0 - 180.0)  # from the middle of the hues
    by_hue = np.clip((half - away) / SOFT_HUE_DEG + 0.5, 0.0, 1.0)
    by_saturation = np.arange(SATURATIONS) >= palest
    weight = (255.0 * np.outer(by_hue, by_saturation)).astype(np.float32)
    return ColourModel(weight)


def mixture(hsv: Image, mask: Mask) -> Array:
    """Count a region's colours in coarse bins: (30, 8), summing to 1; all 0 for no pixel."""
    counts = cv2.calcHist(
        [hsv], [0, 1], mask, [HUE_BINS, SATURATION_BINS], [0, HUES, 0, SATURATIONS]
    )
    shares: Array = counts.astype(float) / max(float(counts.sum()), 1.0)
    return shares
