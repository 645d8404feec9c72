"""LED images to spots: sub-pixel centres at the Cramér-Rao bound, with covariance and flags.

Candidates are compact bright things (candidates.py). Each is fitted by a profile between a halo,
a Gaussian and a blurred disc, under the image's own noise (fit.py, profile.py, noise.py), and
judged by what the fit leaves (judgement.py). A rim with a hidden sliver has its own say on where
the whole LED is centred (bite.py).
"""

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Image, Noise, Spots
from verify.errors import InputError
from verify.measurement.detection.candidates import (
    DEFAULT_DIAMETER,
    Candidates,
    LocatedPatches,
    cut_first_look,
    cut_patches,
    find_candidates,
)
from verify.measurement.detection.fit import (
    TOL_LAST_STEP,
    SpotFit,
    continue_fit,
    first_look,
    fit_spots,
)
from verify.measurement.detection.kernels import noise as kernels_noise
from verify.measurement.detection.kernels.fit import MIN_NOISE_SHARE
from verify.measurement.detection.kernels.pixels import (
    ROW_CORE,
    ROW_MEAN,
    ROW_SIGNAL,
    ROW_USED,
    ROW_VISIBLE,
)
from verify.measurement.detection.noise import MAX_SPOTS, background_noise, refine_noise
from verify.measurement.detection.occlusion import (
    RimScore,
    no_rim_scores,
    score_directions,
    unoccluded_centres,
)
from verify.measurement.detection.quality import (
    N_FITTED,
    SpotQuality,
    assess_spots,
    choose_spots,
    number_brightest,
)

__all__ = ["detect", "estimate_noise"]

MIN_SEPARATION = 0.5  # diameters: closer spots are one spot found twice
RESIDUAL_ROWS = (ROW_MEAN, ROW_SIGNAL, ROW_USED, ROW_VISIBLE, ROW_CORE)
Batch = tuple[LocatedPatches, SpotFit]


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
    check_image(image, windows)
    candidates = find_candidates(image, clip_windows(windows, image), diameter_px)
    background, spread = (noise, 0.0) if noise is not None else background_noise(image)
    batches = fit_candidates(image, candidates, background, glance=windows is None)
    if not batches:
        return no_spots(background)
    if noise is None:
        seen = assess_spots(batches, image.shape)
        background = refine_noise(background, spread, *spot_residuals(batches, seen))
    for cut, state in batches:
        continue_fit(cut.patches, state, background, 2, TOL_LAST_STEP)
    judgement = assess_spots(batches, image.shape)
    keep = select_led_like(judgement, diameter_px or DEFAULT_DIAMETER, limit)
    kept = judgement.taken(keep)
    shift, doubt = unoccluded_centres(score_rims(batches, kept, keep))
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


def select_led_like(
    judgement: SpotQuality, diameter_px: tuple[float, float], limit: int
) -> NDArray[np.int64]:
    """Choose the most LED-like ones, no more than the limit, by falling peak."""
    return choose_spots(judgement, diameter_px, MIN_SEPARATION, limit)


def estimate_noise(image: Image) -> Noise:
    """Estimate the noise of an image: dark variance from its background, gain from its spots.

    Args:
        image: (h, w) grey or (h, w, 3) BGR, uint8.

    Returns:
        The noise of a pixel of one channel, as `detect` would use it.
    """
    return detect(image).noise


def check_image(image: Image, windows: Array | None) -> None:
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


def clip_windows(windows: Array | None, image: Image) -> NDArray[np.int64] | None:
    """Windows in whole pixels, cut at the image's border."""
    if windows is None:
        return None
    height, width = image.shape[:2]
    cut = np.clip(np.asarray(windows, dtype=float), 0.0, (width, height, width, height))
    cut[:, 2:] = np.ceil(cut[:, 2:])
    return np.asarray(cut, dtype=np.int64)


def fit_candidates(
    image: Image, candidates: Candidates, noise: Noise, *, glance: bool
) -> list[Batch]:
    """Fit the candidates, on a glance only those in which a first look sees a spot."""
    if not len(candidates):
        return []
    if not glance:
        return [(cut, fit_spots(cut.patches)) for _, cut in cut_patches(image, candidates, noise)]
    first = cut_first_look(image, candidates, noise)
    look = first_look(first.patches)
    seen = np.flatnonzero(assess_spots([(first, look)], image.shape).sound)
    start = look.parameters[seen]
    return [
        (cut, fit_spots(cut.patches, start[part]))
        for part, cut in cut_patches(image, candidates.taken(seen), noise)
    ]


def spot_residuals(
    batches: list[Batch], judgement: SpotQuality
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Squared residuals and signals on and around the brightest spots, for `refine_noise`."""
    own, number = judgement.own.copy(), number_brightest(judgement, 2.0 * N_FITTED, MAX_SPOTS)
    room = sum(cut.patches.value.size for cut, _ in batches)
    gathered, begin, at = (np.empty(room), np.empty(room), np.empty(room, dtype=np.intp)), 0, 0
    for cut, state in batches:
        patches, end = cut.patches, begin + len(cut.origin)
        at = kernels_noise.gather_residuals(
            patches.pixels, state.known, (patches.read_share, patches.gain_share), RESIDUAL_ROWS,
            (MIN_NOISE_SHARE, float(N_FITTED)), own[begin:end], number[begin:end], gathered, at,
        )  # fmt: skip
        begin = end
    squares, signals, spot = gathered
    return squares[:at], signals[:at], spot[:at]


def score_rims(batches: list[Batch], kept: SpotQuality, keep: NDArray[np.int64]) -> RimScore:
    """What the rims of the spots kept, by number, say of a bite, if they show one LED's shape."""
    score, begin = no_rim_scores(len(keep)), 0
    for cut, state in batches:
        score_directions(state, keep - begin, kept, score)
        begin += len(cut.origin)
    return score


def no_spots(noise: Noise) -> Spots:
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
