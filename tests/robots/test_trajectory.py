"""Trajectories and streams: their limits are checked by differentiation, not by ruckig's word."""

import dataclasses

import numpy as np
import pytest
import ruckig
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.interpolate import make_interp_spline

import robots
from robots.trajectory import (
    JointLimits,
    JointMotion,
    JointPath,
    PathLimits,
    Trajectory,
    TrajectoryFollower,
    joint_limits,
    joint_path,
    limit_violation,
    required_slowdown,
    rest_motion,
    time_path,
)
from tests.support.grasp.cells import melfa
from verify.core.records import Array

LIMITS = joint_limits(melfa(), 0.4)
HOME = np.radians([0.0, 0.0, 90.0, 0.0, 90.0, 0.0])
PERIOD = 1 / 30
FINE = 2e-3  # s, of differentiation
RATES = ("q", "velocity", "acceleration")
postures = st.integers(0, 2**32 - 1).map(
    lambda seed: np.random.default_rng(seed).uniform(LIMITS.lower, LIMITS.upper)
)


def assert_within_limits(trajectory: Trajectory, limits: JointLimits = LIMITS) -> float:
    """By differences of the angles alone; the greatest share of a limit that is used."""
    times = np.arange(0.0, trajectory.duration + 4 * FINE, FINE)  # at rest in the end
    q = np.array([trajectory.at(t).q for t in times.tolist()])
    # a difference is a mean of the derivative over the step: it cannot exceed its greatest value
    assert robots.within_limits(melfa(), q).all()
    used = 0.0
    for limit in (limits.speed, limits.acceleration, limits.jerk):
        q = np.diff(q, axis=0) / FINE
        greatest = np.abs(q).max(axis=0)
        assert np.all(greatest <= limit * (1 + 1e-6) + 1e-6)
        used = max(used, float((greatest / limit).max()))
    return used


@settings(max_examples=10)
@given(postures, postures)
def test_from_posture_to_posture_within_limits_and_as_fast_as_one_joint_allows(
    start: Array, end: Array
) -> None:
    assume((start != end).all())
    trajectory = time_path(joint_path(start, end), LIMITS)
    assert_within_limits(trajectory)
    assert_allclose(trajectory.at(0.0).q, start)
    assert_allclose(trajectory.at(trajectory.duration).q, end, atol=1e-9)
    alone = []  # each joint by itself: ruckig in one dimension
    for joint in range(6):
        order = ruckig.InputParameter(1)
        order.current_position, order.target_position = [start[joint]], [end[joint]]
        rates = ([r[joint]] for r in (LIMITS.speed, LIMITS.acceleration, LIMITS.jerk))
        order.max_velocity, order.max_acceleration, order.max_jerk = rates
        curve = ruckig.Trajectory(1)
        ruckig.Ruckig(1).calculate(order, curve)
        alone.append(curve.duration)
    # this arm's three rates stand in one proportion in all joints: the slowest rules throughout
    assert trajectory.duration == pytest.approx(max(alone), rel=1e-9)


def test_all_joints_begin_and_end_together_on_a_straight_line() -> None:
    end = HOME + np.array([0.5, 0.2, -0.3, 0.1, 0.4, -2.0])
    times, motion = time_path(joint_path(HOME, end), LIMITS).sampled(0.01)
    share = (motion.q[1:-1] - HOME) / (end - HOME)
    assert_allclose(share, np.tile(share[:, :1], 6), atol=1e-9)
    assert times[-1] == time_path(joint_path(HOME, end), LIMITS).duration
    assert_allclose(motion.velocity[[0, -1]], 0, atol=1e-12)
    still = time_path(joint_path(HOME, HOME), LIMITS)  # a motion of no length takes no time
    assert_allclose(still.at(still.duration).q, HOME)
    assert not still.at(0.1).velocity.any()


def curved() -> JointPath:
    s = np.linspace(0, 0.2, 15)
    q = HOME + np.stack([np.sin(k * 9 * s) / (1 + k) for k in range(6)], axis=1)
    return JointPath(make_interp_spline(s, q, k=5), 0.2)


def test_a_curved_path_is_bounded_along_its_whole_length() -> None:
    path = curved()
    s = np.linspace(0, path.length, 5001)
    for order, bound in enumerate(path.bounds(), start=1):
        greatest = np.abs(path.derivative(s, order)).max(axis=0)
        assert np.all(greatest <= bound * (1 + 1e-12))
        assert np.all(bound <= 1.5 * greatest)  # near enough to be of use
    low, high = path.range()
    assert np.all(low <= path.q(s).min(axis=0) + 1e-12)
    assert np.all(high >= path.q(s).max(axis=0) - 1e-12)


@pytest.mark.parametrize("speed", [0.02, 0.2, 2.0, 20.0])
def test_a_curved_path_is_slowed_to_the_joints_limits(speed: float) -> None:
    path = curved()
    wanted = PathLimits(speed, 5 * speed, 50 * speed)
    trajectory = time_path(path, LIMITS, wanted)
    assert_within_limits(trajectory)
    assert_allclose(trajectory.at(trajectory.duration).q, path.q(path.length), atol=1e-9)
    slower = max(1.0, required_slowdown(path, LIMITS, wanted))
    assert (slower > 1) == (speed > 0.02)
    assert trajectory.duration >= path.length / speed * slower


@pytest.mark.parametrize(
    ("rates", "gentler"),
    [
        (PathLimits(1.0, 0.5, 1.0), (1, 1, 20)),  # jerk of the path's bends rules
        (PathLimits(0.2, 100.0, 1e4), (1, 1, 20)),  # jerk of the S-curve
        (PathLimits(1.0, 0.5, 1.0), (1, 20, 1)),  # acceleration of the bends
        (PathLimits(1.0, 0.5, 1.0), (20, 1, 1)),  # speed
    ],
)
def test_whichever_limit_rules_is_kept_and_used(
    rates: PathLimits, gentler: tuple[float, float, float]
) -> None:
    keys = ("speed", "acceleration", "jerk")
    changes = {k: getattr(LIMITS, k) / factor for k, factor in zip(keys, gentler, strict=True)}
    limits = dataclasses.replace(LIMITS, **changes)
    # the bound adds up what does not happen at one instant, so some is left: of a jerk up to three
    # quarters, which costs a factor of 1.6 in time
    assert assert_within_limits(time_path(curved(), limits, rates), limits) > 0.25


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.5, 0.7, 0.95, 1.0])
def test_a_hold_stops_on_the_path_within_limits_and_at_once_and_goes_back_along_it(
    share: float,
) -> None:
    path = curved()
    trajectory = time_path(path, LIMITS, PathLimits(1.0, 5.0, 50.0))
    t = share * trajectory.duration
    held = trajectory.stop_at(t)
    before, after = trajectory.at(t), held.at(0.0)
    for key in RATES:
        assert_allclose(getattr(after, key), getattr(before, key), atol=1e-9)
    assert_within_limits(held)
    assert held.duration <= trajectory.duration - t + 1e-6
    end = held.at(held.duration)
    assert_allclose(end.velocity, 0, atol=1e-9)
    on_path = path.q(np.linspace(0, path.length, 20001))
    assert np.abs(on_path - end.q).max(axis=1).min() < 1e-3
    back = held.back()  # along the same path
    assert_allclose(back.at(0.0).q, end.q, atol=1e-9)
    assert_allclose(back.at(back.duration).q, path.q(0.0), atol=1e-9)
    assert_within_limits(back)
    assert trajectory.back().duration == pytest.approx(trajectory.duration)


wild = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@settings(max_examples=20)
@given(wild)
def test_no_goal_leads_out_of_the_limits_and_a_hold_comes_to_rest(
    random: np.random.Generator,
) -> None:
    follower = TrajectoryFollower(LIMITS, HOME, PERIOD, lambda _: "")
    goal: Array | None = None
    for step in range(200):
        if step % int(random.integers(1, 12)) == 0:
            goal = random.choice([random.uniform(-9, 9, 6), LIMITS.upper, LIMITS.lower])
            goal = [goal, goal, goal, None, np.full(6, np.nan)][random.integers(5)]
        before = follower.motion
        now = follower.step(goal, random.uniform(-20, 20, 6)).motion
        assert robots.within_limits(melfa(), now.q)
        assert np.all(np.abs(now.velocity) <= LIMITS.speed + 1e-9)
        assert np.all(np.abs(now.acceleration) <= LIMITS.acceleration + 1e-9)
        jerk = np.abs(now.acceleration - before.acceleration) / PERIOD
        assert np.all(jerk <= LIMITS.jerk * (1 + 1e-9))
        # acceleration within its limits between the steps too: then this is what the step can do
        mean = (now.velocity - before.velocity) / PERIOD
        assert np.all(np.abs(mean) <= LIMITS.acceleration + 1e-9)
        middle = (now.q - before.q) / PERIOD
        assert np.all(np.abs(middle) <= LIMITS.speed + 1e-9)
    for _ in range(60):  # and a hold comes to rest
        held = follower.step(None)
        assert robots.within_limits(melfa(), held.motion.q)
    assert not held.moving
    assert not held.motion.velocity.any()
    assert held.reason == ""


def test_a_goal_at_rest_is_reached_and_one_that_moves_is_kept_up_with() -> None:
    follower = TrajectoryFollower(LIMITS, HOME, PERIOD, lambda _: "")
    goal = HOME + 0.2
    for _ in range(60):
        follower.step(goal)
    assert_allclose(follower.motion.q, goal, atol=1e-9)
    velocity = np.full(6, 0.1)
    for step in range(60):
        # the goal of the end of this step: what is ordered is where the arm will then be
        goal = HOME + 0.2 + velocity * (step + 1) * PERIOD
        follower.step(goal, velocity)
    assert np.abs(follower.motion.q - goal).max() <= 0.1 * PERIOD + 1e-6  # one step of the goal's


def test_a_goal_beyond_a_limit_leads_up_to_it_and_the_other_joints_to_theirs() -> None:
    follower = TrajectoryFollower(LIMITS, HOME, PERIOD, lambda _: "")
    beyond = HOME + 0.3
    beyond[4] = LIMITS.upper[4] + 1.0
    steps = [follower.step(beyond) for _ in range(90)]
    assert not steps[-1].moving
    assert_allclose(follower.motion.q[4], LIMITS.upper[4], atol=1e-5)
    assert_allclose(np.delete(follower.motion.q, 4), HOME[0] + np.delete(HOME + 0.3, 4), atol=1e-9)


def test_an_obstructed_motion_stops_before_the_obstacle_with_a_reason() -> None:
    def clear(q: Array) -> str:
        return "the wall" if q[:, 0].max() > 0.3 else ""

    follower = TrajectoryFollower(LIMITS, HOME, PERIOD, clear)
    steps = [follower.step(HOME + np.eye(6)[0]) for _ in range(90)]
    assert max(step.motion.q[0] for step in steps) <= 0.3
    assert steps[-1].reason == "the wall"
    assert steps[-1].motion.q[0] > 0.2
    assert not steps[-1].moving
    back = [follower.step(HOME) for _ in range(60)]
    assert_allclose(back[-1].motion.q, HOME, atol=1e-9)


def test_an_arm_outside_its_limits_or_not_clear_is_not_followed_with() -> None:
    with pytest.raises(ValueError, match="joint 2 would stand at"):
        TrajectoryFollower(LIMITS, HOME - 2.0, PERIOD, lambda _: "")
    with pytest.raises(ValueError, match="the wall"):
        TrajectoryFollower(LIMITS, HOME, PERIOD, lambda _: "the wall")


def changed(key: str, joint: int, value: float) -> JointMotion:
    motion = rest_motion(np.array([0, 0, 1, 0, 0.5, 0.0]))
    values: Array = getattr(motion, key).copy()
    values[joint] = value
    return dataclasses.replace(motion, **{key: values})


@pytest.mark.parametrize(
    ("key", "joint", "value", "words"),
    [
        ("q", 2, np.radians(-20.5), "joint 3 would stand at −20.5°, allowed is −20 to 171°"),
        ("q", 0, np.nan, "joint 1 would stand at nan°"),
        ("velocity", 1, -2.0, "joint 2 would turn at −114.6°/s"),
        ("velocity", 4, np.inf, "joint 5 would turn at inf°/s"),
        ("acceleration", 5, 30.0, "joint 6 would speed up by 1718.9°/s²"),
    ],
)
def test_a_broken_limit_is_named(key: str, joint: int, value: float, words: str) -> None:
    good, bad = changed("q", 0, 0.0), changed(key, joint, value)
    assert limit_violation(LIMITS, good) == ""
    assert words in limit_violation(LIMITS, bad)
    many = (np.array([getattr(m, k) for m in (good, bad, good)]) for k in RATES)
    assert words in limit_violation(LIMITS, JointMotion(*many))  # one instant among many


def test_a_limit_itself_is_allowed_but_for_rounding() -> None:
    for q in (LIMITS.lower, LIMITS.upper, LIMITS.upper + 1e-9):
        assert limit_violation(LIMITS, rest_motion(q)) == ""
    assert limit_violation(LIMITS, rest_motion(LIMITS.upper + 1e-4))
