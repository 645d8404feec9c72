"""Readings interpolated as weighted sums of readings."""

import numpy as np
import pytest

from verify.calibration.registration.model import interpolation_weights
from verify.core.readings import Readings


@pytest.mark.parametrize("count", [1, 2, 3, 4, 40])
def test_the_weighted_readings_are_the_interpolated_ones(count: int) -> None:
    """Between readings, at them, beyond them and in a gap: values are random, none is smooth."""
    rng = np.random.default_rng(count)
    t = np.cumsum(rng.uniform(0.05, 0.15, count))
    t[count // 2 :] += 5.0
    readings = Readings(t, rng.normal(size=(count, 3)))
    instants = np.concatenate([rng.uniform(t[0] - 1, t[-1] + 1, 500), t])
    index, weight = interpolation_weights(readings, instants)
    found = np.einsum("nk,nkj->nj", weight, readings.q[index])
    np.testing.assert_allclose(found, readings.at(instants), atol=1e-12)
