"""Pixels near a limit of the sensor, against numerical integration of the clipped normal law."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from verify.detection.kernel_clip import CLIP_REACH, FREE, LOWEST_Z, clip, normal_law

LIMIT = 255.0


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
    means, variances = np.array([128.0, mu, 3.0]), np.array([4.0, variance, 2.0])
    visible = np.empty(3)
    clip(means, variances, visible, np.empty((FREE, 3)))
    return float(means[1]), float(variances[1]), float(visible[1])


@pytest.mark.parametrize("sigma", [0.4, 1.5, 4.0])
@pytest.mark.parametrize("z", [-7.0, -4.0, -1.1, -0.3, 0.0, 0.6, 2.0, 4.3])
@pytest.mark.parametrize("top", [False, True], ids=["black", "full"])
def test_moments_are_those_of_the_clipped_law(z: float, sigma: float, top: bool) -> None:
    mu = LIMIT - z * sigma if top else z * sigma
    mean, variance, share = clipped(mu, sigma**2)
    true_mean, true_variance, true_share = clipped_by_integration(mu, sigma)
    assert mean == pytest.approx(true_mean, abs=1e-7)
    assert share == pytest.approx(true_share, abs=1e-7)
    assert variance == pytest.approx(max(true_variance, 1 / 12), abs=1e-6)  # or rounding's


def test_the_normal_law_is_that_of_the_book_all_over_its_range() -> None:
    z = np.append(np.linspace(LOWEST_Z, CLIP_REACH, 4321), 0.0)
    below, here = np.empty_like(z), np.empty_like(z)
    normal_law(z, below, here)
    assert np.abs(below - norm.cdf(z)).max() < 1e-9
    assert np.abs(here - norm.pdf(z)).max() < 1e-8
    assert math.isclose(below[-1], 0.5, abs_tol=1e-12)


def test_far_beyond_a_limit_nothing_is_seen_and_far_inside_nothing_is_clipped() -> None:
    assert clipped(-400.0, 4.0) == pytest.approx((0.0, 1 / 12, 0.0), abs=1e-12)
    assert clipped(128.0, 4.0) == (128.0, 4.0, 1.0)
