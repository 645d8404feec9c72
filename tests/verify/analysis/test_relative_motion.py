"""Relative motions that no registration enters: laws, healthy arms, faults."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from tests.support.motions import ARM, ESTIMATED, compared, model_of
from verify.analysis.model import DETECTION_SIGMA, JointErrorModel
from verify.analysis.relative_motion import (
    compare_relative_motions,
    screw_derivatives,
    screw_motion,
)
from verify.core.records import Array


def poses(rng: np.random.Generator, count: int) -> Array:
    made = np.tile(np.eye(4), (count, 1, 1))
    made[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
    made[:, :3, 3] = rng.normal(size=(count, 3))
    return made


def model(seed: int, error: Array | float = 0.0) -> JointErrorModel:
    return model_of(*compared(seed, error), "fixture", "jig")


def test_turn_and_advance_are_the_same_in_any_frame_and_for_any_point_of_the_flange() -> None:
    rng = np.random.default_rng(1)
    early, late = poses(rng, 40), poses(rng, 40)
    base, tool = poses(rng, 2)
    assert_allclose(
        screw_motion(base @ early @ tool, base @ late @ tool), screw_motion(early, late), atol=1e-12
    )


def test_turn_and_advance_of_a_known_screw() -> None:
    axis, point = np.array([0.0, 0.6, 0.8]), np.array([0.2, -0.1, 0.3])
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(0.7 * axis).as_matrix()
    motion[:3, 3] = point - motion[:3, :3] @ point + 0.05 * axis
    early = poses(np.random.default_rng(2), 1)
    assert_allclose(screw_motion(early, motion @ early), [[0.7, 0.05]], atol=1e-12)


def test_what_a_pose_does_to_a_screw_is_what_it_does_when_it_is_moved() -> None:
    early, late = poses(np.random.default_rng(4), 200), poses(np.random.default_rng(5), 200)
    output = screw_motion(early, late)[:, 0]
    known = (output > np.deg2rad(10.0)) & (output < np.deg2rad(170.0))
    early, late = early[known], late[known]
    by_early, by_late = screw_derivatives(early, late)
    h = 1e-6
    for k, twist in enumerate(h * np.eye(6)):
        slope = screw_motion(pushed(early, twist), late) - screw_motion(pushed(early, -twist), late)
        assert_allclose(by_early[:, :, k], slope / (2 * h), atol=1e-8)
        slope = screw_motion(early, pushed(late, twist)) - screw_motion(early, pushed(late, -twist))
        assert_allclose(by_late[:, :, k], slope / (2 * h), atol=1e-8)


def pushed(a_T_b: Array, twist: Array) -> Array:
    there = a_T_b.copy()
    there[:, :3, 3] += twist[:3]
    there[:, :3, :3] = Rotation.from_rotvec(twist[3:]).as_matrix() @ a_T_b[:, :3, :3]
    return there


def test_offsets_of_the_first_and_the_last_joint_do_not_show_and_the_others_do() -> None:
    """Joint 1's is a turned base, joint 6's a turned LED body: metrology.md section 4."""
    found = compare_relative_motions(model(4))
    assert np.isinf(found.detectable[[0, 5]]).all()
    assert np.all(np.rad2deg(found.detectable[1:5]) < 1.0)


@pytest.mark.slow
def test_healthy_arms_pass_at_the_stated_rate() -> None:
    p, inside, count = [], 0, 0
    for seed in range(60):
        found = compare_relative_motions(model(100 + seed))
        p.append(found.p_value)
        inside += int(np.sum(np.abs(found.error) < 1.96 * found.uncertainty))
        count += found.error.size
    assert kstest(p, "uniform").pvalue > 1e-3
    assert 0.94 < inside / count < 0.96  # 4,000 of them: 0.35 % standard


@pytest.mark.parametrize("joint", [1, 2, 3, 4])
def test_twice_the_detectable_offset_is_found_but_not_at_joint_1(joint: int) -> None:
    healthy = compare_relative_motions(model(5))
    error = np.zeros(ARM.dof)
    error[joint] = 2 * healthy.detectable[joint]
    faulty = compare_relative_motions(model(5, error))
    # that noise of one degree of freedom: 2 * 4.13 sigma raise chi² by 68
    assert faulty.chi2 - healthy.chi2 > DETECTION_SIGMA**2
    hidden = compare_relative_motions(model(5, np.eye(ARM.dof)[0] * np.deg2rad(0.5)))
    assert_allclose(hidden.chi2, healthy.chi2, rtol=5e-3)  # the readings' noise is weighed anew


def test_base_and_clock_uncertainty_are_counted_at_most_once() -> None:
    track, comparison = compared(6)
    base = model_of(track, comparison, "fixture", "jig")
    given = compare_relative_motions(base)
    estimated = compare_relative_motions(model_of(track, comparison, "fixture", "jig", ESTIMATED))
    assert np.all(estimated.uncertainty >= given.uncertainty * (1 - 1e-12))


def test_too_few_motions_are_no_test() -> None:
    whole = model(7)
    known = (np.eye(6)[:, :5],) * len(whole.comparison)
    some = replace(whole, comparison=replace(whole.comparison, determined=known))
    assert compare_relative_motions(some) is None
