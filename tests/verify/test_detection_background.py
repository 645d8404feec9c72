import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from verify.detection.kernel_background import top_hat


@pytest.mark.parametrize("reach", [1, 4, 15, 30])
def test_what_is_above_its_surroundings_is_what_opencv_says(reach: int) -> None:
    """Pictures smaller than the window, as large, and several times as large; borders included."""
    rng = np.random.default_rng(reach)
    side = 2 * reach + 1
    sizes = [(1, 1), (side, side), (side + 1, side - 1), *rng.integers(1, 4 * side, (40, 2))]
    for height, width in sizes:
        image = rng.integers(0, 256, (height, width)).astype(np.uint8)
        found = np.empty_like(image)
        top_hat(image, reach, found)
        window = np.ones((side, side), np.uint8)
        assert_array_equal(found, cv2.morphologyEx(image, cv2.MORPH_TOPHAT, window))


def test_on_black_that_every_column_has_things_are_what_opencv_says_too() -> None:
    image = np.random.default_rng(1).poisson(0.3, (70, 90)).astype(np.uint8)
    image[20:30, 40:52] = 200
    found = np.empty_like(image)
    top_hat(image, 30, found)
    window = np.ones((61, 61), np.uint8)
    assert_array_equal(found, cv2.morphologyEx(image, cv2.MORPH_TOPHAT, window))
