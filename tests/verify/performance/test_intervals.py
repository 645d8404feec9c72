"""Intervals by the one thing that proves them: how often they hold the truth."""

import numpy as np
import pytest
from scipy.stats import binom, chi

from verify.performance.intervals import (
    length_interval,
    mean_interval,
    noise_length,
    repeatability_interval,
    repeatability_of,
    spread_interval,
)
from verify.records import Array

DRAWS = 1000
LEAST, MOST = binom.ppf([0.0005, 0.9995], DRAWS, 0.95)
NONE = np.zeros((3, 3))
ROUND, DEEP = np.array([1.0, 1, 1]), np.array([1.0, 1, 5])  # cameras see depth five times worse


def test_endless_visits_by_the_laws_of_chi() -> None:
    for freedom in (1, 2, 3):
        law = chi(freedom)
        covariance = np.diag([1.0] * freedom + [0.0] * (3 - freedom)) * 0.04
        expected = 0.2 * (law.mean() + 3 * law.std())
        assert repeatability_of(covariance) == pytest.approx(expected, rel=1e-9)
    assert repeatability_of(NONE) == 0.0


def test_endless_visits_of_an_uneven_scatter() -> None:
    drawn = np.random.default_rng(2).standard_normal((2_000_000, 3)) * DEEP
    length = np.linalg.norm(drawn, axis=1)
    found = repeatability_of(np.diag(DEEP**2))
    assert found == pytest.approx(length.mean() + 3 * length.std(), rel=2e-3)


def hits_of_repeatability(shape: Array, n: int, draws: int) -> int:
    rng = np.random.default_rng(3)
    true = repeatability_of(np.diag(shape**2))
    found = [repeatability_interval(rng.standard_normal((n, 3)) * shape) for _ in range(draws)]
    return sum(one.low <= true <= one.high for one in found)


def test_the_interval_of_repeatability_holds_the_truth_of_round_scatter() -> None:
    """Its shape is found uneven by chance, which widens it: at least 95 %, at most 99 %."""
    assert LEAST <= hits_of_repeatability(ROUND, 10, DRAWS) <= 0.99 * DRAWS


def test_the_interval_of_repeatability_holds_the_truth_of_uneven_scatter() -> None:
    draws = 400
    least, most = binom.ppf([0.0005, 0.9995], draws, 0.95)
    assert least <= hits_of_repeatability(DEEP, 10, draws) <= most


def hits_of_length(shape: Array, n: int, sizes: float) -> int:
    """Of lengths that are `sizes` times the barycentre's standard deviation, in any direction."""
    rng = np.random.default_rng(4)
    held = 0
    for _ in range(DRAWS):
        towards = rng.standard_normal(3)
        true = sizes * np.sqrt(np.mean(shape**2) / n)
        visits = rng.standard_normal((n, 3)) * shape
        visits += true * towards / np.linalg.norm(towards)
        found = length_interval(visits.mean(axis=0), np.cov(visits.T) / n, n - 1, NONE)
        held += found.low <= true <= found.high
    return held


@pytest.mark.parametrize("shape", [ROUND, DEEP], ids=["round", "uneven"])
@pytest.mark.parametrize("sizes", [0.0, 1.0, 3.0])
def test_the_interval_of_a_short_length_holds_the_truth_at_least(shape: Array, sizes: float):
    assert hits_of_length(shape, 10, sizes) >= LEAST


@pytest.mark.parametrize("shape", [ROUND, DEEP], ids=["round", "uneven"])
def test_the_interval_of_a_long_length_holds_the_truth(shape: Array) -> None:
    assert LEAST <= hits_of_length(shape, 10, 20.0) <= MOST


def test_a_length_with_a_systematic_doubt_alone() -> None:
    """No scatter, one known doubt along the length: ± 1.96 of it."""
    doubt = np.diag([0.04, 0.0, 0.0])
    found = length_interval(np.array([5.0, 0, 0]), NONE, 9, doubt)
    assert (found.low, found.high) == (
        pytest.approx(5 - 0.392, abs=1e-3),
        pytest.approx(5.392, abs=1e-3),
    )


def test_noise_alone_by_the_law_of_chi() -> None:
    found = noise_length(NONE, 29, np.eye(3))
    assert found == pytest.approx(chi(3).mean(), rel=0.02)  # 1.60
    # Student's t of few visits is longer, by its variance n / (n - 2)
    assert noise_length(np.eye(3), 4, NONE) > 1.1 * found


def test_intervals_of_means_and_spreads_hold_the_truth() -> None:
    rng = np.random.default_rng(5)
    visits = rng.standard_normal((DRAWS, 8))
    means = [mean_interval(one, 0.0) for one in visits]
    assert LEAST <= sum(one.low <= 0 <= one.high for one in means) <= MOST
    shifted = [mean_interval(one + rng.normal(0, 2.0), 2.0) for one in visits]
    assert LEAST <= sum(one.low <= 0 <= one.high for one in shifted) <= MOST
    spreads = [spread_interval(one) for one in visits]
    assert LEAST <= sum(one.low <= 3 <= one.high for one in spreads) <= MOST


def test_the_same_visits_give_the_same_interval() -> None:
    visits = np.random.default_rng(6).standard_normal((9, 3))
    assert repeatability_interval(visits) == repeatability_interval(visits.copy())


def test_visits_without_scatter_have_none() -> None:
    found = repeatability_interval(np.tile([1.0, 2, 3], (6, 1)))
    assert (found.value, found.low, found.high) == (0.0, 0.0, 0.0)
