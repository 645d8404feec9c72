"""Passages of known curves: lateral errors are found, longitudinal ones are timing."""

import numpy as np
import pytest
from scipy.stats import binom

from verify.analysis.performance.paths import PathRun, assess_path, crossings
from verify.core.records import Array

RADIUS = 0.1  # m
T = np.linspace(0, 4, 801)


def arc(t: Array, radius: float = RADIUS) -> Array:
    """A quarter circle in 4 s, slow at both ends."""
    angle = np.pi / 2 * (t / 4) ** 2 * (3 - 2 * t / 4)
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(t)], axis=1)


def passage(attained: Array) -> PathRun:
    return PathRun(T, attained, arc(T), np.zeros((len(T), 3)), np.tile(np.eye(3), (len(T), 1, 1)))


def judged(*attained: Array):
    met = crossings([passage(one) for one in attained])
    assert met is not None
    return assess_path("arc", met, 0.0, np.zeros((50, 3, 1)), oriented=True)


def test_a_wider_arc_is_off_by_its_radius() -> None:
    found = judged(*(arc(T, RADIUS + 2e-4 + step) for step in (-4e-5, -2e-5, 0, 2e-5, 4e-5)))
    assert found.accuracy.found.value == pytest.approx(2e-4, rel=1e-3)
    # l = 40, 20, 0, 20, 40 µm: mean 24, S = sqrt(1120 / 4) = 16.733; 24 + 3 S = 74.2 µm
    assert found.repeatability.found.value == pytest.approx(74.199e-6, rel=1e-3)
    assert found.length == pytest.approx(0.98 * RADIUS * np.pi / 2, rel=1e-3)  # 1st to 50th plane


def test_a_late_passage_is_no_error_of_the_path() -> None:
    found = judged(*(arc(np.clip(T - late, 0, 4)) for late in (0.0, 0.02, 0.04, 0.06, 0.08)))
    inside = found.crossings.attained[3:-3]  # the last ones never reach the last planes
    off = np.linalg.norm(inside - found.crossings.commanded[3:-3, None], axis=2)
    assert off.max() < 2e-6


def test_a_bump_is_found_where_it_is() -> None:
    way = np.linalg.norm(np.diff(arc(T), axis=0), axis=1).cumsum()
    bump = 3e-4 * np.exp(-(((np.append(0, way) - 0.08) / 0.01) ** 2))
    found = judged(*[arc(T) + bump[:, None] * [0, 0, 1.0]] * 5)
    assert found.accuracy.found.value == pytest.approx(3e-4, rel=0.02)
    assert found.accuracy_at == pytest.approx(0.08 - 0.01 * RADIUS * np.pi / 2, abs=4e-3)
    assert found.accuracy_noise == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_noise_is_distinguished_from_a_path_error() -> None:
    """Passages about the path itself: AT above what they scatter to in about 5 % of cases."""
    over = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        waves = np.stack([np.sin(2 * np.pi * k * T / 4) for k in (1, 2, 3)], axis=1)
        runs = [arc(T) + 1e-4 * waves @ rng.standard_normal((3, 3)) for _ in range(10)]
        found = judged(*runs)
        over.append(found.accuracy.found.value > found.accuracy_noise)
    assert sum(over) <= binom.ppf(0.9995, len(over), 0.05)


def test_a_path_of_a_few_millimetres_has_no_direction() -> None:
    short = PathRun(
        T, arc(T) / 20, arc(T) / 20, np.zeros((801, 3)), np.tile(np.eye(3), (801, 1, 1))
    )
    assert crossings([short] * 5) is None
