"""The formulas against examples small enough for pencil and paper, and against laws."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from verify.performance import measures
from verify.performance.assess import Stands, assess_distance
from verify.records import Array

CROSS = np.array([[3.0, 0, 0], [-3, 0, 0], [0, 4, 0], [0, -4, 0]])


def at(x: float, y: float, z: float, size: float = 1.0) -> Array:
    return size * CROSS + np.array([x, y, z])


def test_accuracy_is_the_barycentres_distance() -> None:
    assert measures.accuracy(at(1, 2, 2), np.zeros(3)) == pytest.approx(3.0)


def test_repeatability_by_hand() -> None:
    # l = 3, 3, 4, 4: mean 3.5, S = sqrt(4 · 0.25 / 3) = 0.57735; 3.5 + 3 S = 5.23205
    assert measures.distances(at(7, 8, 9)).tolist() == pytest.approx([3, 3, 4, 4])
    assert float(measures.repeatability(at(7, 8, 9))) == pytest.approx(5.2320508)


def test_angles_by_hand() -> None:
    commanded = Rotation.from_euler("xyz", [20, -30, 40], degrees=True)
    turned = [Rotation.from_rotvec([0, 0, np.deg2rad(a)]) * commanded for a in (1.0, 2.0, 3.0)]
    attained = np.array([r.as_matrix() for r in turned])
    angles = np.rad2deg(measures.turns(attained, commanded.as_matrix()))
    np.testing.assert_allclose(angles, [[0, 0, 1], [0, 0, 2], [0, 0, 3]], atol=1e-9)
    np.testing.assert_allclose(measures.angle_repeatability(angles), [0, 0, 3], atol=1e-9)


def test_variation_is_the_longest_side() -> None:
    barycentres = np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0]])
    assert measures.furthest(barycentres) == (pytest.approx(5.0), (0, 2))


def test_distances_by_hand() -> None:
    """Visits 9.5 and 11.5 m apart, 10 m as read."""
    far = np.array([9.0, 11.0, 9.0, 11.0, 9.0, 11.0])
    one, other = stands("one", 0.0, np.zeros(6), 0.0), stands("other", 0.5, far + 0.5, 10.0)
    found = assess_distance(one, other)
    assert found is not None
    assert found.commanded == pytest.approx(10.0)
    assert found.accuracy.value == pytest.approx(0.5)
    assert found.repeatability.value == pytest.approx(3 * np.sqrt(6 / 5))


def stands(name: str, begin: float, x: Array, read: float) -> Stands:
    """Visits of a pose a second apart, along x."""
    attained, there = np.tile(np.eye(4), (2, len(x), 1, 1))
    attained[:, 0, 3], there[:, 0, 3] = x, read
    t = begin + np.arange(len(x))
    once = np.ones(len(x), dtype=int)
    return Stands(name, t, attained, there, once, (-1,) * len(x), np.zeros((6, 0)))


def test_a_path_is_as_bad_as_its_worst_station() -> None:
    commanded = np.array([[0.0, 0, 0], [10, 0, 0]])
    attained = np.stack([at(0, 0, 1), at(10, 0, 2, size=2)])
    assert measures.path_accuracy(attained, commanded) == (pytest.approx(2.0), 1)
    assert measures.path_repeatability(attained) == (pytest.approx(2 * 5.2320508), 1)


def test_drift_is_the_largest_change_from_the_first_block() -> None:
    blocks = [at(1.0, 0, 0), at(1.5, 0, 0), at(0.7, 0, 0, size=2)]
    found = measures.drift(np.concatenate(blocks), np.zeros(3), np.array([0, 4, 8]))
    np.testing.assert_allclose(found, [0.5, 5.2320508])


def scattered(n: int, draws: int) -> Array:
    return np.random.default_rng(1).standard_normal((draws, n, 3))


@pytest.mark.parametrize(("n", "mean", "spread"), [(30, 3.534, 0.093), (10, 3.355, 0.17)])
def test_repeatability_of_normal_scatter_follows_its_law(n: int, mean: float, spread: float):
    """The figures of the field for an isotropic scatter of 1, 30 visits and 10."""
    found = measures.repeatability(scattered(n, 20_000))
    assert found.mean() == pytest.approx(mean, abs=0.012)
    assert found.std() / found.mean() == pytest.approx(spread, abs=0.005)


@pytest.mark.parametrize(("true", "read"), [(0.0, 1.60), (2.0, 2.50), (5.0, 5.20)])
def test_accuracy_reads_too_much_by_its_law(true: float, read: float) -> None:
    """In standard deviations of the barycentre."""
    n = 30
    visits = scattered(n, 4_000) * np.sqrt(n) + [true, 0, 0]
    found = [measures.accuracy(one, np.zeros(3)) for one in visits]
    assert np.mean(found) == pytest.approx(read, abs=0.05)
