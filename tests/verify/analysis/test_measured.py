"""The picture of a pair with its LEDs marked."""

import cv2
import numpy as np
import pytest

from verify.analysis.measured import HEIGHT, RING_COLOUR, WIDTH, draw_pair
from verify.core.fiducials import Marker
from verify.core.records import Array, Image, Measurement, Sighting, StereoPair

MARKER = Marker(("", ""), np.zeros((2, 3)), (None, None), 0.005)  # no name is written
WIDE = np.array([[300.0, 400.0], [1700.0, 700.0]])  # more than the report's picture has


def draw_left(image: Image, centres: Array) -> Array:
    n = len(centres)
    seen = Sighting(
        np.arange(n), centres, np.tile(np.eye(2), (n, 1, 1)), 0.0, 0.0,
        np.full(n, 200.0), np.zeros((n, 2)), np.zeros((n, 3)),
    )  # fmt: skip
    pair = StereoPair(0, 0.0, 0.0, 0.0, 0.0, image, image)
    png = draw_pair(pair, Measurement(0, 0.0, "measured", n, left=seen, right=seen), MARKER)
    both = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert both is not None
    assert both.shape == (HEIGHT, 2 * WIDTH, 3)
    return both[:, :WIDTH].astype(float)


@pytest.mark.parametrize("centres", [WIDE, np.array([[505.0, 500.0], [560.0, 530.0]])])
def test_rings_lie_about_their_leds_where_the_picture_is_reduced_or_enlarged(
    centres: Array,
) -> None:
    image = np.zeros((1080, 1920), np.uint8)
    for x, y in centres.astype(int):
        image[y - 1 : y + 2, x - 1 : x + 2] = 255
    view = draw_left(image, centres)
    light = view.min(axis=2) > 90  # a ring has 80 of blue and red
    ring = np.abs(view - RING_COLOUR).max(axis=2) < 30
    for half in np.split(np.arange(WIDTH), 2):
        y, x = np.nonzero(light[:, half])
        top, left = np.nonzero(ring[:, half])
        assert np.ptp(left) > np.ptp(x)
        assert (left.min() + left.max()) / 2 == pytest.approx(x.mean(), abs=1.0)
        assert (top.min() + top.max()) / 2 == pytest.approx(y.mean(), abs=1.0)


def test_a_picture_that_is_reduced_keeps_the_mean_of_what_is_finer_than_its_pixels() -> None:
    image = np.zeros((1080, 1920), np.uint8)
    image[:, ::3] = 240  # every third column
    inside = draw_left(image, WIDE)[10:40, 10:-10]
    assert inside.mean() == pytest.approx(80, abs=2)
    assert inside.std() < 40  # of single columns: 113
