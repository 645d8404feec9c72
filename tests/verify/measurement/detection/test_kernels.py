"""What detection has compiled, against OpenCV, numpy and the formulas themselves.

Pixels near a limit of the sensor, against numerical integration of the clipped normal law.
"""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.integrate import quad
from scipy.signal import savgol_filter
from scipy.stats import norm

from tests.support.kernels import (
    CLASS_PARTS,
    FIRST_LEVEL,
    LEVEL_PARTS,
    LOWEST_LEVEL,
    N_CLASSES,
    N_DIFFERENCES,
    N_LEVELS,
    choose_spots,
    clip,
    count_stencils,
    flood_fill,
    top_hat,
    variance_line,
)
from verify.core.records import Image
from verify.measurement.detection.kernels.entries import (
    COL_CENTRE_X,
    COL_DIAMETER,
    COL_ELONGATION,
    COL_MERGED,
    COL_MISFIT,
    COL_PEAK,
    COL_SOUND,
    N_COLUMNS,
    BlobSearch,
    contrast_boxes,
    find_blobs,
)


def cloud(seed: int, blur: float) -> Image:
    """Bright islands, some with holes, some at the border."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(40, 50)), (0, 0), blur)
    stretched = 255 * (noise - noise.min()) / np.ptp(noise)
    return np.asarray(np.clip(1.5 * stretched - 120, 0, 255), np.uint8)


@pytest.mark.parametrize("level", [60, 120, 200])
@pytest.mark.parametrize("seed", range(10))
def test_regions_above_a_level_are_opencvs_connected_components(seed: int, level: int) -> None:
    picture = cloud(seed, 1.0)
    label = np.zeros(picture.shape, np.int32)
    _, expected, stats, _ = cv2.connectedComponentsWithStats(np.asarray(picture > level, np.uint8))
    for number, (x, y, width, height, area) in enumerate(stats[1:].tolist(), start=1):
        row, column = np.argwhere(expected == number)[-1]
        box = flood_fill(picture, level, row, column, label, number)
        assert box == (x, y, x + width - 1, y + height - 1)
        assert np.sum(label == number) == area
    np.testing.assert_array_equal(label, expected)


def test_a_blob_is_found_once_at_its_highest_level_and_where_it_is_in_the_picture() -> None:
    picture = np.zeros((60, 90), np.uint8)
    for (x, y), peak in [((20, 30), 220.0), ((60, 25), 50.0)]:
        column, row = np.meshgrid(np.arange(90) - x, np.arange(60) - y)
        picture += np.asarray(peak * np.exp(-(column**2 + row**2) / 18), np.uint8)
    windows = np.array([[10, 15, 80, 55], [5, 5, 7, 50]])
    levels = np.array([160, 80, 40, 18])
    search = BlobSearch(30, levels, (99.0, 99.0, 2.5, 0.6), 9)
    blobs = find_blobs(picture, windows, 0, search)
    np.testing.assert_allclose(blobs[:, :2], [[20, 30], [60, 25]], atol=0.1)
    np.testing.assert_array_equal(blobs[:, 3], [220, 50])
    # of more than are listed, the brightest
    blobs = find_blobs(picture, windows, 0, search._replace(most=1))
    np.testing.assert_array_equal(blobs[:, 3], [220])


def test_a_dim_blob_beside_a_bright_one_is_measured_by_its_own_pixels() -> None:
    """Parts of the bright one are within its box, and the margin about that."""
    column, row = np.meshgrid(np.arange(60), np.arange(40))
    picture = np.zeros((40, 60), np.uint8)
    picture[np.hypot(column - 20, row - 20) < 7] = 230
    dim = (np.hypot(column - 31, row - 27) < 5) & (picture == 0)
    picture[dim & (np.hypot(column - 20, row - 20) > 8.5)] = 60
    search = BlobSearch(30, np.array([160, 80, 40, 18]), (99.0, 99.0, 2.5, 0.6), 9)
    blobs = find_blobs(picture, np.array([[0, 0, 60, 40]]), 0, search)
    places = [(np.mean(x), np.mean(y)) for y, x in map(np.nonzero, (picture == 230, picture == 60))]
    np.testing.assert_allclose(blobs[:, :2], places, atol=1e-9)
    np.testing.assert_array_equal(blobs[:, 3], [230, 60])


@pytest.mark.parametrize("width", [5, 67, 68, 69, 300])
@pytest.mark.parametrize("mean", [0.0, 1.5, 100.0, 254.0])
def test_levels_and_differences_are_those_of_unclipped_neighbours(width: int, mean: float) -> None:
    rng = np.random.default_rng(width)
    rows = rng.normal(mean, 2.0, (7, width)).clip(0, 255).astype(np.uint8)
    whole = rows.astype(float)
    inside = (rows > 0) & (rows < 255)
    clean = np.lib.stride_tricks.sliding_window_view(inside, 5, axis=1).all(axis=2)
    levels = np.zeros(N_LEVELS, np.int32)
    differences = np.zeros((N_CLASSES, N_DIFFERENCES), np.int32)
    assert count_stencils(rows, 1, levels, differences) == clean.size
    cubic = savgol_filter(whole, 5, 3, axis=1)[:, 2:-2][clean]
    level = np.rint(LEVEL_PARTS * cubic).astype(int) + LOWEST_LEVEL
    assert_array_equal(levels, np.bincount(level, minlength=N_LEVELS))
    expected, size = np.zeros_like(differences), np.abs(np.diff(whole, 4, axis=1))[clean]
    part = (level - FIRST_LEVEL) // CLASS_PARTS
    known = (part >= 0) & (part < N_CLASSES)
    np.add.at(expected, (part[known], size[known].astype(int)), 1)
    assert_array_equal(differences, expected)


@pytest.mark.parametrize("reach", [3, 15, 30])
def test_no_contrast_is_outside_the_boxes_that_are_searched(reach: int) -> None:
    rng = np.random.default_rng(reach)
    boxes, window = 0, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    for turn in range(30):
        height, width = rng.integers(3, 150 + 25 * reach, 2)
        picture = rng.integers(0, 12, (height, width)).astype(np.uint8)
        picture += rng.integers(0, 60, picture.shape, np.uint8) * (turn % 3 == 2)
        for x, y in rng.integers(0, [width, height], (3, 2)).tolist():
            cv2.circle(picture, (x, y), int(rng.integers(1, 6)), int(rng.integers(20, 255)), -1)
        contrast = cv2.morphologyEx(picture, cv2.MORPH_TOPHAT, window)
        covered = np.zeros(picture.shape, np.uint8)
        for x0, y0, x1, y1 in contrast_boxes(picture, reach, 18).tolist():
            covered[y0:y1, x0:x1] += 1
            boxes += 1
        assert covered.max(initial=0) <= 1
        assert contrast[covered == 0].max(initial=0) <= 18
    assert boxes > 30  # not the whole picture each time


def test_a_small_spot_that_fits_by_chance_is_no_noise_estimate() -> None:
    rng = np.random.default_rng(3)
    count = [90, 90, 90, 90, 18]
    spot, begin = np.repeat(np.arange(5), count), np.cumsum([0, *count])
    signal = rng.uniform(0.0, 200.0, len(spot))
    variance = np.where(spot < 4, 6.0 + 0.04 * signal, 0.5)
    line = np.array([2.25, 0.03])
    usual = np.array([1 / 2.25, 1 / 0.03])
    squares = variance * rng.standard_normal(len(spot)) ** 2
    variance_line(squares, signal, begin, line, usual)
    assert line[0] == pytest.approx(6.0, rel=0.4)


@pytest.mark.parametrize("reach", [1, 4, 15, 30])
def test_pixels_above_their_surroundings_agree_with_opencv(reach: int) -> None:
    """Pictures smaller than the square, as large, and several times as large; borders included.

    All of a picture, and a window of it with what is about it.
    """
    rng = np.random.default_rng(reach)
    side = 2 * reach + 1
    sizes = [(1, 1), (side, side), (side + 1, side - 1), *rng.integers(1, 4 * side, (40, 2))]
    nearly_black = rng.poisson(0.3, (70, 90)).astype(np.uint8)
    nearly_black[20:30, 40:52] = 200
    for image in [nearly_black, *(rng.integers(0, 256, size).astype(np.uint8) for size in sizes)]:
        height, width = image.shape
        expected = cv2.morphologyEx(image, cv2.MORPH_TOPHAT, np.ones((side, side), np.uint8))
        assert_array_equal(top_hat(image, (0, 0, width, height), 0, reach), expected)
        (x0, x1), (y0, y1) = (np.sort(rng.choice(n + 1, 2, replace=False)) for n in (width, height))
        contrast = top_hat(image, (int(x0), int(y0), int(x1), int(y1)), 2 * reach, reach)
        assert_array_equal(contrast, expected[y0:y1, x0:x1])


LIMIT = 255.0
ROUNDING = 2.0**-22  # of single precision, in which pixels are weighed


def clipped_by_integration(mu: float, sigma: float) -> tuple[float, float, float]:
    """Mean, variance and share in range of a normal variable that a sensor clips to 0 … 255."""
    law = norm(mu, sigma)
    below, above = law.cdf(0.0), law.sf(LIMIT)
    reach = (max(0.0, mu - 12 * sigma), min(LIMIT, mu + 12 * sigma))
    if reach[0] >= reach[1]:
        return (0.0 if mu < 0 else LIMIT), 0.0, 0.0
    first = quad(lambda x: x * law.pdf(x), *reach, epsabs=1e-13)[0] + LIMIT * above
    mean = float(first)
    second = quad(lambda x: (x - mean) ** 2 * law.pdf(x), *reach, epsabs=1e-13)[0]
    variance = second + mean**2 * below + (LIMIT - mean) ** 2 * above
    return mean, float(variance), 1.0 - below - above


def clipped(mu: float, variance: float) -> tuple[float, float, float]:
    """Mean, variance and d mean / d mu, one pixel among others."""
    means = np.array([128.0, mu, 3.0], np.float32)
    variances, visible = np.array([4.0, variance, 2.0], np.float32), np.empty(3, np.float32)
    clip(means, variances, visible)
    return float(means[1]), float(variances[1]), float(visible[1])


@pytest.mark.parametrize("sigma", [0.4, 1.5, 4.0])
@pytest.mark.parametrize("z", [-100.0, -7.0, -4.0, -1.1, -0.3, 0.0, 0.6, 2.0, 4.3, 32.0])
@pytest.mark.parametrize("top", [False, True], ids=["black", "full"])
def test_moments_are_those_of_the_clipped_law(z: float, sigma: float, top: bool) -> None:
    mu = float(np.float32(LIMIT - z * sigma if top else z * sigma))
    own = float(np.float32(sigma**2))
    mean, variance, share = clipped(mu, own)
    true_mean, true_variance, true_share = clipped_by_integration(mu, own**0.5)
    assert mean == pytest.approx(true_mean, abs=ROUNDING * (LIMIT if top else max(true_mean, 1.0)))
    assert share == pytest.approx(true_share, abs=ROUNDING)
    near, room = max(true_variance, 1 / 12), LIMIT - true_mean if top else true_mean
    assert variance == pytest.approx(near, abs=ROUNDING * (own + room**2))  # or whole numbers'


@pytest.mark.parametrize(
    ("merged", "peak", "off", "diameter", "kept"),
    [
        (0.0, 160.0, 1.9, 3.9, [0]),  # on the disc: a part of it, however well its few pixels fit
        (0.0, 160.0, 3.9, 3.9, [0, 1]),  # beside it: another light
        (1.0, 160.0, 1.9, 3.9, [1]),  # on what is no disc: found twice, the better one counts
        (0.0, 160.0, 1.9, 7.0, [1]),  # as large as it
        (0.0, 30.0, 3.0, 3.9, [1, 0]),  # an LED before a wide glow
    ],
)
def test_a_small_spot_on_a_disc_is_a_part_of_it(
    merged: float, peak: float, off: float, diameter: float, kept: list[int]
) -> None:
    assessed = np.zeros((2, N_COLUMNS))
    assessed[:, [COL_ELONGATION, COL_SOUND]] = 1.0
    assessed[:, COL_PEAK] = peak, 140.0
    assessed[:, COL_MISFIT] = 3.0, 1.0
    assessed[:, COL_CENTRE_X] = 100.0, 100.0 + off
    assessed[:, COL_DIAMETER] = 7.2, diameter
    assessed[0, COL_MERGED] = merged
    assert choose_spots(assessed, 2.0, 40.0, 9).tolist() == kept
    assert (1 - choose_spots(assessed[::-1].copy(), 2.0, 40.0, 9)).tolist() == kept
