"""What detection has compiled, against OpenCV, numpy and the formulas themselves."""

import cv2
import numpy as np
import pytest

from verify.detection.kernel_bite import bump
from verify.detection.kernel_blob import half_height
from verify.detection.kernel_judgement import twins
from verify.detection.kernel_patches import read_grey
from verify.records import Array, Image

ANY_SHAPE = (1e9, 0.0)  # axis ratio and fill that everything has


def cloud(seed: int, blur: float) -> Image:
    """Bright islands, some with holes, some at the border."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(40, 50)), (0, 0), blur)
    stretched = 255 * (noise - noise.min()) / np.ptp(noise)
    return np.asarray(np.clip(1.5 * stretched - 120, 0, 255), np.uint8)


def blob_by_opencv(part: Image) -> Array:
    """Centre, half width and height of the island about the peak, what its rim encloses counted."""
    _, peak, _, (x, y) = cv2.minMaxLoc(part)
    above = np.asarray(part > peak / 2, np.uint8)
    outlines, _ = cv2.findContours(above, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    rim = next(o for o in outlines if cv2.pointPolygonTest(o, (x, y), measureDist=False) >= 0)
    island = cv2.drawContours(np.zeros_like(above), [rim], -1, 1, cv2.FILLED) & above
    moments = cv2.moments(island, binaryImage=True)
    area = moments["m00"]
    centre = moments["m10"] / area, moments["m01"] / area
    return np.array([*centre, np.sqrt(area / np.pi), peak])


@pytest.mark.parametrize("blur", [0.7, 1.5, 3.0])
@pytest.mark.parametrize("seed", range(20))
def test_a_blob_at_half_its_height_is_that_of_opencv(seed: int, blur: float) -> None:
    part, told = cloud(seed, blur), np.empty(4)
    assert half_height(part, *ANY_SHAPE, told)
    np.testing.assert_allclose(told, blob_by_opencv(part), rtol=1e-12)


def test_a_streak_and_a_hook_are_no_blobs_and_a_disc_is_one() -> None:
    told = np.empty(4)
    for thing, compact in [
        (cv2.circle(np.zeros((40, 40), np.uint8), (20, 20), 8, 200, cv2.FILLED), True),
        (cv2.line(np.zeros((40, 40), np.uint8), (5, 5), (35, 30), 200, 2), False),
        (cv2.ellipse(np.zeros((40, 40), np.uint8), (20, 20), (12, 12), 0, 0, 200, 200, 3), False),
        (np.full((40, 40), 200, np.uint8), False),
    ]:
        assert half_height(np.asarray(thing, np.uint8), 2.5, 0.6, told) == compact


@pytest.mark.parametrize("origin", [(30, 20), (2, 1), (49, 39)])
def test_a_patch_holds_the_pixels_about_its_origin(origin: tuple[int, int]) -> None:
    image = cloud(3, 1.0)
    axis = np.arange(-6, 7)
    column, row = (values.reshape(1, -1) for values in np.meshgrid(axis, axis))
    pixels, contrast = np.empty((1, 4, column.size)), np.empty(1)
    read_grey(image, np.array([origin]), np.array([2.5]), column, row, pixels, contrast)
    x, y = origin[0] + column[0], origin[1] + row[0]
    value = image[np.clip(y, 0, 39), np.clip(x, 0, 49)].astype(float)
    inside = (x >= 0) & (x < 50) & (y >= 0) & (y < 40)
    np.testing.assert_array_equal(pixels[0], np.stack([value, inside, column[0], row[0]]))
    core = column[0] ** 2 + row[0] ** 2 <= 2.5**2
    third = value.size // 3
    expected = value[core].mean() - np.partition(value, third)[third]
    assert contrast[0] == pytest.approx(expected, abs=1e-12)


def test_a_bites_bump_is_the_exponential_to_what_it_promises() -> None:
    angle, sharp = np.linspace(0, 2 * np.pi, 999), 1 / 0.3**2
    sunk = np.empty_like(angle)
    bump(np.cos(angle), np.sin(angle), np.full_like(angle, 3.0), 1.0, 0.0, sharp, sunk)
    np.testing.assert_allclose(sunk, 3.0 * np.exp((np.cos(angle) - 1) * sharp), rtol=2e-9)


def test_of_spots_on_one_place_the_better_fitting_stays_and_of_equals_the_first() -> None:
    centre = np.array([[10.0, 10.0], [11.0, 10.0], [30.0, 10.0], [30.5, 10.0], [50.0, 10.0]])
    misfit, twin = np.array([2.0, 1.0, 1.0, 1.0, 9.0]), np.empty(5, np.bool_)
    twins(centre, np.full(5, 8.0), misfit, 0.5, twin)
    assert twin.tolist() == [True, False, False, True, False]
