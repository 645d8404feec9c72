"""The choice of poses against every other choice, and the motion through them."""

import itertools

import numpy as np
import pytest

import robots
from tests.support.planning import conditions, planned, wish
from verify.planning.constraints import PostureConstraints
from verify.planning.design import DesignInformation, choose_poses, log_information
from verify.planning.plan import SessionPlan
from verify.planning.request import PlanningSetup
from verify.planning.roadmap import MotionStop, clear_legs
from verify.planning.selection import PACES, joint_limits, schedule


def drawn(seed: int, poses: int = 9) -> DesignInformation:
    rng = np.random.default_rng(seed)
    asked, others = rng.normal(size=(poses, 6, 4)), rng.normal(size=(poses, 6, 3))
    rows = np.concatenate([asked * rng.uniform(0.1, 3, (poses, 1, 1)), others], axis=2)
    return DesignInformation(rows, np.full(7, 0.1), 4)


def plainly(known: DesignInformation, chosen: tuple[int, ...]) -> float:
    """Ln det of what is asked for, everything else taken out, written down plainly."""
    rows = known.rows[list(chosen)].reshape(-1, 7)
    covariance = np.linalg.inv(rows.T @ rows + np.diag(known.prior))
    return -float(np.linalg.slogdet(covariance[:4, :4])[1])


@pytest.mark.parametrize("seed", range(4))
def test_no_single_exchange_betters_the_choice(seed: int) -> None:
    known = drawn(seed)
    chosen = choose_poses(known, 4)
    assert len(set(chosen)) == 4
    best = plainly(known, tuple(chosen))
    for place, other in itertools.product(range(4), set(range(9)) - set(chosen)):
        exchanged = [*chosen[:place], other, *chosen[place + 1 :]]
        assert plainly(known, tuple(exchanged)) <= best + 1e-9
    assert log_information(known, chosen) == pytest.approx(best)
    every = max(plainly(known, c) for c in itertools.combinations(range(9), 4))
    assert best > every - 0.1  # of a determinant's logarithm: a local best is near the best


def test_what_only_confounds_is_not_chosen() -> None:
    """A pose that shows what is asked for only together with what is open says nothing."""
    rows = np.zeros((3, 6, 2))  # asked for, and open
    rows[:, 0, 0] = [10.0, 1.0, 1.0]
    rows[0, 0, 1] = 1e4
    assert set(choose_poses(DesignInformation(rows, np.array([0.01, 1e-9]), 1), 2)) == {1, 2}


def test_the_motion_keeps_every_limit(bench: PlanningSetup, made: SessionPlan) -> None:
    t = np.arange(0.0, made.timed.duration, 1e-3)
    q = made.timed.q(t)
    greatest = joint_limits(bench.arm, wish().speed)
    assert robots.within_limits(bench.arm, q).all()
    speed = np.diff(q, axis=0) * 1e3
    acceleration, jerk = np.diff(speed, axis=0) * 1e3, np.diff(speed, 2, axis=0) * 1e6
    assert (np.abs(speed).max(axis=0) <= greatest.speed * 1.001).all()
    assert (np.abs(acceleration).max(axis=0) <= greatest.acceleration * 1.01).all()
    assert (np.abs(jerk).max(axis=0) <= greatest.jerk * 1.05).all()


def test_the_whole_way_is_clear_and_in_view(bench: PlanningSetup, made: SessionPlan) -> None:
    q = np.array([stop.q for stop in made.timed.stops])
    assert clear_legs(PostureConstraints(bench, wish()), q[:-1], q[1:]).all()
    assert {m.status for m in made.prediction.session.measurements} == {"measured"}


def test_every_pose_is_visited_from_either_side_at_varied_speed(made: SessionPlan) -> None:
    visits = [stop.pose for stop in made.timed.stops if stop.pose is not None]
    assert visits == [0, 1, 2, 3, 4, 3, 2, 1, 0]
    assert len(set(made.timed.pace.tolist())) == len(PACES)
    upward = np.mean(made.prediction.session.comparison.direction > 0, axis=0)
    assert ((upward > 0.2) & (upward < 0.8)).all()


def test_it_rests_at_poses_and_nowhere_else(bench: PlanningSetup) -> None:
    q = np.zeros((3, 6))
    q[1, 0], q[2, 0] = 0.3, 0.6
    stops = [MotionStop(q[0], 0), MotionStop(q[1], None), MotionStop(q[2], 1)]
    timed = schedule(stops, joint_limits(bench.arm, 0.5), 2.0)
    np.testing.assert_allclose(timed.leave - timed.arrive, [2.0, 0.0, 2.0])
    middle = np.array([1.0, float(timed.arrive[1] + timed.leave[0]) / 2, timed.duration - 1.0])
    assert timed.resting(middle) == [0, None, 1]
    np.testing.assert_allclose(timed.q(middle)[[0, 2]], q[[0, 2]])


def test_the_arm_s_own_rates_hold() -> None:
    arm = robots.load("rv_3sd_melfa")
    greatest = joint_limits(arm, np.deg2rad(1000.0))
    for own, file in zip(
        (greatest.speed, greatest.acceleration, greatest.jerk),
        (arm.speed, arm.acceleration, arm.jerk),
        strict=True,
    ):
        assert (own <= file).all()


def test_the_same_seed_gives_the_same_plan(bench: PlanningSetup, made: SessionPlan) -> None:
    again = planned(bench, wish(), conditions())
    np.testing.assert_array_equal(again.timed.arrive, made.timed.arrive)
