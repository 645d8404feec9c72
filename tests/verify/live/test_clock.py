"""The clock while it runs and its readings: drift followed, jumps believed, resets begun anew."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support import spot_level
from tests.support.spot_level import OFFSET, SpotRun, facing_rig
from verify.analysis.clock.estimate import ClockEstimate
from verify.devices.protocols import EncoderReading
from verify.live.alarms.joints import AlarmLimits
from verify.live.buffers import ReadingBuffer, ReadingSeries
from verify.live.clock import U_ARRIVAL, ClockLine, LiveClock, clock_from_arrivals


def estimate(offset: float, u: float = 1e-4) -> ClockEstimate:
    return ClockEstimate(offset, u, "estimated", np.zeros((0, 2)))


def test_a_drifting_clock_is_carried_to_now_within_what_is_claimed() -> None:
    line, chance = ClockLine(), np.random.default_rng(3)
    drift, misses = 8e-5, []
    for t in np.arange(5.0, 120.0, 3.0):
        line.add(t, estimate(0.2 + drift * t + chance.normal(0, 1e-4)), 1.0)
        value, u = line.at(t + 5.0)
        misses.append((value - 0.2 - drift * (t + 5.0)) / u)
    assert line.drift == pytest.approx(drift, abs=2e-5)
    assert np.sqrt(np.mean(np.square(misses))) < 1.5


def test_the_claimed_uncertainty_grows_with_the_time_since_the_last_estimate() -> None:
    line = ClockLine()
    line.add(10.0, estimate(0.1), 1.0)
    assert line.at(10.0)[1] == pytest.approx(1e-4, rel=0.01)
    assert line.at(70.0)[1] > 1e-3


def test_an_offset_that_the_motion_does_not_show_changes_nothing() -> None:
    line = ClockLine()
    line.add(10.0, ClockEstimate(0.0, None, "none", np.zeros((0, 2))), 1.0)
    assert len(line) == 0
    with pytest.raises(ValueError, match="no offset"):
        line.at(10.0)


def test_a_clock_that_jumps_begins_a_new_line() -> None:
    line = ClockLine()
    for t in (5.0, 8.0, 11.0):
        line.add(t, estimate(0.1), 1.0)
    line.add(14.0, estimate(0.3), 1.0)
    assert line.at(14.0)[0] == pytest.approx(0.3, abs=1e-6)


def reading(t: float, late: float, segment: int = 0) -> EncoderReading:
    return EncoderReading(t, t + 5.0 + late, 50e-6, segment, np.zeros(6))


def test_before_an_estimate_the_quickest_delivery_is_the_offset() -> None:
    book = ReadingBuffer()
    for k, late in enumerate((0.004, 0.001, 0.009)):
        book.add(reading(0.01 * k, late))
    delay = book.least_delay()
    assert delay == pytest.approx(5.001)
    clock = clock_from_arrivals(5.001, 50e-6, 0)
    assert abs(clock.offset - 5.0) < 2 * U_ARRIVAL
    assert clock.source == "arrival"


def test_a_reset_controller_starts_the_book_anew() -> None:
    book = ReadingBuffer()
    for k in range(10):
        book.add(reading(100 + 0.01 * k, 0.001))
    book.add(reading(0.0, 0.001, segment=1))
    assert book.segment == 1
    kept = book.since(-1e9)
    assert kept.t.tolist() == [0.0]


def test_readings_that_do_not_rise_are_left_out() -> None:
    book = ReadingBuffer()
    for t in (0.0, 0.02, 0.01, 0.02, 0.03):
        book.add(reading(t, 0.001))
    kept = book.since(-1.0)
    assert kept.t.tolist() == [0.0, 0.02, 0.03]


def test_readings_before_a_silence_do_not_count_after_it() -> None:
    book = ReadingBuffer()
    for t in (*np.arange(0.0, 1.0, 0.1), *np.arange(3.0, 3.25, 0.1)):
        book.add(reading(float(t), 0.001))
    about = book.about(2.9)
    assert about.t.tolist() == pytest.approx([3.0, 3.1, 3.2])
    assert not about.available(np.array([0.95, 2.9])).any()


def test_a_readings_time_is_known_as_badly_as_that_of_its_worse_neighbour() -> None:
    book = ReadingBuffer()
    assert book.half_width_about(0.0) == 0.0
    for number, width in enumerate((0.001, 0.008, 0.002, 0.001)):
        book.add(replace(reading(0.1 * number, 0.001), half_width=width))
    about = [book.half_width_about(t) for t in (-0.1, 0.05, 0.15, 0.25, 0.3, 0.35)]
    assert about == [0.001, 0.008, 0.008, 0.002, 0.002, 0.001]


def test_no_one_waits_longer_than_agreed_for_a_reading() -> None:
    book = ReadingBuffer()
    book.add(reading(0.0, 0.001))
    assert book.wait_past(1.0, deadline=0.0) is None
    assert book.wait_past(0.0, deadline=0.0) == 5.001


def test_a_series_of_readings_holds_what_a_list_would() -> None:
    rng, store, kept = np.random.default_rng(4), ReadingSeries(), []
    assert store.copied(0) is None
    for number in range(3000):
        q = rng.normal(size=6)
        store.add(EncoderReading(0.01 * number, 0.0, 0.0, 0, q))
        kept.append((0.01 * number, q))
        if number % 7 == 0:
            store.drop_before(0.01 * (number - 500))
            kept = [row for row in kept if row[0] >= 0.01 * (number - 500)]
        if number % 101 == 0:
            begin = int(rng.integers(0, len(kept)))
            copied = store.copied(begin)
            assert copied.t.tolist() == [t for t, _ in kept[begin:]]
            np.testing.assert_array_equal(copied.q, [q for _, q in kept[begin:]])
    assert store.copied(len(kept)) is None


def test_a_joint_that_is_counted_anew_goes_on() -> None:
    book, t = ReadingBuffer(), np.arange(0.0, 4.0, 0.02)
    q = np.stack([np.pi * np.sin(2 * t), 0.3 * t, 7 * np.sin(t), np.cos(t)], axis=1)
    counted = np.arctan2(np.sin(q), np.cos(q))
    assert np.abs(np.diff(counted, axis=0)).max() > 6
    for at, angles in zip(t.tolist(), counted, strict=True):
        book.add(EncoderReading(at, at, 0.0, 0, angles))
    readings = book.since(0.0)
    assert readings is not None
    np.testing.assert_allclose(readings.q, q, atol=1e-12)


def test_readings_that_were_copied_stay_as_they_were() -> None:
    store = ReadingSeries()
    store.add(EncoderReading(1.0, 0.0, 0.0, 0, np.ones(6)))
    copied = store.copied(0)
    store.drop_before(2.0)
    store.add(EncoderReading(2.0, 0.0, 0.0, 0, np.zeros(6)))
    assert copied.t.tolist() == [1.0]
    assert copied.q.tolist() == [[1.0] * 6]
    assert store.t.tolist() == pytest.approx([2.0])


def test_the_offset_is_found_while_the_robot_moves() -> None:
    rig, marker = facing_rig()
    run = SpotRun(rig, marker, rate=15.0)
    rows, _, keeper = run.watch(8.0, AlarmLimits(0.1, 15.0, None))
    sources = [row.clock.source for row in rows if row.clock is not None]
    assert sources[0] == "arrival"
    assert sources[-1] == "estimated"
    last = rows[-1].clock
    assert abs(last.offset - OFFSET) < 4 * last.standard_uncertainty < 4e-3
    assert keeper.trouble == ""


def test_a_short_cycle_never_leads_farther_than_the_arrivals_allow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(spot_level, "PERIOD", np.full(6, 2.4))
    run = SpotRun(*facing_rig(), rate=15.0)
    rows, _, keeper = run.watch(14.0, AlarmLimits(0.1, 15.0, None))
    clocks = [row.clock for row in rows if row.clock is not None]
    assert clocks[-1].source == "estimated"
    assert max(abs(clock.offset - OFFSET) for clock in clocks) < 2 * U_ARRIVAL
    assert not keeper.trouble


def test_an_offset_that_arrivals_exclude_is_said_and_not_taken() -> None:
    run = SpotRun(*facing_rig(), rate=15.0)
    run.estimator = lambda _request: estimate(OFFSET - 4.6)
    rows, _, keeper = run.watch(8.0, AlarmLimits(0.1, 15.0, None))
    last = rows[-1].clock
    assert last.source == "arrival"
    assert (last.standard_uncertainty or 0.0) > 2.0
    assert "-4.6" in keeper.trouble


def test_a_line_on_the_terminal_gives_clock_and_u_to_one_decimal_place() -> None:
    assert LiveClock(-0.041998, 3.85e-4, "estimated").words() == (
        "estimated -42.00 ms ± 0.77 ms (k = 2)"
    )
    assert LiveClock(0.0, None, "given").words() == "given 0.00 ms"
