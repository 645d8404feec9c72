"""LED images to spots: sub-pixel centres at the Cramér-Rao bound, with covariance and flags.

Candidates are compact bright things (candidates.py). Each is fitted by a profile between a halo,
a Gaussian and a blurred disc, under the image's own noise (fit.py, profile.py, noise.py), and
judged by what the fit leaves (judgement.py). A rim with a hidden sliver has its own say on where
the whole LED is centred (bite.py).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from verify.detection import kernel_judgement, kernel_noise
from verify.detection.bite import RimScore, score_rims, whole_discs
from verify.detection.candidates import DEFAULT_DIAMETER, Candidates, find_candidates
from verify.detection.fit import first_look, fit_spots
from verify.detection.judgement import FITTED, Judgement, joined, judge
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
    judgements = [judge(cut, state, image.shape) for cut, state in batches]
    if noise is None:
        background = refined(background, spread, *residuals(batches, judgements))
        batches = [renewed(batch, background) for batch in batches]
        judgements = [judge(cut, state, image.shape) for cut, state in batches]
    judgement = joined(judgements)
    smallest, largest = diameter_px or DEFAULT_DIAMETER
    fitting = (judgement.diameter >= smallest) & (judgement.diameter <= largest)
    keep = np.flatnonzero(judgement.sound & fitting)
    keep = keep[without_twins(judgement, keep)]
    likeness = judgement.peak[keep] / (1 + judgement.misfit[keep]) / judgement.elongation[keep]
    keep = keep[np.argsort(-likeness)[:limit]]
    keep = keep[np.argsort(-judgement.peak[keep])]
    shift, doubt = whole_discs(rims(batches, judgements).taken(keep))
    return Spots(
        centre=judgement.centre[keep] + shift,
        covariance=judgement.covariance[keep] + doubt,
        peak=judgement.peak[keep],
        diameter=judgement.diameter[keep],
        elongation=judgement.elongation[keep],
        misfit=judgement.misfit[keep],
        saturated=judgement.saturated[keep],
        merged=judgement.merged[keep],
        colour=np.concatenate([cut.colour for cut, _ in batches])[keep],
        noise=background,
    )


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
    seen = np.flatnonzero(judge(first, look, image.shape).sound)
    start = look.parameters[seen]
    return [
        (cut, fit_spots(cut.patches, start[part]))
        for part, cut in cut_out(image, candidates.taken(seen), noise)
    ]


def residuals(
    batches: list[Batch], judgements: list[Judgement]
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Squared residuals and signals on and around the brightest spots, for `refined`."""
    speakers: list[tuple[float, Batch, np.intp]] = []
    for batch, judgement in zip(batches, judgements, strict=True):
        brightness = judgement.peak / judgement.elongation
        speakers += [
            (float(brightness[row]), batch, row) for row in np.flatnonzero(judgement.sound)
        ]
    squares, signals = [], []
    for _, (cut, state), row in sorted(speakers, key=lambda speaker: -speaker[0]):
        patches = cut.patches
        square, signal = np.empty(patches.value.shape[1]), np.empty(patches.value.shape[1])
        shares = np.array([patches.read_share[row], patches.gain_share[row]])
        pixels, own = kernel_noise.gather_residuals(
            patches.value[row], state.known[row], shares, RESIDUAL_ROWS, (SEEN, float(FITTED)),
            square, signal,
        )  # fmt: skip
        if own > 2 * FITTED:
            squares.append(square[:pixels])
            signals.append(signal[:pixels])
        if len(squares) == LIKELY:
            break
    spot = np.repeat(np.arange(len(squares)), [len(s) for s in squares])
    return np.concatenate([*squares, []]), np.concatenate([*signals, []]), spot


def renewed(batch: Batch, noise: Noise) -> Batch:
    """Take a batch's fit, which is written over, one step further under better known noise."""
    cut, state = batch
    cut = replace(cut, patches=replace(cut.patches, noise=noise))
    go_on(cut.patches, state, steps=1)
    return cut, state


def rims(batches: list[Batch], judgements: list[Judgement]) -> RimScore:
    """What every spot's rim says of a bite."""
    scores = [
        score_rims(state, single(judgement), judgement.misfit)
        for (_, state), judgement in zip(batches, judgements, strict=True)
    ]
    return RimScore(
        gradient=np.concatenate([score.gradient for score in scores]),
        information=np.concatenate([score.information for score in scores]),
        pull=np.concatenate([score.pull for score in scores]),
    )


def single(judgement: Judgement) -> NDArray[np.bool_]:
    """Which spots show the shape of one LED, perhaps with a part hidden."""
    which: NDArray[np.bool_] = judgement.sound & ~judgement.saturated & ~judgement.merged
    return which


def without_twins(judgement: Judgement, keep: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which of the kept spots are not another, better fitting one found twice."""
    twin = np.empty(len(keep), dtype=np.bool_)
    kernel_judgement.twins(
        judgement.centre[keep], judgement.diameter[keep], judgement.misfit[keep], APART, twin
    )
    return ~twin


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
