"""Rows that a log repeats are told from a coarse read-out and from an arm at rest."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.motions import read, swinging
from verify.core.records import Array
from verify.errors import InputError
from verify.io.left_out import find_leap, find_repeats, without_turns
from verify.io.series import read_encoders

T = np.arange(0.0, 8.0, 0.02)
RNG = np.random.default_rng(1)


def renewed(period: float) -> Array:
    """Readings (400, 6), rad, that the controller renews so often, s, and the log asks at T."""
    held = np.floor(T / period + 1e-9) * period
    return read(swinging, np.unique(held), 0.0, RNG).q[np.unique(held, return_inverse=True)[1]]


@pytest.mark.parametrize("period", [0.04, 0.1, 0.03])
def test_the_first_row_of_each_renewal_is_left(period: float) -> None:
    q = renewed(period)
    repeats, found = find_repeats(T, q)
    assert found == pytest.approx(period, abs=0.011)  # it shows to half a row
    assert np.array_equal(~repeats, np.append(True, np.diff(q, axis=0).any(axis=1)))


def slow_and_coarse() -> Array:
    """One joint at 2°/s, read to 0.1°."""
    q = np.zeros((len(T), 6))
    q[:, 0] = np.deg2rad(np.round(2.0 * T, 1))
    return q


def from_rest_to_rest() -> Array:
    """A second of motion, a second of rest, and so on, without noise."""
    return swinging(np.cumsum(np.where(T % 2 < 1, 0.02, 0.0)))


@pytest.mark.parametrize("q", [slow_and_coarse(), from_rest_to_rest(), np.zeros((len(T), 6))])
def test_a_coarse_read_out_and_rest_are_no_repeats(q: Array) -> None:
    repeats, period = find_repeats(T, q)
    assert not repeats.any()
    assert period == 0.0


def test_rest_is_kept_where_readings_repeat() -> None:
    q = renewed(0.1)
    q[150:250] = q[150]
    assert not find_repeats(T, q)[0][165:240].any()


def test_a_log_without_its_repeats_has_doubtful_times_and_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "encoders.csv"
    header = "t_s," + ",".join(f"q{i}_deg" for i in range(1, 7))
    rows = np.column_stack([T, np.rad2deg(renewed(0.1))])
    np.savetxt(path, rows, "%.6f", ",", header=header, comments="")
    readings, warnings = read_encoders(path, 6)
    assert len(readings) == 80
    assert readings.late == pytest.approx(0.02 / np.sqrt(12))
    assert any("renews them every 100 ms" in warning for warning in warnings)


def test_a_counter_that_begins_again_is_no_motion() -> None:
    q = np.cumsum(np.full((len(T), 6), np.deg2rad(1.2)), axis=0)
    wrapped = np.arctan2(np.sin(q), np.cos(q))
    assert np.abs(np.diff(wrapped, axis=0)).max() > np.pi
    assert without_turns(T, wrapped) == pytest.approx(q)
    spiked = q.copy()
    spiked[100, 2] += np.deg2rad(180.0)
    assert np.array_equal(without_turns(T, spiked), spiked)
    visits = np.arange(len(T)) * 2.0  # between which an arm may make a turn
    assert np.array_equal(without_turns(visits, wrapped), wrapped)


def test_times_that_leap_while_the_motion_goes_on_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "encoders.csv"
    q = read(swinging, T, 0.0, RNG).q
    header = "t_s," + ",".join(f"q{i}_deg" for i in range(1, 7))
    rows = np.column_stack([T + 5.0 * (T > 3.0), np.rad2deg(q)])
    np.savetxt(path, rows, "%.6f", ",", header=header, comments="")
    with pytest.raises(InputError, match=r"leaps by 5\.000 s to 8\.0\d.* subtract 5\.000 s"):
        read_encoders(path, 6)
    gap = (T < 3.0) | (T > 4.5)  # not logged for a while
    assert find_leap(T[gap], q[gap]) is None


def test_a_pause_of_a_log_that_is_written_on_change_is_no_leap_of_its_times() -> None:
    t = np.arange(0.0, 12.0, 0.001)
    angle = np.where(t < 6.0, np.minimum(t, 4.0), t - 2.0)  # on the same way after two seconds
    angle = np.convolve(np.pad(angle, 200, mode="edge"), np.ones(401) / 401, "valid")
    steps = np.floor(20 * angle)
    rows = np.flatnonzero(np.diff(steps, prepend=-1.0))
    assert np.diff(t[rows]).max() > 1.5
    assert find_leap(t[rows], np.deg2rad(np.repeat(steps[rows][:, None], 6, axis=1))) is None
