"""Where LEDs are looked for, against OpenCV's projection and a union of boxes drawn on a grid."""

import cv2
import numpy as np
import pytest

from verify.identification import Prediction
from verify.marker import Marker
from verify.records import Array
from verify.rig import Camera
from verify.windows import MARGIN_PX, windows

SIZE = (640, 480)
MATRIX = np.array([[500.0, 1.5, 320.0], [0.0, 505.0, 240.0], [0.0, 0.0, 1.0]])
LENS = np.array([-0.1, 0.03, 0.001, -0.002, 0.004])
CAMERA = Camera(MATRIX, LENS, np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.0, np.eye(4))
IMAGE = np.zeros(SIZE[::-1], dtype=np.uint8)
SMALL = 0.004  # m, an LED


def looked_for(leds: Array, away: float, position: float, rotation: float) -> tuple[Array, Array]:
    """The windows, and each LED's own box (n, 4), by OpenCV."""
    pose = np.eye(4)
    pose[:3, 3] = 0.01, -0.02, away
    marker = Marker(tuple(map(str, range(len(leds)))), leds, (None,) * len(leds), SMALL)
    found = windows(marker, CAMERA, 0.0, Prediction(pose, position, rotation), IMAGE)
    points = leds + pose[:3, 3]
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, LENS)[0][:, 0]
    radius = np.linalg.norm(leds, axis=1).max()
    seen = SMALL + 2 * (position + radius * rotation)
    half = (MARGIN_PX + MATRIX[0, 0] * seen / points[:, 2])[:, None]
    # OpenCV knows no skew of the axes
    pixels[:, 0] += MATRIX[0, 1] * (pixels[:, 1] - MATRIX[1, 2]) / MATRIX[1, 1]
    return found, np.concatenate([pixels - half, pixels + half], axis=1)


def test_leds_far_from_each_other_have_a_window_each() -> None:
    leds = np.array([[0.0, 0, 0], [0.1, 0, 0.02], [0, 0.1, 0], [-0.1, -0.1, -0.03]])
    found, own = looked_for(leds, 0.8, 1e-3, 0.01)
    assert len(found) == 4
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(own, axis=0), atol=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_windows_meet_nowhere_and_hold_every_leds_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    leds = rng.uniform(-0.1, 0.1, (6, 3))
    found, own = looked_for(leds, 0.7, 2e-3, rng.uniform(0.0, 0.2))
    low, high = found[:, :2], found[:, 2:]
    apart = ((high[:, None] < low[None]) | (low[:, None] > high[None])).any(axis=2)
    assert (apart | np.eye(len(found), dtype=bool)).all()
    own = np.clip(own, 0, [*SIZE, *SIZE])
    held = (found[:, None, :2] <= own[None, :, :2] + 1e-9).all(axis=2)
    held &= (found[:, None, 2:] >= own[None, :, 2:] - 1e-9).all(axis=2)
    assert (held.sum(axis=0) == 1).all()
    # nothing is looked at for no reason: each side of a window is some LED's
    for side in range(4):
        assert np.isclose(found[:, None, side], own[None, :, side], atol=1e-9).any(axis=1).all()


def test_what_is_behind_the_camera_or_beside_the_image_is_not_looked_for() -> None:
    leds = np.array([[0.0, 0, 0], [0.0, 0, -2.0], [1.5, 0, 0]])
    assert len(looked_for(leds, 0.8, 1e-3, 1e-4)[0]) == 1
    assert looked_for(leds[:1] - [0, 0, 2.0], 0.8, 1e-3, 1e-4)[0].shape == (0, 4)
