"""From a target's place to a checked plan, or to the reason why there is none."""

import dataclasses
import json
from itertools import pairwise
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import robots
from robots.trajectory import TrajectoryFollower, joint_limits, limit_violation
from tests.support.grasp.cells import DOCS, cap, changed, home, melfa, setup
from tests.support.scene import make_rig
from verify.core.rig import Covariance
from verify.errors import InputError
from verify.grasping.planning.object import (
    GraspObject,
    GraspRefusal,
    GripMargin,
    RefusalKind,
    grip_margin,
    object_from_target,
    point_in_base,
)
from verify.grasping.planning.plan import (
    GraspPlan,
    HoverPlanner,
    plan_grasp,
)
from verify.grasping.planning.workspace import RESOLUTION, Workspace, make_workspace
from verify.grasping.record.rows import plan_fields
from verify.grasping.tracking.target import TargetObservation

PERIOD = 1 / 30


@pytest.fixture
def made(tmp_path: Path) -> Workspace:
    return setup(tmp_path)


def planned(made: Workspace, thing: GraspObject) -> GraspPlan:
    found = plan_grasp(made, thing, home(made))
    assert isinstance(found, GraspPlan), found
    return found


def refused(made: Workspace, thing: GraspObject) -> GraspRefusal:
    found = plan_grasp(made, thing, home(made))
    assert isinstance(found, GraspRefusal)
    return found


@pytest.mark.parametrize("place", [(0.45, 0.0), (0.40, 0.2), (0.52, -0.15), (0.37, -0.25)])
def test_a_plan_goes_over_down_and_up_within_limits_and_clear(
    made: Workspace, place: tuple[float, float]
) -> None:
    found = planned(made, cap(*place))
    trajectories = [*found.over, found.down, found.up]
    assert_allclose(trajectories[0].at(0.0).q, home(made))
    for before, after in pairwise(trajectories):
        assert_allclose(before.at(before.duration).q, after.at(0.0).q, atol=1e-7)
    for trajectory in trajectories:
        _, motion = trajectory.sampled(0.01)
        assert limit_violation(made.limits, motion) == ""
        assert made.margins(motion.q).min() >= -RESOLUTION
        assert_allclose(motion.velocity[[0, -1]], 0, atol=1e-9)
    grip = made.grip(found.down.at(found.down.duration).q)
    assert_allclose(grip[:3, 3], [*place, 0.03], atol=5e-5)
    assert_allclose(grip[:3, 2], [0, 0, -1], atol=5e-4)
    assert len(found.rejected) == 7
    times, motion = found.down.sampled(0.01)  # straight, with the speed that the cell asks
    path = made.grip(motion.q)[:, :3, 3]
    assert np.abs(path[:, :2] - place).max() < 5e-5
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1)[:-1] / np.diff(times)[:-1]
    assert speed.max() == pytest.approx(0.05, rel=1e-3)
    assert found.slowed == 1.0


def test_a_descent_that_the_joints_cannot_follow_is_slowed(made: Workspace) -> None:
    fast = msgspec.structs.replace(made.cell.approach, speed=0.15, acceleration=0.6, jerk=3.0)
    found = planned(changed(made, approach=fast), cap())
    assert 1 < found.slowed <= 4
    assert limit_violation(made.limits, found.down.sampled(0.005)[1]) == ""


def test_a_low_object_is_gripped_as_low_as_the_tips_allow(made: Workspace) -> None:
    found = planned(made, cap(z=0.010))
    assert found.margin.raised == pytest.approx(0.008)
    assert_allclose(found.margin.grip, [0.45, 0.0, 0.018])
    tips = made.grip(found.posture.q_grip)[2, 3] - made.cell.gripper.tips
    assert tips == pytest.approx(made.cell.table.finger_clearance)


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"width": 0.12}, "width", "it is 120.0 mm wide; the gripper opens 110.0 mm"),
        ({"width": np.nan}, "unknown", "size is not known"),
        ({"position": np.full(3, np.nan)}, "unknown", "place is not known"),
        ({"position": np.array([0.6, 0.0, 0.03])}, "workspace", "40.0 mm outside"),
        ({"position": np.array([0.45, 0.31, 0.03])}, "workspace", "10.0 mm outside"),
        ({"position": np.array([0.45, 0.0, -0.001])}, "workspace", "1.0 mm outside"),
        ({"position": np.array([0.45, 0.0, 0.002])}, "table", "lies too flat"),
        ({"length": 0.2}, "length", "towards the palm"),
        ({"covariance": np.eye(3) * 0.02**2}, "uncertainty", "sideways (95%)"),
        ({"covariance": np.diag([0, 0, 0.009]) ** 2}, "uncertainty", "along the approach (95%)"),
        ({"position": np.array([0.34, 0.0, 0.03])}, "reach", "no posture of the arm can grasp it"),
    ],
)
def test_a_grasp_is_refused_with_the_reason(
    made: Workspace, changes: dict[str, object], kind: str, words: str
) -> None:
    found = refused(made, cap(**changes))
    assert found.kind == kind
    assert words in found.reason
    assert len(found.branches) == (8 if kind == "reach" else 0)
    assert all(message for _, message in found.branches)
    outside = plan_grasp(made, cap(), np.radians([0, -80.0, 90, 0, 90, 0]))
    assert outside.kind == "way"
    assert "cannot begin where it stands" in outside.reason


def test_a_way_that_is_not_clear_leads_through_home(made: Workspace) -> None:
    """A camera on a stand in the middle: from one side to the other the arm must go around."""
    side = np.radians([-32.0, 25.0, 95.0, 0.0, 60.0, 0.0])
    direct = plan_grasp(made, cap(0.42, 0.25), side)
    assert len(direct.over) == 1
    path = direct.over[0].path
    middle = made.grip(path.q(0.5))[:3, 3]
    camera = middle + np.array([0.02, 0.0, -0.15])
    blocked = changed(made, camera[None])
    assert blocked.along(path) != ""
    found = plan_grasp(blocked, cap(0.42, 0.25), side)
    assert len(found.over) == 2
    for part in found.over:
        assert blocked.along(part.path) == ""
    homeless = msgspec.structs.replace(made.cell.moving, home_deg=None)
    stuck = plan_grasp(changed(blocked, moving=homeless), cap(0.42, 0.25), side)
    assert stuck.kind == "way"
    assert "camera 1" in stuck.reason


@pytest.mark.slow
def test_the_stated_coverage_is_kept_by_what_is_not_refused(made: Workspace) -> None:
    """Draw targets and widths: where the margin is just met, 95 % of them go in, or more."""
    random = np.random.default_rng(0)
    robot = made.cell.accuracy.robot
    for seed in range(5):
        axes = Rotation.random(random_state=seed).as_matrix()
        spread = axes @ np.diag(random.uniform(0.2, 1.0, 3) ** 2) @ axes.T
        low, high = 0.0, 0.05
        for _ in range(40):  # the largest scale that is let pass
            middle = (low + high) / 2
            thing = cap(covariance=spread * middle**2, width=0.08)
            good = isinstance(grip_margin(thing, made.cell), GripMargin)
            low, high = (middle, high) if good else (low, middle)
        total = spread * low**2 + np.eye(3) * robot**2
        off = random.multivariate_normal(np.zeros(3), total, 20000)
        half = (0.08 + random.normal(0, 1e-3, 20000)) / 2
        inside = np.linalg.norm(off[:, :2], axis=1) + half <= made.cell.gripper.opening / 2
        tips = np.abs(off[:, 2]) <= made.cell.gripper.tips
        assert inside.mean() >= 0.95 - 0.005  # three standard deviations of the draw
        assert tips.mean() >= 0.95 - 0.005
        assert min(inside.mean(), tips.mean()) < 0.999  # and it is no empty promise


def test_a_point_comes_into_the_base_with_the_scatter_that_the_rig_states() -> None:
    """Against draws: base poses perturbed as the file's covariance says, points as theirs."""
    random = np.random.default_rng(1)
    names = tuple(
        f"robot_base.{key}" for key in ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    )
    mix = random.normal(size=(7, 7))
    correlation = np.corrcoef(mix @ mix.T + 3 * np.eye(7))
    sigma = np.array([0.4, 0.5, 0.6, 0.08, 0.1, 0.05, 1.0])
    stated = Covariance((*names, "left.fx_px"), sigma, correlation)
    made = dataclasses.replace(make_rig(), covariance=stated)
    point, spread = np.array([0.05, 0.1, 0.9]), np.diag([0.2e-3, 0.3e-3, 0.9e-3]) ** 2
    place, covariance = point_in_base(made, point, spread)
    rig_R_base, origin = made.rig_T_base[:3, :3], made.rig_T_base[:3, 3]
    assert_allclose(rig_R_base @ place + origin, point, atol=1e-12)
    scale = np.array([1e-3] * 3 + [np.pi / 180] * 3)
    draws = random.multivariate_normal(
        np.zeros(6), (correlation * np.outer(sigma, sigma))[:6, :6] * np.outer(scale, scale), 40000
    )
    turned = Rotation.from_rotvec(draws[:, 3:]) * Rotation.from_matrix(rig_R_base)
    seen = point + random.multivariate_normal(np.zeros(3), spread, len(draws))
    places = turned.inv().apply(seen - origin - draws[:, :3])
    assert_allclose(np.cov(places.T), covariance, atol=0.02 * np.trace(covariance))
    # where nothing is stated, it is exact
    assert_allclose(point_in_base(make_rig(), point, spread)[1], rig_R_base.T @ spread @ rig_R_base)


def seen(size: tuple[float, float]) -> TargetObservation:
    return TargetObservation(
        0, 0.0, "tracked", "", None, None, (None, None), np.array([0, 0, 1.0]), np.eye(3) * 1e-6,
        np.zeros(3), np.eye(3), np.zeros(3), np.array(size), np.array([1e-3, 2e-3]),
        0.0, 1.0,
    )  # fmt: skip


def test_the_gripped_extent_depends_on_the_viewing_direction() -> None:
    made = make_rig()
    upright = made.rig_T_base[:3, :3].T @ [0, 1.0, 0]  # the rig's y, in the base
    thing = object_from_target(seen((0.03, 0.2)), made, upright)
    assert (thing.width, thing.length) == (0.03, 0.2)
    assert (thing.width_standard_uncertainty, thing.length_standard_uncertainty) == (1e-3, 2e-3)
    away = made.rig_T_base[:3, :3].T @ [0, 0, 1.0]
    thing = object_from_target(seen((0.03, 0.2)), made, away)
    assert (thing.width, thing.length) == (0.2, 0.2)
    assert thing.width_standard_uncertainty == 2e-3


@pytest.mark.slow
def test_the_arm_follows_a_moving_target_from_above_without_ever_leaving_limits_or_box(
    made: Workspace,
) -> None:
    setup_ = dataclasses.replace(made, limits=joint_limits(melfa(), 0.5))
    hover = HoverPlanner(setup_)
    follower = TrajectoryFollower(setup_.limits, home(made), PERIOD, setup_.clear)
    away = []
    for step in range(150):
        t = (step + 1) * PERIOD
        point = np.array([0.45 + 0.06 * np.sin(t), 0.1 * np.sin(0.7 * t), 0.05])
        velocity = np.array([0.06 * np.cos(t), 0.07 * np.cos(0.7 * t), 0.0])
        goal = hover.goal(point, velocity, follower.motion.q)
        ordered = follower.step(goal.q, goal.velocity)
        assert limit_violation(setup_.limits, ordered.motion) == ""
        assert setup_.margins(ordered.motion.q[None]).min() >= -RESOLUTION
        grip = setup_.grip(ordered.motion.q)[:3, 3]
        away.append(np.linalg.norm(grip - point - [0, 0, 0.12]))
    assert max(away[60:]) < 1e-3


def test_a_target_out_of_reach_is_refused_with_the_reason(made: Workspace) -> None:
    hover = HoverPlanner(made)
    found = hover.goal(np.array([0.9, 0.0, 0.05]), np.zeros(3), home(made))
    assert "out of reach" in found.reason
    assert isinstance(hover.goal(np.full(3, np.nan), np.zeros(3), home(made)), GraspRefusal)
    good = hover.goal(np.array([0.45, 0.0, 0.05]), np.array([0.0, 0.1, 0.0]), home(made))
    moved = robots.forward(melfa(), good.q + 1e-4 * good.velocity) - robots.forward(melfa(), good.q)
    assert_allclose(moved[:3, 3], [0, 1e-5, 0], atol=1e-8)
    assert_allclose(moved[:3, :3], 0, atol=1e-8)


def test_an_arm_without_a_closed_form_or_rates_is_not_put_into_a_cell(made: Workspace) -> None:
    for name, words in (("ur5", "closed form"), ("iust_6r", "speed_deg_s")):
        with pytest.raises(InputError, match=words):
            make_workspace(robots.load(name), made.cell, made.cameras)


def test_a_grasp_begins_where_the_arm_followed_to(made: Workspace) -> None:
    thing = cap(z=0.010)  # so low that the grip point is raised
    followed = HoverPlanner(made).goal(thing.position, np.zeros(3), home(made))
    found = plan_grasp(made, thing, followed.q)
    assert_allclose(found.posture.q_above, followed.q, atol=1e-9)
    assert len(found.over) == 1
    assert found.over[0].duration < 0.05


def test_the_page_lists_every_kind_of_refusal() -> None:
    for kind in get_args(RefusalKind):
        assert f"| `{kind}` |" in DOCS.read_text("utf-8")


def test_a_plan_has_page_units_and_a_time_table(made: Workspace) -> None:
    found = planned(made, cap())
    output = json.loads(json.dumps(plan_fields(found)))
    assert_allclose(output["grip_mm"], [450, 0, 30])
    assert_allclose(np.radians(output["q_grip_deg"]), found.posture.q_grip, atol=1e-5)
    assert len(output["rejected"]) == 7
    none = json.loads(json.dumps(plan_fields(refused(made, cap(0.34)))))
    assert (none["kind"], len(none["rejected"])) == ("reach", 8)
