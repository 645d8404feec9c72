"""Sums of joints that a pose determines, where single joints are not determined."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from reports import Results, render_html
from tests.support.simulated import InMemory, in_memory, marker_of, scene
from verify.analysis.session import analyse
from verify.simulation.scenario import (
    MultiJoint,
    ScenarioClock,
    ScenarioEncoders,
    ScenarioFault,
    ScenarioRecording,
)

FAULT_DEG = 0.5
FAULT = ScenarioFault(joint=4, offset_deg=FAULT_DEG)


def played(robot: str, home_deg: list[float], pairs: int, *fault: ScenarioFault) -> InMemory:
    scenario = scene(
        robot=robot, clock=ScenarioClock(), fault=[*fault], marker=marker_of("ABCD"),
        motion=MultiJoint(home_deg=home_deg, amplitude_deg=[8.0] * len(home_deg)),
        recording=ScenarioRecording(pairs=pairs, rate_hz=5.0),
        encoders=ScenarioEncoders(noise_deg=0.002),
    )  # fmt: skip
    return in_memory(scenario)


@pytest.fixture(scope="module")
def panda() -> tuple[InMemory, Results]:
    """Seven joints, the fourth encoder half a degree off."""
    home_deg = [10.0, -20.0, 15.0, -110.0, 10.0, 100.0, 40.0]
    session = played("panda", home_deg, 30, FAULT)
    return session, analyse(session)


def test_seven_joints_give_six_sums_that_a_pose_determines(panda: tuple[InMemory, Results]) -> None:
    session, results = panda
    sums = [c for c in results.summary["combinations"] if c["why"] == "self_motion"]
    assert len(sums) == 6
    middle = session.truth[len(session) // 2]
    still = np.linalg.svd(robots.jacobian(session.arm, middle))[2][6]
    for entry in sums:  # the self-motion leaves each of them alone
        assert abs(np.array(entry["weights"]) @ still) < 0.02  # posture of the reading, not truth


def test_the_six_sums_show_the_fault_and_nothing_else(panda: tuple[InMemory, Results]) -> None:
    session, results = panda
    sums = [c for c in results.summary["combinations"] if c["why"] == "self_motion"]
    error = np.zeros(7)
    error[3] = FAULT_DEG
    held = (set(range(7)) - {j for c in sums for j in _alone(c["weights"])}).pop()
    for entry in sums:
        own = _alone(entry["weights"]).pop()
        expected = np.mean([_sum(session, q, own, held) @ error for q in session.truth])
        # linear in the fault: half a degree bends the shares by a hundredth of it
        allowed = 4 * entry["standard_uncertainty_deg"] + 0.01 * FAULT_DEG
        assert abs(entry["mean_error_deg"] - expected) < allowed, entry["label"]


def _alone(weights: list[float]) -> set[int]:
    return {j for j, w in enumerate(weights) if abs(w - 1) < 1e-6}


def _sum(session: InMemory, q: np.ndarray, own: int, held: int) -> np.ndarray:
    """One joint less its share of the held one, by another route than the code under test."""
    jacobian = robots.jacobian(session.arm, q)
    others = [j for j in range(7) if j != held]
    shares = np.linalg.solve(jacobian[:, others], jacobian[:, held])
    weights = np.zeros(7)
    weights[own], weights[held] = 1.0, shares[others.index(own)]
    return weights


def test_the_report_lists_the_sums(panda: tuple[InMemory, Results]) -> None:
    assert "of more than six joints a pose determines six sums" in render_html(panda[1])


@pytest.mark.slow
def test_no_sums_of_self_motion_for_six_joints() -> None:
    results = analyse(played("ur5", [20.0, -70.0, 60.0, 20.0, 60.0, 10.0], 12))
    assert not [c for c in results.summary["combinations"] if c["why"] == "self_motion"]
    assert_allclose([j["mean_error_deg"] for j in results.summary["joints"]], 0, atol=0.3)
