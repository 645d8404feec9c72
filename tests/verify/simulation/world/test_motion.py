import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.simulated import HOME_DEG, scene
from verify.simulation.scenario import (
    ConstantSpeed,
    MotionTable,
    MultiJoint,
    QuarterCircle,
    ScenarioRecording,
    SingleJoint,
    Visits,
)
from verify.simulation.world.motion import MotionProfile, plan_motion

TABLES: list[MotionTable] = [
    QuarterCircle(home_deg=HOME_DEG),
    QuarterCircle(home_deg=HOME_DEG, sweep_deg=-40.0),
    MultiJoint(home_deg=HOME_DEG, amplitude_deg=[20.0] * 6),
    SingleJoint(home_deg=HOME_DEG, amplitude_deg=[20.0, -20.0] * 3),
    Visits(home_deg=HOME_DEG, amplitude_deg=[20.0] * 6),
    ConstantSpeed(home_deg=HOME_DEG, speed_deg_s=[1.0, -2.0, 3.0, 0.0, -1.0, 2.0]),
]


def planned(table: MotionTable) -> MotionProfile:
    return plan_motion(
        scene(motion=table, recording=ScenarioRecording(pairs=25, rate_hz=2.0)), begin=1.0, end=13.0
    )


@pytest.mark.parametrize("table", TABLES, ids=lambda t: type(t).__name__)
def test_direction_is_the_sign_of_the_last_travel_kept_at_rest(table: MotionTable) -> None:
    motion = planned(table)
    t = np.arange(0.0, 14.0, 1e-3)
    steps = np.diff(motion.angles(t), axis=0)
    middle = motion.direction(t[:-1] + 0.5e-3)
    last = np.ones(6)
    for step, message in zip(steps, middle, strict=True):
        moved = np.abs(step) > 1e-7  # rad in 1 ms: below, the turning point itself is within
        last = np.where(moved, np.sign(step), np.where(step == 0, last, message))
        assert np.array_equal(message, last)


@pytest.mark.parametrize("table", TABLES, ids=lambda t: type(t).__name__)
def test_a_motion_never_jumps(table: MotionTable) -> None:
    q = planned(table).angles(np.arange(0.0, 14.0, 1e-3))
    assert np.abs(np.diff(q, axis=0)).max() < np.radians(0.5)


def test_the_quarter_circle_turns_joint_1_by_95_5_degrees_and_holds_the_others() -> None:
    motion = planned(QuarterCircle(home_deg=[0.0, *HOME_DEG[1:]]))
    q = np.degrees(motion.angles(np.linspace(1.0, 13.0, 40)))
    assert_allclose(q[[0, -1], 0], [0.0, 95.5], atol=1e-12)
    assert np.all(np.diff(q[:, 0]) >= 0)
    assert_allclose(q[:, 1:], np.tile(HOME_DEG[1:], (40, 1)), atol=1e-12)


def test_sines_stay_within_the_amplitude_and_use_most_of_it() -> None:
    motion = planned(MultiJoint(home_deg=HOME_DEG, amplitude_deg=[20.0] * 6))
    away = np.degrees(motion.angles(np.arange(0, 600, 0.1))) - HOME_DEG
    assert np.all(np.abs(away) <= 20.0)
    assert np.all(np.abs(away).max(axis=0) > 15.0)


def test_single_joint_sweeps_move_one_joint_at_a_time_both_ways() -> None:
    motion = planned(SingleJoint(home_deg=HOME_DEG, amplitude_deg=[20.0] * 6))
    q = np.degrees(motion.angles(np.arange(1.0, 13.0, 0.01)))
    assert np.all(np.sum(np.abs(np.diff(q, axis=0)) > 1e-9, axis=1) <= 1)
    assert_allclose(q.max(axis=0) - HOME_DEG, 20.0, atol=0.01)
    assert_allclose(q.min(axis=0) - HOME_DEG, -20.0, atol=0.01)


def test_visits_stand_still_around_each_pair() -> None:
    motion = planned(Visits(home_deg=HOME_DEG, amplitude_deg=[20.0] * 6))
    t = 1.0 + np.arange(25) / 2.0
    assert_allclose(motion.angles(t + 0.04), motion.angles(t), atol=0)
    assert np.degrees(np.abs(np.diff(motion.angles(t), axis=0)).mean()) > 5
