"""What a recording still lacks for a registration, from the postures and the readings alone."""

import numpy as np
import pytest

import robots
from verify.calibration.registration.refusals import refuse_undetermined
from verify.core.records import Array
from verify.errors import InputError
from verify.live.registration.goals import (
    MIN_TRAVEL,
    NEW_TURN,
    MotionCoverage,
    RegistrationGoal,
)

ARM = robots.load("rv_3sd_melfa")
HOME = np.deg2rad([10.0, 15.0, 100.0, 20.0, 50.0, 30.0])
NOISE = (3e-4, float(np.deg2rad(0.1)))  # m, rad: of a pose of four LEDs


def covered(motion: Array) -> tuple[MotionCoverage, dict[str, RegistrationGoal]]:
    coverage = MotionCoverage(ARM)
    for q in motion:
        coverage.moved(q)
        coverage.saw(q)
    return coverage, {goal.name: goal for goal in coverage.goals()}


def swing(joints: list[int], degrees: float, count: int = 200) -> Array:
    """Sines of different periods, (count, 6), rad."""
    motion = np.tile(HOME, (count, 1))
    for k, joint in enumerate(joints):
        motion[:, joint - 1] += np.deg2rad(degrees) * np.sin(np.arange(count) / (5.0 + 2.0 * k))
    return motion


def test_a_motion_of_all_joints_has_everything_and_register_takes_it() -> None:
    motion = swing([1, 2, 3, 4, 5, 6], 25.0)
    _, goals = covered(motion)
    assert all(goal.reached and goal.share == 1.0 for goal in goals.values()), goals
    refuse_undetermined(ARM, motion[::5], NOISE, "motion")


def test_one_axis_alone_lacks_the_second_and_register_refuses_it() -> None:
    motion = swing([1], 30.0)
    _, goals = covered(motion)
    assert goals["turn about one axis"].value == pytest.approx(60.0, abs=2 * np.rad2deg(NEW_TURN))
    second = goals["turn about a second axis"]
    assert second.value < 0.01
    assert "move joint" in second.words
    assert "joints 2 and 3 and 4 and 5 and 6" in goals["joints moved both ways"].words
    with pytest.raises(InputError, match="undetermined"):
        refuse_undetermined(ARM, motion[::5], NOISE, "motion")


def test_the_joint_that_is_named_brings_the_second_axis() -> None:
    _, goals = covered(swing([1], 30.0))
    joint = int(goals["turn about a second axis"].remedy.split()[2])
    _, better = covered(swing([1, joint], 20.0))
    assert better["turn about a second axis"].reached


def test_turns_are_measured_in_degrees_of_the_axis() -> None:
    """Joint 6 turns the flange about its own z, whatever else stands where."""
    _, goals = covered(swing([6], 17.0))
    assert 34.0 - 2 * np.rad2deg(NEW_TURN) < goals["turn about one axis"].value < 34.01
    assert goals["positions, two directions"].value < 0.01


def test_one_way_is_not_both_and_noise_is_no_travel() -> None:
    way = np.linspace(0.0, 3 * MIN_TRAVEL, 100)[:, None] + HOME
    _, goals = covered(way)
    assert goals["joints moved both ways"].value == 0
    _, goals = covered(np.concatenate([way, way[::-1]]))
    assert goals["joints moved both ways"].value == 6
    noise = np.random.default_rng(1).normal(0.0, np.deg2rad(0.02), (5000, 6))
    _, goals = covered(HOME + noise[:500])
    assert (goals["joints moved both ways"].value, goals["postures with LEDs"].value) == (0, 1)


def test_standing_still_adds_no_posture_and_postures_without_leds_do_not_count() -> None:
    coverage, _ = covered(np.tile(HOME, (50, 1)))
    for q in swing([1, 2, 3, 4, 5, 6], 25.0):
        coverage.moved(q)
    goals = {goal.name: goal for goal in coverage.goals()}
    assert goals["postures with LEDs"].value == 1
    assert goals["turn about one axis"].value == 0
    assert goals["joints moved both ways"].reached


def test_what_is_shown_as_reached_is() -> None:
    goal = RegistrationGoal("turn", 39.97, 40.0, "°", "move on")
    assert not goal.reached
    assert goal.words == "39° of 40°; move on"
