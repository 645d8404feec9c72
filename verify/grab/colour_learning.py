"""Learning a target's colours from pixels that show it, against those around it."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from verify.grab.colour import DARKEST, HUES, PALEST, SATURATIONS, ColourModel, Mask, mixture
from verify.records import Array, Image

SPREAD = (2.0, 14.0)  # hue steps, DN of saturation: noise, shading and interpolated chroma
LIKELY = 127  # of 255
KEPT = 0.85  # of the target, at least, by a gate of the value
WORTH = 0.1  # of the target's pixels: what a tight gate must keep out beyond what it costs
WIDE = 0.5  # where the gate is loose, of the target's darkest pixels
BRIGHTEST = 1020.0  # DN, in the light of then: no gate, for reflections and for a light turned up
Marked = NDArray[np.bool_]  # (h, w)


def learn(hsv: Image, inside: Mask, outside: Mask) -> ColourModel:
    """Learn which colours tell a target from what is around it.

    The weight of a colour is the share of its pixels that are the target's: of those inside, those
    outside, and as many of any colour, evenly, for what nobody has seen yet.

    Args:
        hsv: (h, w, 3).
        inside: (h, w), where the target is, for the most part.
        outside: (h, w), what surrounds it.

    Source: the ratio histogram of Swain and Ballard, Int. J. Computer Vision 7(1), 1991, sec. 4,
    smoothed.
    """
    vivid = (hsv[..., 1] >= PALEST) & (hsv[..., 2] >= DARKEST)
    target, ground = vivid & (inside > 0), vivid & (outside > 0)
    # colour for colour, however few pixels have it: whether brightness has to tell them apart
    fair = np.count_nonzero(inside) / max(int(np.count_nonzero(outside)), 1)
    rough = _weigh(hsv, target, ground, fair)
    alike = rough.back_project(hsv) > LIKELY
    value = hsv[..., 2]
    low, high = _gate(value, alike & target, alike & ground)
    gate = (value >= low) & (value <= high)
    fine = _weigh(hsv, target & gate, ground & gate, 1.0)
    fine = replace(fine, values=(low, high))
    own = (fine.back_project(hsv) > LIKELY) & target
    middle = float(np.median(value[own])) if own.any() else fine.value
    return replace(fine, mixture=mixture(hsv, np.asarray(own, dtype=np.uint8)), value=middle)


def _weigh(hsv: Image, target: Marked, ground: Marked, share: float) -> ColourModel:
    own, other = _count(hsv, target), _count(hsv, ground) * share
    unseen = max(int(np.count_nonzero(target)), 1) / (HUES * (SATURATIONS - PALEST))
    weight = 255.0 * own / (own + other + unseen)
    weight[:, :PALEST] = 0.0
    return ColourModel(weight.astype(np.float32))


def _gate(value: Image, target: Marked, alike: Marked) -> tuple[float, float]:
    """Where to cut the value: tightly where the surroundings have the colour, only darker or paler.

    Of all the cuts that keep most of the target, those that let the least of the surroundings in.
    """
    if not target.any():
        return float(DARKEST), BRIGHTEST
    count = int(target.sum())
    own = np.cumsum(np.bincount(value[target], minlength=256)) / count
    other = np.cumsum(np.bincount(value[alike], minlength=256)) / count
    darker, brighter = np.concatenate([[0.0], own[:-1]]), 1.0 - own  # lost by a cut there
    gain_dark = np.concatenate([[0.0], other[:-1]]) - darker
    gain_bright = other[-1] - other - brighter
    low = int(np.argmax(np.where(darker <= 1 - KEPT, gain_dark, -np.inf)))
    high = int(np.argmax(np.where(brighter <= 1 - KEPT, gain_bright, -np.inf)))
    loose = WIDE * np.quantile(value[target], 0.02)
    return (
        float(low if gain_dark[low] > WORTH else loose),
        float(high if gain_bright[high] > WORTH else BRIGHTEST),
    )


def blend(old: ColourModel, new: ColourModel, share: float) -> ColourModel:
    """Move a model towards what was seen last by a share between 0 and 1."""
    if old.mixture is None or new.mixture is None:
        return old
    weight = ((1 - share) * old.weight + share * new.weight).astype(np.float32)
    return replace(old, weight=weight, mixture=(1 - share) * old.mixture + share * new.mixture)


def _count(hsv: Image, where: Marked) -> Array:
    """Count a region's colours, each spread a little: (180, 256), summing to its pixels."""
    mask = np.asarray(where, dtype=np.uint8)
    counts = cv2.calcHist([hsv], [0, 1], mask, [HUES, SATURATIONS], [0, HUES, 0, SATURATIONS])
    margin = int(4 * SPREAD[0])  # hue goes round: the ends see each other
    around = np.vstack([counts[-margin:], counts, counts[:margin]])
    smooth = cv2.GaussianBlur(
        around, (0, 0), sigmaX=SPREAD[1], sigmaY=SPREAD[0], borderType=cv2.BORDER_REFLECT
    )
    found: Array = smooth[margin:-margin].astype(float)
    return found
