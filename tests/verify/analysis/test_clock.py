from collections.abc import Callable

import numpy as np
import pytest

from tests.support.motions import ARM, HOME, PAIRS, make_track, read, swinging
from verify.analysis.clock.estimate import ClockEstimate, clock_from_arrival_times, estimate_clock
from verify.core.readings import Readings
from verify.core.records import Array

LOG = np.arange(-2.0, 10.0, 0.02)


def estimated(
    seed: int, motion: Callable[[Array], Array], offset: float, t: Array = PAIRS, log: Array = LOG,
    late: Array | float | None = None, error: Array | float = 0.0,
) -> ClockEstimate:  # fmt: skip
    """Estimate the offset from pairs at t and a log, s, whose readings may arrive late by so much.

    error: of the readings, rad.
    """
    rng = np.random.default_rng(seed)
    track, readings = make_track(t, motion(t), rng), read(motion, log, offset, rng, error)
    arrival = None if late is None else clock_from_arrival_times(readings.t, log + late)
    return estimate_clock(track, ARM, readings, arrival)


@pytest.mark.parametrize("offset", [0.137, -0.8, 1731000000.25])
def test_the_offset_comes_back_within_what_is_claimed(offset: float) -> None:
    """The last one is a controller that stamps seconds since 1970."""
    estimate = estimated(3, swinging, offset)
    assert estimate.source == "estimated"
    # stamps of 1.7e9 s are themselves rounded to 2e-7 s
    assert abs(estimate.offset - offset) < 4 * estimate.standard_uncertainty + 1e-6
    assert estimate.standard_uncertainty < 2e-4


@pytest.mark.parametrize("times", [1, 20])
def test_constant_joint_errors_do_not_pass_for_a_clock_error(times: int) -> None:
    error = np.deg2rad([0.5, -0.4, 0.6, 0.3, -0.8, 1.0]) * times
    estimate = estimated(4, swinging, 0.137, error=error)
    assert abs(estimate.offset - 0.137) < 5e-4
    assert estimate.standard_uncertainty < 2e-4


def test_the_claimed_uncertainty_is_the_scatter() -> None:
    estimates = [estimated(seed, swinging, 0.05) for seed in range(40)]
    found = [estimate.offset for estimate in estimates]
    claimed = [estimate.standard_uncertainty or np.nan for estimate in estimates]
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
        estimate = estimated(seed, motion, 0.0)
        assert estimate.source == "none"
        assert estimate.standard_uncertainty is None


def swinging_slowly(t: Array) -> Array:
    """Up to 5°/s: what faults leave makes the offset doubtful by hundredths of a second."""
    turn = 2 * np.pi * t[:, None] * np.array([0.010, 0.021, 0.028, 0.019, 0.025, 0.023])
    return HOME + np.deg2rad([18.0, 12.0, 18.0, 22.0, 24.0, 35.0]) * np.sin(turn + np.arange(6))


def test_a_slow_arm_with_faults_shows_the_offset_as_well_as_it_matters() -> None:
    """Taken as zero, and exact, it would pass for gears and backlash of the joints."""
    t, log = np.arange(1.0, 241.0), np.arange(-2.0, 244.0, 0.02)
    error = 0.02 * swinging_slowly(log) * (np.arange(6) == 1)
    error[log > 100.0, 4] += np.deg2rad(1.0)
    estimate = estimated(7, swinging_slowly, 0.085, t, log, error=error)
    assert estimate.source == "estimated"
    assert estimate.standard_uncertainty is not None
    assert estimate.standard_uncertainty > 0.01
    assert abs(estimate.offset - 0.085) < 3 * estimate.standard_uncertainty
    # deliveries within milliseconds are known better than that
    arrived = estimated(7, swinging_slowly, 0.085, t, log, late=0.004, error=error)
    assert arrived.source == "arrival"
    assert abs(arrived.offset - 0.085) < 0.01


def cycling(t: Array) -> Array:
    """A motion that repeats every 2.5 s."""
    turn = 2 * np.pi * t[:, None] / 2.5
    return HOME + np.deg2rad([12.0, 8.0, 9.0, 12.0, 14.0, 25.0]) * np.sin(turn + np.arange(6))


CYCLES, CYCLES_LOG = np.arange(0.0, 15.0, 1 / 15), np.arange(-3.0, 18.0, 0.01)


@pytest.mark.parametrize("jump_deg", [0.0, 0.8])
def test_of_a_motion_that_repeats_every_offset_that_fits_is_listed(jump_deg: float) -> None:
    jump = np.deg2rad(jump_deg) * np.outer(CYCLES_LOG > 5.0, np.eye(6)[3])
    estimate = estimated(5, cycling, -0.042, CYCLES, CYCLES_LOG, error=jump)
    assert estimate.source == "ambiguous"
    assert sorted([estimate.offset, *estimate.rivals]) == pytest.approx(
        [-2.542, -0.042, 2.458], abs=0.01
    )


def test_arrival_times_tell_which_cycle_it_is() -> None:
    late = 0.001 + np.random.default_rng(6).exponential(0.005, len(CYCLES_LOG))
    estimate = estimated(6, cycling, -0.042, CYCLES, CYCLES_LOG, late)
    assert (estimate.source, estimate.rivals) == ("estimated", ())
    assert abs(estimate.offset + 0.042) < 1e-3


def test_a_line_that_is_always_late_is_believed_less_than_a_motion_that_does_not_repeat() -> None:
    estimate = estimated(7, swinging, 0.1, late=1.5)
    assert estimate.source == "estimated"
    assert abs(estimate.offset - 0.1) < 1e-3


def test_where_the_motion_shows_no_offset_the_arrival_times_do() -> None:
    estimate = estimated(8, at_rest, 3.0, late=0.004)
    assert estimate.source == "arrival"
    assert abs(estimate.offset - 3.0) < 2 * (estimate.standard_uncertainty or 0.0)


def visiting(t: Array) -> Array:
    """A posture of its own for each minute, at rest half a minute either side."""
    rng = np.random.default_rng(9)
    postures = HOME + np.deg2rad(rng.uniform(-20, 20, (40, 6)))
    return postures[np.round(t / 60).astype(int)]


def test_a_log_of_visits_that_was_cut_off_is_not_shifted() -> None:
    visits = 60.0 * np.arange(40)
    estimate = estimated(10, visiting, 0.0, visits, visits[:18])
    assert (estimate.source, estimate.offset) == ("none", 0.0)


@pytest.mark.parametrize("log", [LOG[LOG < 2.5], LOG[LOG > 5.2]], ids=["ends early", "begins late"])
def test_a_log_that_covers_a_quarter_of_the_pairs_shows_the_offset(log: Array) -> None:
    estimate = estimated(12, swinging, 0.137, log=log)
    assert (estimate.source, estimate.rivals) == ("estimated", ())
    assert abs(estimate.offset - 0.137) < 4 * (estimate.standard_uncertainty or 0.0)


def test_the_search_ends_whatever_unit_the_times_are_in() -> None:
    rng = np.random.default_rng(11)
    readings = read(swinging, LOG, 0.0, rng)
    in_microseconds = Readings(readings.t * 1e6, readings.q)
    track = make_track(PAIRS, swinging(PAIRS), rng)
    estimate = estimate_clock(track, ARM, in_microseconds)
    assert estimate.source == "none"
    assert len(estimate.curve) < 1000
