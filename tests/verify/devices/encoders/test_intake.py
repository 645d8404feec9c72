import numpy as np

from tests.support.devices.bench import same_angles
from verify.devices.encoders.intake import (
    AHEAD,
    LEAP,
    STALE,
    TOO_LATE,
    AngleMap,
    ControllerClock,
    ControllerInstant,
    IntakeCounts,
    ReadingIntake,
)


def take(intake: ReadingIntake, t: float, degrees: float) -> int:
    return len(intake.take(ControllerInstant(t, 0), t, 0.0, np.deg2rad([degrees, 0.0])))


def test_an_impossible_jump_is_dropped_alone() -> None:
    counts = IntakeCounts()
    intake = ReadingIntake(same_angles(2), counts)
    taken = [take(intake, 0.01 * i, 90.0 if i == 7 else 0.1 * i) for i in range(20)]
    assert taken == [1] * 7 + [0] + [1] * 12
    assert counts.bad[LEAP] == 1


def test_a_lasting_jump_is_accepted() -> None:
    intake = ReadingIntake(same_angles(2), IntakeCounts())
    assert [take(intake, 0.01 * i, 0.0 if i < 3 else 90.0) for i in range(10)] == [
        1, 1, 1, 0, 0, 0, 0, 1, 1, 1,
    ]  # fmt: skip


def test_the_quickest_joint_of_the_rv_3sd_and_a_turn_past_zero_are_no_leaps() -> None:
    intake = ReadingIntake(same_angles(2), IntakeCounts())
    assert all(take(intake, 0.01 * i, 660.0 * 0.01 * i) for i in range(50))
    intake = ReadingIntake(same_angles(2), IntakeCounts())
    assert all(take(intake, 0.01 * i, (358.0 + i) % 360) for i in range(10))


def test_sign_and_zero_are_the_robot_files() -> None:
    angles = AngleMap(np.array([1.0, -1.0]), np.deg2rad([0.0, 90.0]))
    np.testing.assert_allclose(angles.joint_angles(np.deg2rad([10.0, 20.0])), np.deg2rad([10, 70]))


WRAP = 2**32 * 1e-6  # s


def times(
    clock: ControllerClock, stamps: list[tuple[float, float]]
) -> list[ControllerInstant | str]:
    return [clock.stamp(raw, t_host) for raw, t_host in stamps]


def accepted(found: list[ControllerInstant | str]) -> list[ControllerInstant]:
    return [instant for instant in found if isinstance(instant, ControllerInstant)]


def test_a_counter_that_wraps_goes_on() -> None:
    clock, start = ControllerClock(WRAP), WRAP - 0.5
    t = np.arange(0.0, 2.0, 0.01)
    found = accepted(times(clock, [((start + s) % WRAP, 100 + s) for s in t.tolist()]))
    assert len(found) == len(t)
    assert {instant.segment for instant in found} == {0}
    np.testing.assert_allclose([instant.t - start for instant in found], t, atol=1e-6)


def test_missed_counter_wraps_are_counted() -> None:
    clock = ControllerClock(WRAP)
    away = 2.3 * WRAP  # nearly three hours of silence
    first, later = accepted(times(clock, [(10.0, 0.0), ((10.0 + away) % WRAP, away + 0.01)]))
    assert later.segment == 0
    np.testing.assert_allclose(later.t - first.t, away)


def test_a_crystal_that_drifts_a_day_is_one_segment() -> None:
    for drift in (-1e-4, 1e-4):
        clock = ControllerClock(WRAP)
        t = np.arange(0.0, 86400.0, 0.5)
        late = 0.016 * np.random.default_rng(1).random(len(t))
        raw = (t * (1 + drift)) % WRAP
        found = times(clock, list(zip(raw.tolist(), (t + late).tolist(), strict=True)))
        assert len(accepted(found)) == len(t)
        assert {instant.segment for instant in accepted(found)} == {0}


def test_a_clock_jump_begins_a_segment_without_false_times() -> None:
    for leap, reason in ((5.0, AHEAD), (-5.0, STALE), (-0.5, STALE), (0.3, AHEAD)):
        clock = ControllerClock(WRAP)
        t = np.arange(0.0, 2.0, 0.01)
        raw = 100 + t + np.where(t < 1.0, 0.0, leap)
        found = times(clock, list(zip(raw.tolist(), t.tolist(), strict=True)))
        assert reason in found
        for instant, s in zip(found, t.tolist(), strict=True):
            if isinstance(instant, ControllerInstant):
                expected = 100 + s + (leap if instant.segment else 0.0)
                assert abs(instant.t - expected) < 1e-9
        assert accepted(found)[-1].segment == 1


def test_one_stamp_out_of_place_is_refused_alone() -> None:
    clock = ControllerClock(WRAP)
    found = times(clock, [(0.1 * i, 0.1 * i) for i in range(1, 20)])
    assert clock.stamp(7.0, 2.0) == AHEAD
    assert clock.stamp(0.5, 2.0) == STALE
    assert clock.stamp(1.9, 2.0) == STALE  # said twice
    assert clock.stamp(2.0, 2.0) == ControllerInstant(2.0, 0)
    assert len(accepted(found)) == 19


def test_a_late_burst_does_not_begin_a_segment() -> None:
    clock = ControllerClock(WRAP)
    times(clock, [(0.01 * i, 0.01 * i) for i in range(100)])
    lump = times(clock, [(0.01 * i, 3.0) for i in range(100, 300)])
    assert TOO_LATE in lump
    assert isinstance(lump[-1], ControllerInstant)
    assert {instant.segment for instant in accepted(lump)} == {0}


def test_a_clock_set_back_during_a_silence_is_found_out() -> None:
    clock = ControllerClock(WRAP)
    times(clock, [(100 + 0.01 * i, 0.01 * i) for i in range(100)])
    found = times(clock, [(101.5 + 0.01 * i, 601.0 + 0.01 * i) for i in range(300)])
    assert found[0] == TOO_LATE
    assert found[-1].segment == 1
    assert {instant.segment for instant in accepted(found)} == {1}


def test_readings_that_begin_in_a_burst_are_one_segment() -> None:
    clock = ControllerClock(WRAP)
    late = times(clock, [(0.01 * i, 1.0) for i in range(100)])
    found = late + times(clock, [(0.01 * i, 0.01 * i) for i in range(100, 200)])
    assert len(accepted(found)) == 200
    assert {instant.segment for instant in accepted(found)} == {0}


def test_a_file_in_slow_bursts_is_one_segment() -> None:
    clock = ControllerClock(None, in_lumps=True)
    stamps = [(0.5 * i, 20.0 * (1 + i // 40)) for i in range(400)]
    assert {instant.segment for instant in accepted(times(clock, stamps))} == {0}
    assert len(accepted(times(clock, [(200.0 + t, host) for t, host in stamps]))) == 400
