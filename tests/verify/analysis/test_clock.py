import numpy as np
import pytest

from tests.support.motions import ARM, HOME, make_track, read, swinging
from verify.analysis.clock.arrivals import clock_from_arrival_times
from verify.analysis.clock.estimate import estimate_clock
from verify.core.readings import Readings
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
        assert estimate.source == "none"
        assert estimate.standard_uncertainty is None


def cycling(t: Array) -> Array:
    """A motion that repeats every 2.5 s."""
    turn = 2 * np.pi * t[:, None] / 2.5
    return HOME + np.deg2rad([12.0, 8.0, 9.0, 12.0, 14.0, 25.0]) * np.sin(turn + np.arange(6))


CYCLES = np.arange(0.0, 15.0, 1 / 15)


@pytest.mark.parametrize("jump_deg", [0.0, 0.8])
def test_of_a_motion_that_repeats_every_offset_that_fits_is_listed(jump_deg: float) -> None:
    rng = np.random.default_rng(5)
    readings = read(cycling, np.arange(-3.0, 18.0, 0.01), -0.042, rng)
    readings.q[readings.t > 5.0, 3] += np.deg2rad(jump_deg)
    estimate = estimate_clock(make_track(CYCLES, cycling(CYCLES), rng), ARM, readings)
    assert estimate.source == "ambiguous"
    assert sorted([estimate.offset, *estimate.rivals]) == pytest.approx(
        [-2.542, -0.042, 2.458], abs=0.01
    )


def test_arrival_times_tell_which_cycle_it_is() -> None:
    rng = np.random.default_rng(6)
    log = np.arange(-3.0, 18.0, 0.01)
    readings = read(cycling, log, -0.042, rng)
    arrival = clock_from_arrival_times(readings.t, log + 0.001 + rng.exponential(0.005, len(log)))
    estimate = estimate_clock(make_track(CYCLES, cycling(CYCLES), rng), ARM, readings, arrival)
    assert (estimate.source, estimate.rivals) == ("estimated", ())
    assert abs(estimate.offset + 0.042) < 1e-3


def test_a_line_that_is_always_late_is_believed_less_than_a_motion_that_does_not_repeat() -> None:
    rng = np.random.default_rng(7)
    readings = read(swinging, LOG, 0.1, rng)
    arrival = clock_from_arrival_times(readings.t, LOG + 1.5)
    estimate = estimate_clock(make_track(PAIRS, swinging(PAIRS), rng), ARM, readings, arrival)
    assert estimate.source == "estimated"
    assert abs(estimate.offset - 0.1) < 1e-3


def test_where_the_motion_shows_no_offset_the_arrival_times_do() -> None:
    rng = np.random.default_rng(8)
    readings = read(at_rest, LOG, 3.0, rng)
    arrival = clock_from_arrival_times(readings.t, LOG + 0.004)
    estimate = estimate_clock(make_track(PAIRS, at_rest(PAIRS), rng), ARM, readings, arrival)
    assert estimate.source == "arrival"
    assert abs(estimate.offset - 3.0) < 2 * (estimate.standard_uncertainty or 0.0)


def visiting(t: Array) -> Array:
    """A posture of its own for each minute, at rest half a minute either side."""
    rng = np.random.default_rng(9)
    postures = HOME + np.deg2rad(rng.uniform(-20, 20, (40, 6)))
    return postures[np.round(t / 60).astype(int)]


def test_a_log_of_visits_that_was_cut_off_is_not_shifted() -> None:
    rng = np.random.default_rng(10)
    visits = 60.0 * np.arange(40)
    readings = read(visiting, visits[:18], 0.0, rng)
    estimate = estimate_clock(make_track(visits, visiting(visits), rng), ARM, readings)
    assert (estimate.source, estimate.offset) == ("none", 0.0)


def test_the_search_ends_whatever_unit_the_times_are_in() -> None:
    rng = np.random.default_rng(11)
    readings = read(swinging, LOG, 0.0, rng)
    in_microseconds = Readings(readings.t * 1e6, readings.q)
    track = make_track(PAIRS, swinging(PAIRS), rng)
    estimate = estimate_clock(track, ARM, in_microseconds)
    assert estimate.source == "none"
    assert len(estimate.curve) < 1000
