"""Detect LED spots in an image: sub-pixel centres at the Cramér-Rao bound, with covariance.

Candidates are compact bright blobs (candidates.py). Each is fitted by a profile between a halo, a
Gaussian and a blurred disc (fit.py, profile.py) under the image's own noise (noise.py), and
assessed by the residuals (kernels/quality.py). A hidden sliver of the rim is corrected for
(occlusion.py), and so is a background that bends (background.py).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from verify.core.records import Array, Image, Noise, Spots, take_rows
from verify.errors import InputError
from verify.measurement.detection.background import correct_for_background
from verify.measurement.detection.candidates import (
    DEFAULT_DIAMETER,
    Candidates,
    LocatedPatches,
    cut_first_look,
    cut_patches,
    find_candidates,
    separate_neighbours,
)
from verify.measurement.detection.fit import (
    TOL_LAST_STEP,
    SpotFit,
    continue_fit,
    first_look,
    fit_spots,
)
from verify.measurement.detection.kernels import quality
from verify.measurement.detection.kernels.noise import gather_residuals
from verify.measurement.detection.kernels.quality import (
    COL_CENTRE_X,
    COL_CENTRE_Y,
    COL_COUNT,
    COL_COVARIANCE_XX,
    COL_COVARIANCE_YY,
    COL_DIAMETER,
    COL_ELONGATION,
    COL_MERGED,
    COL_MISFIT,
    COL_PEAK,
    COL_SATURATED,
    COL_SOUND,
)
from verify.measurement.detection.noise import background_noise, refine_noise
from verify.measurement.detection.occlusion import unoccluded_centres

CENTRE = slice(COL_CENTRE_X, COL_CENTRE_Y + 1)
COVARIANCE = slice(COL_COVARIANCE_XX, COL_COVARIANCE_YY + 1)
MAX_NOISE_SPOTS = 8  # spots whose residuals show the noise, brightest first: then come glints
MAX_CLEAN_ELONGATION = 1.2  # of spots whose light is taken off others: glints are longer
Batch = tuple[LocatedPatches, SpotFit]


def detect(
    image: Image,
    windows: Array | None = None,
    *,
    noise: Noise | None = None,
    diameter_px: tuple[float, float] | None = None,
    limit: int = 24,
    lossy: bool = False,
) -> Spots:
    """Find the LED-like spots of an image and measure their centres.

    `image`: (h, w) grey or (h, w, 3) BGR, uint8. `windows` (m, 4), x0, y0, x1, y1, px: search there
    only. `noise` is of a pixel of one channel; None estimates it on this image. `diameter_px`:
    plausible least and largest full width at half height. At most `limit` spots are returned, the
    most LED-like ones. `lossy`: the image was a JPEG, whose errors are not white.

    Returns:
        Spots by falling peak. Those whose shape no single LED has are flagged `merged` and their
        covariance enlarged by the misfit; where a sliver of the rim may be hidden, the centre is
        the whole disc's, as it is where the background bends, and the covariance covers the
        correction; spots cut by the image's border are left out.

    Raises:
        InputError: not an 8-bit grey or BGR image, or windows of another shape.
    """
    check_image(image, windows)
    candidates = find_candidates(image, clip_windows(windows, image), diameter_px)
    background, spread = (noise, 0.0) if noise is not None else background_noise(image, lossy=lossy)
    batches = fit_candidates(image, candidates, background, glance=windows is None)
    if not batches:
        return no_spots(background)
    if noise is None:
        assessed = assess_spots(batches, image.shape)
        background = refine_noise(background, spread, *spot_residuals(batches, assessed))
    for cut, fit in batches:
        continue_fit(cut.patches, fit, background, 2, TOL_LAST_STEP)
    assessed = assess_spots(batches, image.shape, lossy=lossy)
    clean = (assessed[:, COL_SOUND] > 0) & (assessed[:, COL_MERGED] == 0)
    clean &= assessed[:, COL_ELONGATION] < MAX_CLEAN_ELONGATION
    if separate_neighbours(batches, clean, background):
        assessed = assess_spots(batches, image.shape, lossy=lossy)
    kept = choose_spots(assessed, diameter_px or DEFAULT_DIAMETER, limit)
    colour = np.concatenate([cut.colour for cut, _ in batches])[kept]
    assessed = assessed[kept]
    if lossy:
        assessed[:, COVARIANCE] *= quality.lossy_scale(assessed)[:, None]
    quality.doubt_shapes(assessed)
    shift, covariance = unoccluded_centres([fit for _, fit in batches], kept, assessed)
    one_led = np.where(assessed[:, COL_MERGED] > 0, -1, kept)
    curvature_shift, curvature_covariance = correct_for_background(
        image, candidates, batches, one_led
    )
    return Spots(
        centre=assessed[:, CENTRE] + shift + curvature_shift,
        covariance=assessed[:, COVARIANCE].reshape(-1, 2, 2) + covariance + curvature_covariance,
        peak=assessed[:, COL_PEAK].copy(),
        diameter=assessed[:, COL_DIAMETER].copy(),
        elongation=assessed[:, COL_ELONGATION].copy(),
        misfit=assessed[:, COL_MISFIT].copy(),
        saturated=assessed[:, COL_SATURATED] > 0,
        merged=assessed[:, COL_MERGED] > 0,
        colour=colour,
        noise=background,
    )


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
    sound = np.flatnonzero(assess_spots([(first, look)], image.shape)[:, COL_SOUND])
    start = look.parameters[sound]
    return [
        (cut, fit_spots(cut.patches, start[part]))
        for part, cut in cut_patches(image, take_rows(candidates, sound), noise)
    ]


def assess_spots(batches: Sequence[Batch], shape: tuple[int, ...], *, lossy: bool = False) -> Array:
    """Assess fits, (n, 16), columns as in kernels/quality.py; `shape` is the image's."""
    excess = 0.0 if lossy else quality.CORRELATED_PIXELS
    return np.concatenate(
        [
            quality.assess_all(
                fit.parameters, fit.information, cut.patches.pixels, fit.model, cut.patches.scale,
                cut.origin, (shape[1], shape[0]), excess,
            )
            for cut, fit in batches
        ]
    )  # fmt: skip


def spot_residuals(
    batches: Sequence[Batch], assessed: Array
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Squared residuals and signals on and around the brightest spots, for `refine_noise`."""
    own, number = assessed[:, COL_COUNT].copy(), number_brightest(assessed)
    begin, parts = 0, []
    for cut, fit in batches:
        patches, end = cut.patches, begin + len(cut.origin)
        shares = patches.read_share, patches.gain_share
        parts.append(
            gather_residuals(patches.pixels, fit.model, shares, own[begin:end], number[begin:end])
        )
        begin = end
    squares, signals, spot = (np.concatenate(column) for column in zip(*parts, strict=True))
    return squares, signals, spot


def number_brightest(assessed: Array) -> NDArray[np.int64]:
    """Number the brightest of n spots that show the noise, brightest first, from 0; others -1."""
    shows_noise = (assessed[:, COL_SOUND] > 0) & (assessed[:, COL_COUNT] > 2 * quality.N_FITTED)
    spots = np.flatnonzero(shows_noise)
    brightness = assessed[spots, COL_PEAK] / assessed[spots, COL_ELONGATION]
    brightest = spots[np.argsort(-brightness, kind="stable")[:MAX_NOISE_SPOTS]]
    number = np.full(len(assessed), -1)
    number[brightest] = np.arange(len(brightest))
    return number


def choose_spots(
    assessed: Array, diameter_px: tuple[float, float], limit: int
) -> NDArray[np.int64]:
    """Choose the most LED-like of n spots, no more than the limit, by falling peak."""
    width = assessed[:, COL_DIAMETER]
    fits = (diameter_px[0] <= width) & (width <= diameter_px[1])
    sound = np.flatnonzero((assessed[:, COL_SOUND] > 0) & fits)
    single = sound[~quality.mark_duplicates(assessed[sound])]
    rows = assessed[single]
    rank = -rows[:, COL_PEAK] / (1.0 + rows[:, COL_MISFIT])
    rank /= rows[:, COL_ELONGATION]
    best = single[np.argsort(rank, kind="stable")[:limit]]
    return best[np.argsort(-assessed[best, COL_PEAK], kind="stable")]


def no_spots(noise: Noise) -> Spots:
    """No spots."""
    none, no = np.empty(0), np.empty(0, dtype=bool)
    shapes = np.empty((0, 2)), np.empty((0, 2, 2))
    return Spots(*shapes, none, none, none, none, no, no, np.empty((0, 3)), noise)
