"""LEDs of which a stalk hides a sliver: where the whole disc's centre is, and how surely."""

import cv2
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from tests.support.kernels import PRIOR_DEPTH, depth_posterior
from tests.support.leds.images import REACH, Sensor, Spot, centre_bound, scattered
from verify.core.records import Array, Image, Spots
from verify.measurement.detection.detect import detect

BLUR, RADIUS, PEAK, FLOOR = 0.6, 4.2, 210.0, 6.0
FINE = 8  # sub-pixels a side


def behind_a_stalk(x: float, y: float, depth: float, width: float, side: float) -> Array:
    """An LED at x, y of a patch; a sharp, square-ended stalk stands over its rim.

    depth: of its end inside the rim, in radii; width: half of it, in radii; side: rad.
    """
    size = 2 * REACH + 1
    axis = (np.arange(size * FINE) + 0.5) / FINE - 0.5
    dx, dy = np.meshgrid(axis - x, axis - y)
    along = dx * np.cos(side) + dy * np.sin(side)
    across = np.abs(dy * np.cos(side) - dx * np.sin(side))
    disc = np.clip((RADIUS - np.hypot(dx, dy)) * FINE + 0.5, 0, 1)
    stalk = np.clip((along - (1 - depth) * RADIUS) * FINE + 0.5, 0, 1)
    stalk *= np.clip((width * RADIUS - across) * FINE + 0.5, 0, 1)
    soft = cv2.GaussianBlur(disc * (1 - stalk), (0, 0), BLUR * FINE)
    return np.asarray(PEAK * soft.reshape(size, FINE, size, FINE).mean(axis=(1, 3)))


def scene(
    centres: Array, depth: Array, width: float, side: Array, rng: np.random.Generator
) -> Image:
    light = np.full((360, 640), FLOOR)
    for (x, y), d, phi in zip(centres, depth, side, strict=True):
        x0, y0 = round(x) - REACH, round(y) - REACH
        patch = light[y0 : y0 + 2 * REACH + 1, x0 : x0 + 2 * REACH + 1]
        patch += behind_a_stalk(x - x0, y - y0, d, width, phi)
    return Sensor().expose(light, rng)


class Figures:
    """Errors of spots and what was claimed of them."""

    def __init__(self) -> None:
        self.errors: list[Array] = []
        self.covariances: list[Array] = []

    def add(self, spots: Spots, centres: Array) -> None:
        apart = np.linalg.norm(spots.centre[None] - centres[:, None], axis=-1)
        nearest = np.argmin(apart, axis=1)
        self.errors.append(spots.centre[nearest] - centres)
        self.covariances.append(spots.covariance[nearest])

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(np.square(np.concatenate(self.errors)))))

    @property
    def over_claimed(self) -> float:
        """Rms of the errors over their standard deviations, per coordinate."""
        error, covariance = np.concatenate(self.errors), np.concatenate(self.covariances)
        squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
        return float(np.sqrt(np.mean(squared) / 2))


def bound() -> float:
    return centre_bound(Spot(PEAK, BLUR, RADIUS), FLOOR, Sensor())


# Depth in radii, and by how much the centre of a whole disc's fit is off: rms of a coordinate.
@pytest.mark.slow
@pytest.mark.parametrize(("depth", "drawn"), [(0.03, 0.0110), (0.08, 0.0400)])
@pytest.mark.parametrize("width", [0.3, 0.5, 1.0])
def test_slivers_hidden_on_one_side_hardly_bias_the_centres(
    depth: float, drawn: float, width: float
) -> None:
    rng, found = np.random.default_rng(31), Figures()
    for _ in range(12):
        centres = scattered(2, 2, rng, pitch=150.0)
        side = rng.uniform(0, 2 * np.pi) + rng.normal(0, 0.1, 4)
        image = scene(centres, depth * rng.uniform(0.7, 1.3, 4), width, side, rng)
        found.add(detect(image), centres)
    assert found.rms < max(drawn / 3, 1.9 * bound())
    assert found.over_claimed < 1.4


def test_one_led_behind_a_cable_is_centred_and_the_others_stay_at_the_bound() -> None:
    rng, bitten, whole = np.random.default_rng(32), Figures(), Figures()
    for _ in range(25):
        centres = scattered(2, 2, rng, pitch=150.0)
        side = rng.uniform(0, 2 * np.pi, 4)
        spots = detect(scene(centres, np.array([0.08, 0, 0, 0]), 0.5, side, rng))
        bitten.add(spots, centres[:1])
        whole.add(spots, centres[1:])
    assert bitten.rms < 0.040 / 3
    assert bitten.over_claimed < 1.4
    assert whole.rms < 1.1 * bound()
    assert whole.over_claimed == pytest.approx(1.0, abs=0.2)  # 150 errors: 4 % is one sigma


@pytest.mark.slow
def test_bitten_reflections_beside_them_do_not_move_whole_leds() -> None:
    rng, whole = np.random.default_rng(33), Figures()
    for _ in range(25):
        centres = scattered(2, 4, rng, pitch=150.0)
        depth = np.where(np.arange(8) % 2, 0.15, 0.0)
        image = scene(centres, depth, 0.5, np.full(8, rng.uniform(0, 2 * np.pi)), rng)
        whole.add(detect(image), centres[::2])
    assert whole.rms < 1.2 * bound()  # half the picture lies about them, at a little cost
    assert whole.over_claimed == pytest.approx(1.0, abs=0.2)


def test_the_depth_of_a_bite_is_its_posterior_mean() -> None:
    for gradient in (-700.0, 0.0, 300.0, 1500.0):
        evidence, mean, square = depth_posterior(gradient, 1.5e4)

        def moment(power: int, g: float = gradient) -> float:
            return quad(
                lambda b: 2 * b**power * norm.pdf(b, 0, PRIOR_DEPTH) * np.exp(g*b - 0.75e4 * b*b),
                0, 1, points=[0.01, 0.05, 0.1, 0.2], limit=200,
            )[0]  # fmt: skip

        assert evidence == pytest.approx(np.log(moment(0)), abs=1e-6)
        assert mean == pytest.approx(moment(1) / moment(0), rel=1e-6)
        assert square == pytest.approx(moment(2) / moment(0), rel=1e-6)
