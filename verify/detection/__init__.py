"""LED images to spots: sub-pixel centres at the Cramér-Rao bound, with covariance and flags.

Candidates are compact bright things (candidates.py). Each is fitted by a profile between a halo,
a Gaussian and a blurred disc, under the image's own noise (fit.py, profile.py, noise.py), and
judged by what the fit leaves (judgement.py). A rim with a hidden sliver has its own say on where
the whole LED is centred (bite.py).
"""

import numpy as np
from numpy.typing import NDArray

from verify.detection import kernel_judgement, kernel_noise
from verify.detection.bite import RimScore, score_rims, whole_discs
from verify.detection.candidates import DEFAULT_DIAMETER, Candidates, find_candidates
from verify.detection.fit import first_look, fit_spots
from verify.detection.judgement import FITTED, Judgement, judge
from verify.detection.kernel import SEEN
from verify.detection.kernel_pixels import MEAN, OWN, SIGNAL, USED, VISIBLE
from verify.detection.model import Fit, go_on
from verify.detection.noise import LIKELY, background_noise, refined
from verify.detection.patches import Cut, cut_out, glance_at
from verify.errors import InputError
from verify.records import Array, Image, Noise, Spots

__all__ = ["detect", "estimate_noise"]

APART = 0.5  # diameters: closer spots are one spot found twice
RESIDUAL_ROWS = (MEAN, SIGNAL, USED, VISIBLE, OWN)
Batch = tuple[Cut, Fit]


def detect(
    image: Image,
    windows: Array | None = None,
    *,
    noise: Noise | None = None,
    diameter_px: tuple[float, float] | None = None,
    limit: int = 24,
) -> Spots:
    """Find the LED-like spots of an image and measure their centres.

    Args:
        image: (h, w) grey or (h, w, 3) BGR, uint8.
        windows: (m, 4), x0, y0, x1, y1, px: search there only; None searches the whole image.
        noise: of a pixel of one channel; None estimates it on this image.
        diameter_px: plausible least and largest full width at half height; None where unknown.
        limit: how many spots to return at most, the most LED-like ones.

    Returns:
        Spots by falling peak. Those whose shape no single LED has are flagged `merged` and their
        covariance enlarged by the misfit; where a sliver of the rim may be hidden, the centre is
        the whole disc's and the covariance says how surely; spots cut by the image's border are
        left out.

    Raises:
        InputError: not an 8-bit grey or BGR image, or windows of another shape.
    """
    check(image, windows)
    candidates = find_candidates(image, inside(windows, image), diameter_px)
    background, spread = (noise, 0.0) if noise is not None else background_noise(image)
    batches = fitted(image, candidates, background, glance=windows is None)
    if not batches:
        return nothing(background)
    judgement = judge(batches, image.shape)
    if noise is None:
        background = refined(background, spread, *residuals(batches, judgement))
        for cut, state in batches:
            go_on(cut.patches, state, background, steps=1)
        judgement = judge(batches, image.shape)
    keep = led_like(judgement, diameter_px or DEFAULT_DIAMETER, limit)
    shift, doubt = whole_discs(rims(batches, judgement).taken(keep))
    kept = judgement.taken(keep)
    return Spots(
        centre=kept.centre + shift,
        covariance=kept.covariance + doubt,
        peak=kept.peak.copy(),
        diameter=kept.diameter.copy(),
        elongation=kept.elongation.copy(),
        misfit=kept.misfit.copy(),
        saturated=kept.saturated,
        merged=kept.merged,
        colour=np.concatenate([cut.colour for cut, _ in batches])[keep],
        noise=background,
    )


def led_like(
    judgement: Judgement, diameter_px: tuple[float, float], limit: int
) -> NDArray[np.intp]:
    """Choose the most LED-like ones, no more than the limit, by falling peak."""
    smallest, largest = diameter_px
    fitting = (judgement.diameter >= smallest) & (judgement.diameter <= largest)
    keep = np.flatnonzero(judgement.sound & fitting)
    found = judgement.taken(keep)
    twin = np.empty(len(keep), dtype=np.bool_)
    kernel_judgement.twins(found.told, APART, twin)
    likeness = np.where(twin, -np.inf, found.peak / (1 + found.misfit) / found.elongation)
    best = np.argsort(-likeness)[: min(limit, len(keep) - int(twin.sum()))]
    chosen: NDArray[np.intp] = keep[best[np.argsort(-found.peak[best])]]
    return chosen


def estimate_noise(image: Image) -> Noise:
    """Estimate the noise of an image: dark variance from its background, gain from its spots.

    Args:
        image: (h, w) grey or (h, w, 3) BGR, uint8.

    Returns:
        The noise of a pixel of one channel, as `detect` would use it.
    """
    return detect(image).noise


def check(image: Image, windows: Array | None) -> None:
    """Refuse what is not a picture."""
    shape_right = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if image.dtype != np.uint8 or not shape_right:
        raise InputError(
            "image",
            f"it holds {image.dtype} of shape {image.shape}",
            "an image is (height, width) or (height, width, 3), 8 bits",
            "Convert it, or set the camera to an 8-bit format.",
        )
    if windows is not None and (np.ndim(windows) != 2 or np.shape(windows)[1] != 4):
        raise InputError(
            "windows", f"their shape is {np.shape(windows)}", "one row x0, y0, x1, y1 a window"
        )


def inside(windows: Array | None, image: Image) -> NDArray[np.int64] | None:
    """Windows in whole pixels, cut at the image's border."""
    if windows is None:
        return None
    height, width = image.shape[:2]
    low, high = np.floor(windows[:, :2]), np.ceil(windows[:, 2:])
    whole = np.hstack([low, high]).clip(0, [width, height, width, height])
    return whole.astype(np.int64)


def fitted(image: Image, candidates: Candidates, noise: Noise, *, glance: bool) -> list[Batch]:
    """Fit the candidates, on a glance only those in which a first look sees a spot."""
    if not len(candidates):
        return []
    if not glance:
        return [(cut, fit_spots(cut.patches)) for _, cut in cut_out(image, candidates, noise)]
    first = glance_at(image, candidates, noise)
    look = first_look(first.patches)
    seen = np.flatnonzero(judge([(first, look)], image.shape).sound)
    start = look.parameters[seen]
    return [
        (cut, fit_spots(cut.patches, start[part]))
        for part, cut in cut_out(image, candidates.taken(seen), noise)
    ]


def residuals(batches: list[Batch], judgement: Judgement) -> tuple[Array, Array, NDArray[np.intp]]:
    """Squared residuals and signals on and around the brightest spots, for `refined`."""
    places = [(batch, row) for batch in batches for row in range(len(batch[0].origin))]
    brightness = np.where(judgement.sound, judgement.peak / judgement.elongation, -np.inf)
    order = np.argsort(-brightness, kind="stable")[: int(judgement.sound.sum())].tolist()
    room = sum(cut.patches.pixels.shape[2] * len(cut.origin) for cut, _ in batches)
    gathered = np.empty(room), np.empty(room), np.empty(room, dtype=np.intp)
    at = spots = 0
    for place in order:
        (cut, state), row = places[place]
        patches = cut.patches
        shares = float(patches.read_share[row]), float(patches.gain_share[row])
        before, at = at, kernel_noise.gather_residuals(
            patches.pixels[row], state.known[row], shares, RESIDUAL_ROWS, (SEEN, float(FITTED)),
            gathered, at, spots,
        )  # fmt: skip
        spots += at > before
        if spots == LIKELY:
            break
    squares, signals, spot = gathered
    return squares[:at], signals[:at], spot[:at]


def rims(batches: list[Batch], judgement: Judgement) -> RimScore:
    """What every spot's rim says of a bite, if it shows the shape of one LED."""
    single = judgement.sound & ~judgement.saturated & ~judgement.merged
    misfit = judgement.misfit.copy()
    scores, begin = [], 0
    for cut, state in batches:
        end = begin + len(cut.origin)
        scores.append(score_rims(state, single[begin:end], misfit[begin:end]))
        begin = end
    return RimScore(
        gradient=np.concatenate([score.gradient for score in scores]),
        information=np.concatenate([score.information for score in scores]),
        pull=np.concatenate([score.pull for score in scores]),
    )


def nothing(noise: Noise) -> Spots:
    """No spots."""
    none, no = np.empty(0), np.empty(0, dtype=bool)
    return Spots(
        np.empty((0, 2)),
        np.empty((0, 2, 2)),
        none,
        none,
        none,
        none,
        no,
        no,
        np.empty((0, 3)),
        noise,
    )
