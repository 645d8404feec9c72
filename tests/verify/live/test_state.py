"""Percentiles of how long results take, against numpy's own of the same values."""

import numpy as np
import pytest

from verify.live.state import MAX_RESULTS, Latency


def test_a_whole_run_has_the_percentiles_of_all_its_results() -> None:
    random = np.random.default_rng(20)
    latency = Latency()
    values = np.concatenate([random.gamma(4.0, 0.002, 5000), [3.0, 0.0]])
    for value in values:
        latency.add(float(value))
    p50, p99 = np.percentile(values, [50, 99])
    assert latency.of_all() == pytest.approx((p50, p99), abs=2e-4)
    p50, p99 = np.percentile(values[-MAX_RESULTS:], [50, 99])
    assert latency.percentiles() == pytest.approx((p50, p99))


def test_before_the_first_result_there_are_none() -> None:
    assert Latency().of_all() is None
    assert Latency().percentiles() is None
