"""Model a target's colour by a weight of every hue and saturation, and a gate of the value.

Hue hardly changes with the light; saturation tells a colour from grey. Value (brightness) changes
with the light and is a gate only: pixels too dark to have a hue count for nothing. A model is made
from a colour's name, or learned from pixels that show the target, against those around it.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Flags, Image
from verify.errors import InputError

N_HUES, N_SATURATIONS = 180, 256  # of OpenCV's 8-bit HSV: hue in steps of 2°
N_HUE_BINS, N_SATURATION_BINS = 30, 8  # of the histograms that are compared: 12° by 32 DN
MIN_VALUE = 25  # DN of value; below it a DN of noise turns the hue by more than 2°
MIN_SATURATION = 50  # DN of saturation; white paper in tinted light stays below it
LIGHT_RANGE = (0.2, 4.0)  # of the light when the target was learned: beyond, 8 bits hold too little
HUE_FADE_DEG = 5.0  # over which a named colour's weight fades at either end of its hues

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
    mixture: NDArray[np.float32] | None = None  # (30, 8), of the target; None: only its name
    values: tuple[float, float] = (MIN_VALUE, 255.0)  # DN, gate of the value, in the light of then
    value: float = 128.0  # DN, mean of the target's value, in the light of then
    light: float = 1.0  # of now, over that of then: the gate goes with it

    def back_project(self, hsv: Image) -> Image:
        """Weigh each pixel of an (h, w, 3) HSV picture: (h, w), 0 to 255 for "like the target"."""
        ranges = [0, N_HUES, 0, N_SATURATIONS]
        weights = cv2.calcBackProject([hsv], [0, 1], self.weight, ranges, 1.0)
        low = max(self.values[0] * self.light, MIN_VALUE)
        gate = cv2.inRange(cv2.extractChannel(hsv, 2), low, max(self.values[1] * self.light, low))
        return np.asarray(cv2.bitwise_and(weights, gate), dtype=np.uint8)

    def in_light(self, value: float) -> "ColourModel":
        """Let the gate of the value follow a target whose mean value is now this, DN."""
        return replace(self, light=float(np.clip(value / self.value, *LIGHT_RANGE)))

    def similarity(self, hsv: Image, mask: Mask) -> float:
        """Compare a region's mixture of colours with the target's: 1 alike, 0 nothing in common.

        Source: the Bhattacharyya coefficient, as in Comaniciu, Ramesh and Meer, IEEE TPAMI 25(5),
        2003, eq. 6. It is 1 where only the colour's name is known.
        """
        if self.mixture is None:
            return 1.0
        found = colour_histogram(hsv, mask)
        return 1.0 - cv2.compareHist(self.mixture, found, cv2.HISTCMP_BHATTACHARYYA) ** 2


def to_hsv(bgr: Image) -> Image:
    """Convert (h, w, 3) BGR to OpenCV's 8-bit HSV: hue in steps of 2°, saturation and value in DN.

    Raises:
        InputError: the picture is grey.
    """
    if bgr.ndim != 3:
        remedy = "Set the cameras to colour (grey = false); simulated: `verify grab --sim`."
        raise InputError("pictures", "are grey", "a target is identified by its colour", remedy)
    # as one row: what does not fill a vector is converted pixel by pixel, in each row
    row = bgr.reshape(1, -1, 3)
    return np.asarray(cv2.cvtColor(row, cv2.COLOR_BGR2HSV), dtype=np.uint8).reshape(bgr.shape)


def named_colour(name: str) -> ColourModel:
    """Make the model of a colour that is known by name alone; InputError: this one is not."""
    if name not in NAMED_HUES_DEG:
        names = ", ".join(NAMED_HUES_DEG)
        raise InputError("--target", f'"{name}" is not known', f"known colours: {names}")
    low, high, palest = NAMED_HUES_DEG[name]
    degrees = np.arange(N_HUES) * (360.0 / N_HUES)
    half = ((high - low) % 360.0) / 2
    away = np.abs((degrees - low - half + 180.0) % 360.0 - 180.0)  # from the middle of the hues
    by_hue = np.clip((half - away) / HUE_FADE_DEG + 0.5, 0.0, 1.0)
    by_saturation = np.arange(N_SATURATIONS) >= palest
    return ColourModel((255.0 * np.outer(by_hue, by_saturation)).astype(np.float32))


def colour_histogram(hsv: Image, mask: Mask) -> NDArray[np.float32]:
    """Count a region's colours in coarse bins, (30, 8)."""
    bins, ranges = [N_HUE_BINS, N_SATURATION_BINS], [0, N_HUES, 0, N_SATURATIONS]
    return np.asarray(cv2.calcHist([hsv], [0, 1], mask, bins, ranges), dtype=np.float32)


SMOOTHING_SIGMA = (2.0, 14.0)  # hue steps, DN of saturation: noise, shading and interpolated chroma
MIN_WEIGHT = 127  # of 255: a pixel above it belongs to the target rather than not
MIN_KEPT_SHARE = 0.85  # of the target, at least, by a gate of the value
MIN_GATE_GAIN = 0.1  # of the target's pixels: what a tight gate must keep out beyond what it costs
WIDE_GATE_RATIO = 0.5  # where the gate is loose, of the target's darkest pixels
MAX_VALUE = 1020.0  # DN, in the light of then: no gate, for reflections and for a light turned up


def learn_colour(hsv: Image, inside: Mask, outside: Mask) -> ColourModel:
    """Learn which colours tell a target from what is around it.

    The weight of a colour is the share of its pixels that are the target's: of those inside (h, w),
    where the target is for the most part, those outside (h, w), which surround it, and as many of
    any colour, evenly, for colours without a pixel.

    Source: the ratio histogram of Swain and Ballard, Int. J. Computer Vision 7(1), 1991, sec. 4,
    smoothed.
    """
    vivid = (hsv[..., 1] >= MIN_SATURATION) & (hsv[..., 2] >= MIN_VALUE)
    target, ground = vivid & (inside > 0), vivid & (outside > 0)
    # colour for colour, however few pixels have it: whether brightness has to tell them apart
    fair = np.count_nonzero(inside) / max(int(np.count_nonzero(outside)), 1)
    rough = _weight_colours(hsv, target, ground, fair)
    alike = rough.back_project(hsv) > MIN_WEIGHT
    value = hsv[..., 2]
    low, high = _gate(value, alike & target, alike & ground)
    gate = (value >= low) & (value <= high)
    fine = _weight_colours(hsv, target & gate, ground & gate, 1.0)
    fine = replace(fine, values=(low, high))
    weights = fine.back_project(hsv)
    own, alike = (weights > MIN_WEIGHT) & target, (weights > 0) & (inside > 0)
    mean = float(np.mean(value[alike])) if alike.any() else fine.value
    mixture = colour_histogram(hsv, np.asarray(own, dtype=np.uint8))
    mixture /= max(float(mixture.sum()), 1.0)
    return replace(fine, mixture=mixture, value=mean)


def _weight_colours(hsv: Image, target: Flags, ground: Flags, share: float) -> ColourModel:
    own, other = _count(hsv, target), _count(hsv, ground) * share
    unseen = max(int(np.count_nonzero(target)), 1) / (N_HUES * (N_SATURATIONS - MIN_SATURATION))
    weight = 255.0 * own / (own + other + unseen)
    weight[:, :MIN_SATURATION] = 0.0
    return ColourModel(weight.astype(np.float32))


def _gate(value: Image, target: Flags, alike: Flags) -> tuple[float, float]:
    """Where to cut the value: tightly where the surroundings have the colour, only darker or paler.

    Of all the cuts that keep most of the target, those that let the least of the surroundings in.
    """
    if not target.any():
        return float(MIN_VALUE), MAX_VALUE
    count = int(target.sum())
    own = np.cumsum(np.bincount(value[target], minlength=256)) / count
    other = np.cumsum(np.bincount(value[alike], minlength=256)) / count
    darker, brighter = np.concatenate([[0.0], own[:-1]]), 1.0 - own  # lost by a cut there
    gain_dark = np.concatenate([[0.0], other[:-1]]) - darker
    gain_bright = other[-1] - other - brighter
    low = int(np.argmax(np.where(darker <= 1 - MIN_KEPT_SHARE, gain_dark, -np.inf)))
    high = int(np.argmax(np.where(brighter <= 1 - MIN_KEPT_SHARE, gain_bright, -np.inf)))
    loose = WIDE_GATE_RATIO * np.quantile(value[target], 0.02)
    return (
        float(low if gain_dark[low] > MIN_GATE_GAIN else loose),
        float(high if gain_bright[high] > MIN_GATE_GAIN else MAX_VALUE),
    )


def blend(old: ColourModel, new: ColourModel, share: float) -> ColourModel:
    """Move a model towards a newer one by a share between 0 and 1."""
    if old.mixture is None or new.mixture is None:
        return old
    weight = ((1 - share) * old.weight + share * new.weight).astype(np.float32)
    mixture = ((1 - share) * old.mixture + share * new.mixture).astype(np.float32)
    return replace(old, weight=weight, mixture=mixture)


def _count(hsv: Image, where: Flags) -> Array:
    """Count a region's colours, each spread a little: (180, 256), summing to its pixels."""
    mask = np.asarray(where, dtype=np.uint8)
    counts = cv2.calcHist(
        [hsv], [0, 1], mask, [N_HUES, N_SATURATIONS], [0, N_HUES, 0, N_SATURATIONS]
    )
    margin = int(4 * SMOOTHING_SIGMA[0])  # hue goes round: the ends see each other
    around = np.vstack([counts[-margin:], counts, counts[:margin]])
    smooth = cv2.GaussianBlur(
        around,
        (0, 0),
        sigmaX=SMOOTHING_SIGMA[1],
        sigmaY=SMOOTHING_SIGMA[0],
        borderType=cv2.BORDER_REFLECT,
    )
    return smooth[margin:-margin].astype(float)
