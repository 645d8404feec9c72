"""From sights of LEDs to a corrected hand; the truth is an arm whose joints are really off."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import robots
from robots.transforms import difference, rotation_exp
from tests.support.grasp.cells import cap, cell, melfa, setup
from verify.core.records import Array
from verify.grasping.planning.object import GraspRefusal, grip_margin
from verify.grasping.planning.plan import plan_grasp
from verify.grasping.tool_offset.offset import (
    MIN_AGREEING,
    FlangeMeasurement,
    OffsetMeasurement,
    ToolOffset,
    average_sights,
    tool_offset,
)

ARM = melfa()
Q = np.deg2rad([3.0, 35.0, 117.0, 0.0, 28.0, 3.0])  # above a cap
SPREAD = np.diag(np.square([0.1e-3, 0.1e-3, 0.2e-3, 1e-3, 1e-3, 1e-3]))
TOLD = robots.forward(ARM, Q)
NO_BASE = np.zeros((3, 3))


def sights(true: Array, rng: np.random.Generator, count: int = 8) -> list[FlangeMeasurement]:
    """Pictures of a flange that is at `true`, base_T_flange (4, 4), as noisy as they say."""
    found = []
    for place in range(count):
        step = rng.multivariate_normal(np.zeros(6), SPREAD)
        seen = true.copy()
        seen[:3, :3] = rotation_exp(step[3:]) @ true[:3, :3]
        seen[:3, 3] += step[:3]
        found.append(FlangeMeasurement(float(place), "measured", seen, SPREAD, None))
    return found


def grip(folder: Path, q: Array) -> Array:
    place: Array = (robots.forward(ARM, q) @ cell(folder).gripper.flange_T_grip)[:3, 3]
    return place


def measured(folder: Path, true: Array, seed: int, base: Array = NO_BASE) -> ToolOffset:
    """The offset at the object by pictures of a flange that is at `true`."""
    found = average_sights(sights(true, np.random.default_rng(seed)), TOLD)
    return tool_offset(found, ARM, cell(folder), base, Q, below(folder, Q))


def below(folder: Path, q: Array) -> Array:
    """Where the line down ends."""
    pose = robots.forward(ARM, q)
    pose[2, 3] -= cell(folder).approach.height
    answers = robots.inverse(ARM, pose, hold=q).q
    return np.asarray(answers[int(np.nanargmin(np.abs(answers - q).max(axis=1)))])


@pytest.mark.parametrize("joint", [0, 1, 2, 4])  # the others hardly move the grip point
@pytest.mark.parametrize("fault_deg", [0.4, -0.4])
def test_a_joint_that_is_off_is_carried_from_above_to_the_object(
    joint: int, fault_deg: float, tmp_path: Path
) -> None:
    fault = np.deg2rad(fault_deg) * np.eye(6)[joint]
    end = below(tmp_path, Q)
    true = grip(tmp_path, end + fault) - grip(tmp_path, end)
    hand = measured(tmp_path, robots.forward(ARM, Q + fault), joint)
    assert hand.used
    assert np.linalg.norm(true) > 0.8e-3
    assert np.linalg.norm(hand.off - true) < 0.4e-3
    left = hand.off - true
    assert left @ np.linalg.solve(hand.covariance, left) < 16.3  # chi², 3 degrees, 0.1 %


@pytest.mark.slow
def test_the_stated_uncertainty_holds_over_many_arms(tmp_path: Path) -> None:
    """Arms drawn from what is claimed: squared Mahalanobis distances are chi² of 3 degrees."""
    rng, made, end = np.random.default_rng(5), cell(tmp_path), below(tmp_path, Q)
    moves = np.array([(grip(tmp_path, Q + 1e-6 * np.eye(6)[j]) - grip(tmp_path, Q)) / 1e-6
                      for j in range(6)])  # fmt: skip
    joint = made.accuracy.robot * np.sqrt(3 / (moves**2).sum())
    far, worse = [], 0
    for _ in range(120):
        fault = rng.normal(0.0, joint, 6)
        true = grip(tmp_path, end + fault) - grip(tmp_path, end)
        # the mean keeps one picture's uncertainty, so one picture's error is what it is to bear
        one = sights(robots.forward(ARM, Q + fault), rng, 1) * MIN_AGREEING
        hand = tool_offset(average_sights(one, TOLD), ARM, made, NO_BASE, Q, end)
        left = hand.off - true
        far.append(left @ np.linalg.solve(hand.covariance, left))
        worse += np.linalg.norm(left) > np.linalg.norm(true)
    assert 2.0 < np.mean(far) < 4.0  # 3 ± 0.22 by chance
    assert worse < 12  # a healthy arm is not made worse


def test_pictures_that_agree_no_better_than_noise_leave_a_healthy_arm_where_it_is(
    tmp_path: Path,
) -> None:
    """Depth known to 5 mm only: the claim of half a millimetre counts for more."""
    rough = np.diag(np.square([5e-3, 5e-3, 5e-3, 0.05, 0.05, 0.05]))
    moved = TOLD.copy()
    moved[:3, 3] += [4e-3, -3e-3, 5e-3]
    one = FlangeMeasurement(0.0, "measured", moved, rough, None)
    found = average_sights([one] * MIN_AGREEING, TOLD)
    hand = tool_offset(found, ARM, cell(tmp_path), NO_BASE, Q, below(tmp_path, Q))
    assert np.linalg.norm(hand.off) < 0.2e-3


def test_a_base_error_is_measured_as_a_shift(tmp_path: Path) -> None:
    moved = TOLD.copy()
    moved[:3, 3] += [1.2e-3, -0.8e-3, 0.5e-3]
    hand = measured(tmp_path, moved, 2, base=np.eye(3) * (1e-3) ** 2)
    np.testing.assert_allclose(hand.off, [1.2e-3, -0.8e-3, 0.5e-3], atol=0.4e-3)


def test_too_few_or_contradicting_pictures_are_refused() -> None:
    rng = np.random.default_rng(4)
    blind = FlangeMeasurement(0.0, "too_few_leds", None, None, None)
    assert average_sights([*sights(TOLD, rng, MIN_AGREEING - 1), blind], TOLD) == (
        f"its LEDs were measured in {MIN_AGREEING - 1} of {MIN_AGREEING} pictures"
    )
    elsewhere = TOLD.copy()
    elsewhere[0, 3] += 0.01
    halves = [*sights(TOLD, rng, 5), *sights(elsewhere, rng, 5)]
    assert average_sights(halves, TOLD) == "pictures of its LEDs contradict each other"
    eight = sights(TOLD, rng, 8)
    outvoted = average_sights([*eight, *sights(elsewhere, rng, 1)], TOLD)
    np.testing.assert_allclose(outvoted.off, average_sights(eight, TOLD).off)
    assert np.abs(difference(outvoted.pose, TOLD)[:3]).max() < 1e-3


def seen(off_mm: list[float], *, used: bool, u: float = 0.1e-3) -> OffsetMeasurement:
    hand = ToolOffset(np.array(off_mm) * 1e-3, np.eye(3) * u**2, used)
    return OffsetMeasurement("", (), TOLD, TOLD, TOLD, hand)


def test_a_corrected_target_moves_and_a_refused_one_needs_margin(tmp_path: Path) -> None:
    made, thing = cell(tmp_path), cap()
    plain = grip_margin(thing, made)
    corrected = grip_margin(replace(thing, offset=seen([2.0, -1.0, -0.5], used=True)), made)
    refused = grip_margin(replace(thing, offset=seen([12.0, 0.0, 3.0], used=False)), made)
    np.testing.assert_allclose(corrected.grip - plain.grip, [-2e-3, 1e-3, 0.5e-3])
    assert corrected.across_needed > plain.across_needed  # its own uncertainty comes on top
    np.testing.assert_allclose(refused.grip, plain.grip)
    assert refused.across_needed == pytest.approx(plain.across_needed + 12e-3, abs=1e-4)
    wide = replace(thing, width=0.095, offset=seen([12.0, 0.0, 0.0], used=False))
    answer = grip_margin(wide, made)
    assert answer.kind == "uncertainty"


def test_no_correction_leads_the_tips_into_the_table(tmp_path: Path) -> None:
    """An arm that is too high is told lower, but not below what the tips must keep."""
    made, low = cell(tmp_path), cap(z=0.018)
    margin = grip_margin(replace(low, offset=seen([0.0, 0.0, 4.0], used=True)), made)
    least = made.table.height + made.table.finger_clearance + made.gripper.tips
    assert margin.grip[2] >= least - 1e-9
    assert margin.grip[2] + 4e-3 == pytest.approx(low.position[2] + margin.raised)


def test_a_corrected_plan_keeps_its_posture_and_passes_the_same_checks(tmp_path: Path) -> None:
    made = setup(tmp_path)
    first = plan_grasp(made, cap(), np.deg2rad([0.0, 0.0, 90.0, 0.0, 90.0, 0.0]))
    above = first.posture.q_above
    found = plan_grasp(made, cap(offset=seen([3.0, -3.0, -1.0], used=True)), above)
    assert found.posture.branch == first.posture.branch
    assert np.abs(found.posture.q_above - above).max() < 0.1
    off = made.grip(found.posture.q_grip) - made.grip(first.posture.q_grip)
    np.testing.assert_allclose(off[:3, 3], [-3e-3, 3e-3, 1e-3], atol=2e-5)
    for way in (*found.over, found.down):
        assert made.along(way.path) == ""
    edge = cap(x=float(made.cell.upper[0]) - 1e-3)
    standing = plan_grasp(made, edge, above)
    beyond = plan_grasp(
        made, replace(edge, offset=seen([-5.0, 0.0, 0.0], used=True)), standing.posture.q_above
    )
    assert isinstance(beyond, GraspRefusal)  # told outside the box
