"""Alarms: the rate that is stated, the joint that is named, and silence that is no "no error"."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.spot_level import RATE, row, streamed
from verify.core.records import Array
from verify.live.alarms.change_detection import Cusum, alarm_threshold, run_length
from verify.live.alarms.innovations import Innovation
from verify.live.alarms.joints import AlarmLimits, JointAlarms
from verify.live.alarms.loss import DeviceWatch, TargetWatch
from verify.live.joint_row import JointRow
from verify.live.protocols import Alarm


def made_rows(seconds: float, seed: int, **how: Any) -> list[JointRow]:
    """Rows of `streamed`, all at once."""
    return list(streamed(seconds, seed, **how))


def alarms(
    rows: list[JointRow], false_alarms_per_hour: float = 0.1, tolerance: float | None = None
) -> list[Alarm]:
    limits = None if tolerance is None else np.full(6, math.radians(tolerance))
    watch = JointAlarms(6, AlarmLimits(false_alarms_per_hour, RATE, limits), itertools.count(1))
    return [alarm for r in rows for alarm in watch.take(r, r.t)]


def test_the_threshold_gives_white_noise_no_more_than_the_stated_alarms() -> None:
    # one sum at a low threshold, so that there are many to count: law, not a copy of the formula
    limit, chance = 4.0, np.random.default_rng(1)
    cusum, false, pairs = Cusum(1, limit), 0, 60_000
    column = np.ones((1, 1))
    for value in chance.normal(0, 1, pairs):
        cusum.take(Innovation(np.array([value]), column))
        if cusum.exceeded:
            false += 1
            cusum.restart()
    expected = 2 * pairs / run_length(limit)  # upward and downward
    assert 0.2 * expected < false <= expected
    assert (
        alarm_threshold(0.1, 30.0, 6) > alarm_threshold(1.0, 30.0, 6) > alarm_threshold(1.0, 1.0, 1)
    )


@pytest.mark.slow
@pytest.mark.parametrize("repeating", [pytest.param(0.0, marks=pytest.mark.long), 0.9])
def test_healthy_joints_raise_no_more_false_alarms_than_stated(repeating: float) -> None:
    hour_share, stated = 200.0 / 3600, 120.0  # many an hour are allowed, so that some could come
    found = [
        a for seed in range(3) for a in alarms(made_rows(200.0, seed, repeating=repeating), stated)
    ]
    assert len(found) <= 3 * hour_share * stated


@pytest.mark.slow
def test_a_bias_within_what_rig_and_leds_state_is_no_alarm() -> None:
    assert alarms(made_rows(60.0, 5, bias=1.5)) == []


def test_the_same_bias_alarms_where_it_is_not_stated() -> None:
    rows = [
        replace(r, evidence=replace(r.evidence, prior=r.evidence.prior[:, :0]))
        for r in made_rows(10.0, 5, bias=1.5)
    ]
    assert alarms(rows)


@pytest.mark.parametrize("joint", range(1, 7))
def test_a_jump_of_half_a_degree_names_its_joint_within_a_second(joint: int) -> None:
    size = math.radians(0.5)
    found = alarms(made_rows(25.0, 7, jump=(20.0, joint, size)))
    first, last = found[0], found[-1]
    assert 20.0 <= first.t <= 20.0 + 4 / RATE
    assert first.joints[0] == joint
    assert last.joints == (joint,)
    assert last.t < 21.5
    assert abs(last.error - size) < 5 * last.standard_uncertainty < size
    assert {a.number for a in found} == {1}  # one alarm, told again as more is known of it


def test_a_second_jump_raises_a_second_alarm() -> None:
    rows = made_rows(40.0, 9, jump=(15.0, 4, math.radians(0.5)))
    more = made_rows(40.0, 9, jump=(15.0, 4, math.radians(1.0)))
    found = alarms([a if a.t < 30.0 else b for a, b in zip(rows, more, strict=True)])
    assert {a.number: a.joints for a in found} == {1: (4,), 2: (4,)}
    second = [a for a in found if a.number == 2]
    assert abs(math.degrees(second[-1].error or 0.0) - 0.5) < 0.1


def swinging(seconds: float, size: Array) -> Iterator[JointRow]:
    """Rows of joints that read off by errors which swing within seconds."""
    for one in made_rows(seconds, 11):
        error = size * np.sin(2 * np.pi * one.t / 4.0 + np.arange(6))
        xi = one.evidence.xi + one.evidence.jacobian @ error
        yield replace(one, evidence=replace(one.evidence, xi=xi))


def test_readings_of_another_motion_are_said_to_be_that_and_once() -> None:
    found = alarms(list(swinging(40.0, np.full(6, np.deg2rad(15.0)))))
    assert all("do not follow" in a.text for a in found)
    assert {a.number for a in found} == {1}
    assert {a.error for a in found} == {None}


def test_an_error_that_swings_is_one_joint_s_and_no_constant() -> None:
    size = np.deg2rad(2.0)
    found = alarms(list(swinging(6.0, size * (np.arange(6) == 2))))
    last = [a for a in found if a.number == 1][-1]
    assert last.joints == (3,)
    assert "by an error that varies" in last.text
    assert last.error is None
    assert not any("from the beginning" in a.text for a in found if a.number > 1)


def test_an_error_beyond_tolerance_raises_an_alarm_until_it_ends() -> None:
    rows = made_rows(10.0, 3, stated=0.3, jump=(3.0, 1, math.radians(1.0)))
    back = made_rows(10.0, 3, stated=0.3)
    found = alarms([a if a.t < 6.0 else b for a, b in zip(rows, back, strict=True)], 0.1, 0.6)
    output = [a for a in found if a.kind == "tolerance"]
    assert [a.joints for a in output] == [(1,), (1,)]
    assert output[0].ended is None
    assert output[1].ended is not None
    assert 3.0 < output[0].t < 5.0


def test_an_error_at_its_tolerance_is_not_beyond_it() -> None:
    rows = made_rows(20.0, 4, stated=0.3, jump=(0.0, 1, math.radians(0.5)))
    found = alarms(rows, 0.1, 0.5)
    assert [a for a in found if a.kind == "tolerance"] == []


def test_a_target_that_is_not_measured_is_an_alarm_with_its_reason() -> None:
    watch = TargetWatch(1.0, itertools.count(1))
    assert watch.look(0.0, 0.0) == []
    lost = replace(row(0.0, np.zeros(6), np.zeros(6), None), status="too_few_leds")
    found = [a for k in range(40) for a in watch.take(lost, k / 30, 0.0)]
    assert len(found) == 1
    assert "too few LEDs" in found[0].text
    back = watch.take(replace(lost, status="measured"), 2.0, 5.0)
    assert [a.ended for a in back] == [5.0]


def test_most_pairs_that_fit_no_pose_are_one_alarm_with_the_likely_cause() -> None:
    watch, t = TargetWatch(1.0, itertools.count(1)), itertools.count(1)
    assert watch.look(0.0, 0.0) == []
    one = row(0.0, np.zeros(6), np.zeros(6), None)

    def take(statuses: list[str]) -> list[Alarm]:
        rows = [replace(one, status=status) for status in statuses]
        return [a for r in rows for a in watch.take(r, next(t) / 30, 5.0)]

    assert take(["measured", "outlier"] * 15) == []
    assert not watch.misfit
    by_chance = ["measured", *["outlier"] * 14, "ambiguous_leds"]  # LEDs placed by hand
    raised = take(by_chance * 4)
    assert [(a.kind, a.number, a.ended) for a in raised] == [("target", 1, None)]
    assert watch.misfit
    assert "of the last 30 pairs fit no pose" in raised[0].text
    assert "LEDs are not where marker.toml has them" in raised[0].text
    assert [(a.number, a.ended) for a in take(["measured"] * 30)] == [(1, 5.0)]
    assert not watch.misfit


def test_a_lost_target_is_revised_once_its_pairs_show_the_likely_cause() -> None:
    watch = TargetWatch(1.0, itertools.count(1))
    assert watch.look(0.0, 0.0) == []
    lost = replace(row(0.0, np.zeros(6), np.zeros(6), None), status="outlier")
    raised = [a for k in range(30) for a in watch.take(lost, k / 5, 0.0)]
    assert [(a.number, a.revised, "marker.toml" in a.text) for a in raised] == [
        (1, False, False),
        (1, True, True),
    ]


def test_where_no_pairs_come_the_target_is_lost_too() -> None:
    watch = TargetWatch(1.0, itertools.count(1))
    assert watch.look(100.0, 0.0) == []
    assert watch.look(100.9, 0.0) == []
    assert [a.kind for a in watch.look(101.1, 0.0)] == ["target"]
    assert watch.look(105.0, 0.0) == []


def test_a_silent_device_is_named_with_its_message() -> None:
    watch = DeviceWatch(1.0, itertools.count(1))
    assert watch.take("left camera", 0.2, "reading", 5.0, 0.0) == []
    output = watch.take("left camera", 1.2, "unplugged", 6.0, 0.0)
    assert [(a.device, "unplugged" in a.text) for a in output] == [("left camera", True)]
    assert watch.take("left camera", 2.2, "unplugged", 7.0, 0.0) == []
    assert [a.ended for a in watch.take("left camera", 0.0, "reading", 8.0, 9.0)] == [9.0]


@pytest.mark.parametrize("rate", [0.5, 0.8, 5.0, 100.0])
def test_a_device_is_silent_by_its_own_period(rate: float) -> None:
    watch, silence, raised = DeviceWatch(1.0, itertools.count(1)), 60.0, []
    for t in np.arange(0.1, silence + 10.0, 0.1).tolist():
        came = np.floor(min(t, silence) * rate) / rate
        raised += [(t, a.ended) for a in watch.take("encoders", t - came, "", t, t)]
    # before the second reading nobody knows how often it gives
    late = [t for t, ended in raised if ended is None and t > 2.0 / rate]
    assert len(late) == 1
    assert silence < late[0] <= silence + max(1.0, 2.0 / rate) + 0.2
