"""Formulas against pencil and paper and against laws; intervals by how often they hold."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi

from tests.support.repeated_poses import pose_visits
from verify.analysis.performance import indices
from verify.analysis.performance.indices import (
    length_interval,
    mean_interval,
    noise_length,
    repeatability_interval,
    repeatability_of,
    spread_interval,
)
from verify.analysis.performance.poses import assess_distance, mean_deviation
from verify.core.records import Array

CROSS = np.array([[3.0, 0, 0], [-3, 0, 0], [0, 4, 0], [0, -4, 0]])


def at(x: float, y: float, z: float, size: float = 1.0) -> Array:
    return size * CROSS + np.array([x, y, z])


def test_accuracy_is_the_barycentres_distance() -> None:
    found = mean_deviation(at(1, 2, 2), np.zeros((3, 1)))
    assert found.found.value == pytest.approx(3.0)


def test_repeatability_by_hand() -> None:
    # l = 3, 3, 4, 4: mean 3.5, S = sqrt(4 · 0.25 / 3) = 0.57735; 3.5 + 3 S = 5.23205
    assert indices.barycentre_distances(at(7, 8, 9)).tolist() == pytest.approx([3, 3, 4, 4])
    assert float(indices.repeatability(at(7, 8, 9))) == pytest.approx(5.2320508)


def test_angles_by_hand() -> None:
    commanded = Rotation.from_euler("xyz", [20, -30, 40], degrees=True)
    turned = [Rotation.from_rotvec([0, 0, np.deg2rad(a)]) * commanded for a in (1.0, 2.0, 3.0)]
    attained = np.array([r.as_matrix() for r in turned])
    angles = np.rad2deg(indices.orientation_deviations(attained, commanded.as_matrix()))
    np.testing.assert_allclose(angles, [[0, 0, 1], [0, 0, 2], [0, 0, 3]], atol=1e-9)
    assert [spread_interval(a).value for a in angles.T] == pytest.approx([0, 0, 3])


def test_variation_is_the_longest_side() -> None:
    barycentres = np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0]])
    assert indices.barycentre_spread(barycentres) == (pytest.approx(5.0), (0, 2))


def test_distances_by_hand() -> None:
    """Visits 9.5 and 11.5 m apart, 10 m as read."""
    far = np.outer([9.5, 11.5] * 3, [1.0, 0.0, 0.0])
    found = assess_distance(pose_visits(np.zeros((6, 3))), pose_visits(far, read=10.0, begin=30.0))
    assert found.commanded == pytest.approx(10.0)
    assert found.accuracy.value == pytest.approx(0.5)
    assert found.repeatability.value == pytest.approx(3 * np.sqrt(6 / 5))


def test_a_path_is_as_bad_as_its_worst_station() -> None:
    commanded = np.array([[0.0, 0, 0], [10, 0, 0]])
    attained = np.stack([at(0, 0, 1), at(10, 0, 2, size=2)])
    assert indices.path_accuracy(attained, commanded) == (pytest.approx(2.0), 1)
    assert indices.path_repeatability(attained) == (pytest.approx(2 * 5.2320508), 1)


def test_drift_is_the_largest_change_from_the_first_block() -> None:
    blocks = [at(1.0, 0, 0), at(1.5, 0, 0), at(0.7, 0, 0, size=2)]
    found = indices.drift(np.concatenate(blocks), np.zeros(3), np.array([0, 4, 8]))
    np.testing.assert_allclose(found, [0.5, 5.2320508])


def scattered(n: int, draws: int) -> Array:
    return np.random.default_rng(1).standard_normal((draws, n, 3))


@pytest.mark.parametrize(("n", "mean", "spread"), [(30, 3.534, 0.093), (10, 3.355, 0.17)])
def test_repeatability_of_normal_scatter_follows_its_law(n: int, mean: float, spread: float):
    """The figures of the field for an isotropic scatter of 1, 30 visits and 10."""
    found = indices.repeatability(scattered(n, 20_000))
    assert found.mean() == pytest.approx(mean, abs=0.012)
    assert found.std() / found.mean() == pytest.approx(spread, abs=0.005)


@pytest.mark.parametrize(("true", "read"), [(0.0, 1.60), (2.0, 2.50), (5.0, 5.20)])
def test_accuracy_reads_too_much_by_its_law(true: float, read: float) -> None:
    """In standard deviations of the barycentre."""
    n = 30
    visits = scattered(n, 1_000) * np.sqrt(n) + [true, 0, 0]
    found = [mean_deviation(one, np.zeros((3, 1))).found.value for one in visits]
    assert np.mean(found) == pytest.approx(read, abs=0.05)


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "draws", "most"),
    [(ROUND, DRAWS, 0.99 * DRAWS), (DEEP, 400, binom.ppf(0.9995, 400, 0.95))],
    ids=["round", "uneven"],
)
def test_the_interval_of_repeatability_holds_the_truth(shape: Array, draws: int, most: float):
    """A round shape is found uneven by chance, which widens it: at least 95 %, at most 99 %."""
    least = binom.ppf(0.0005, draws, 0.95)
    assert least <= hits_of_repeatability(shape, 10, draws) <= most


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


@pytest.mark.slow
@pytest.mark.parametrize("shape", [ROUND, DEEP], ids=["round", "uneven"])
@pytest.mark.parametrize("sizes", [0.0, 1.0, 3.0])
def test_the_interval_of_a_short_length_holds_the_truth_at_least(shape: Array, sizes: float):
    assert hits_of_length(shape, 10, sizes) >= LEAST


@pytest.mark.slow
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


def test_visits_without_scatter_have_none() -> None:
    found = repeatability_interval(np.tile([1.0, 2, 3], (6, 1)))
    assert (found.value, found.low, found.high) == (0.0, 0.0, 0.0)
