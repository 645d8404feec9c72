import numpy as np
import pytest

from tests.support.motions import ARM, HOME, make_track, read, swinging
from verify.analysis.clock import estimate_clock
from verify.core.records import Array

PAIRS = np.arange(1.0, 7.0, 1 / 15)
LOG = np.arange(-2.0, 10.0, 0.02)


@pytest.mark.parametrize("offset", [0.137, -0.8, 1731000000.25])
def test_the_offset_comes_back_within_what_is_claimed(offset: float) -> None:
    """The last one is a controller that stamps seconds since 1970."""
    rng = np.random.default_rng(3)
    track = make_track(PAIRS, swinging(PAIRS), rng)
    estimate = estimate_clock(track, ARM, read(swinging, LOG, offset, rng))
    assert estimate.source == "estimated"
    assert estimate.standard_uncertainty is not None
    # stamps of 1.7e9 s are themselves rounded to 2e-7 s
    assert abs(estimate.offset - offset) < 4 * estimate.standard_uncertainty + 1e-6
    assert estimate.standard_uncertainty < 2e-4


def test_constant_joint_errors_do_not_pass_for_a_clock_error() -> None:
    rng = np.random.default_rng(4)
    track = make_track(PAIRS, swinging(PAIRS), rng)
    error = np.deg2rad([0.5, -0.4, 0.6, 0.3, -0.8, 1.0])
    estimate = estimate_clock(track, ARM, read(swinging, LOG, 0.137, rng, error))
    assert abs(estimate.offset - 0.137) < 5e-4


def test_the_claimed_uncertainty_is_the_scatter() -> None:
    found, claimed = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        track = make_track(PAIRS, swinging(PAIRS), rng)
        estimate = estimate_clock(track, ARM, read(swinging, LOG, 0.05, rng))
        found.append(estimate.offset)
        claimed.append(estimate.standard_uncertainty or np.nan)
    # forty draws know a standard deviation to 11 %
    assert 0.7 < np.std(found) / np.mean(claimed) < 1.35
    assert abs(np.mean(found) - 0.05) < 4 * np.mean(claimed) / np.sqrt(40)


def at_rest(t: Array) -> Array:
    return np.tile(HOME, (len(t), 1))


def at_constant_speed(t: Array) -> Array:
    return HOME + np.deg2rad([4.0, 0, 0, 0, 0, 0]) * t[:, None]


@pytest.mark.parametrize("motion", [at_rest, at_constant_speed], ids=["rest", "constant speed"])
def test_a_motion_without_information_on_the_clock_is_reported(motion) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        track = make_track(PAIRS, motion(PAIRS), rng)
        estimate = estimate_clock(track, ARM, read(motion, LOG, 0.0, rng))
        assert estimate.source == "not_observable"
        assert estimate.standard_uncertainty is None
