"""Postures: every branch is offered or has a reason, and offered ones hold."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from tests.support.grasp.cells import home, melfa, setup
from verify.grasping.planning.postures import (
    MIN_SINGULAR_VALUE,
    branch_name,
    find_postures,
    smallest_singular_value,
)
from verify.grasping.planning.workspace import RESOLUTION, Workspace

POINT = np.array([0.45, 0.05, 0.04])


@pytest.fixture
def made(tmp_path: Path) -> Workspace:
    return setup(tmp_path)


def test_every_branch_is_offered_or_has_a_reason(made: Workspace) -> None:
    good, rejected = find_postures(made, POINT, home(made))
    assert {posture.branch for posture in good} | set(rejected) == set(range(8))
    assert not {posture.branch for posture in good} & set(rejected)
    assert all(rejected.values())
    assert branch_name(0) == "shoulder facing, elbow +, wrist +"
    assert branch_name(7) == "shoulder away, elbow −, wrist −"
    assert [p.score for p in good] == sorted((p.score for p in good), reverse=True)


def test_offered_postures_are_above_and_at_the_object(made: Workspace) -> None:
    good, _ = find_postures(made, POINT, home(made))
    for posture in good:
        above, grip = (made.grip(q) for q in (posture.q_above, posture.q_grip))
        assert_allclose(grip[:3, 3], POINT, atol=1e-9)
        assert_allclose(above[:3, 3], POINT + np.array([0, 0, 0.12]), atol=1e-9)
        assert_allclose(above[:3, :3], grip[:3, :3], atol=1e-9)
        assert_allclose(grip[:3, 2], [0, 0, -1], atol=1e-9)
        both = np.array([posture.q_above, posture.q_grip])
        assert robots.within_limits(melfa(), both).all()
        assert made.margins(both).min() >= -RESOLUTION
        assert smallest_singular_value(melfa(), both).min() >= MIN_SINGULAR_VALUE
        assert np.abs(posture.q_grip - posture.q_above).max() < np.pi  # no joint is wound up
        for part in (posture.limits, posture.dexterity, posture.nearness, posture.clearance):
            assert 0 < part <= 1


def test_no_joint_winds_up_from_the_current_posture(made: Workspace) -> None:
    wound = home(made) + np.radians([0, 0, 0, 0, 0, 150.0])
    good, _ = find_postures(made, POINT, wound)
    assert max(posture.q_above[5] for posture in good) > np.pi
    for posture in good:
        assert np.abs(posture.q_above - wound).max() <= np.pi + 1e-9
        assert np.abs(posture.q_grip - posture.q_above).max() < 1.0


def test_among_equal_postures_the_nearer_is_better(made: Workspace) -> None:
    good, _ = find_postures(made, POINT, home(made))
    there, _ = find_postures(made, POINT, good[3].q_above)
    same = next(p for p in there if np.allclose(p.q_above, good[3].q_above, atol=1e-6))
    assert same.nearness == pytest.approx(1, abs=1e-6)
    assert same.nearness > good[3].nearness


@pytest.mark.parametrize(
    ("point", "words"),
    [
        ([0.9, 0.0, 0.1], "out of reach, however the hand is turned"),
        ([0.30, 0.0, 0.03], "joint 4 would stand at 180.0°, allowed is −160 to 160°"),
        ([0.45, 0.35, 0.05], "the grip point would be 50 mm outside the workspace box"),
        ([0.45, 0.05, 0.01], "finger tips would come 8 mm too near to the table"),
    ],
)
def test_a_rejected_branch_has_a_reason(made: Workspace, point: list[float], words: str) -> None:
    _, rejected = find_postures(made, np.array(point), home(made))
    assert any(words in message for message in rejected.values())


def test_objects_near_cameras_are_refused(made: Workspace) -> None:
    beside = dataclasses.replace(made, cameras=POINT[None] + np.array([0.0, 0.15, 0.1]))
    _, rejected = find_postures(beside, POINT, home(made))
    assert any("near to camera 1" in message for message in rejected.values())


def test_every_inverse_solution_is_considered(made: Workspace) -> None:
    """Against brute force: random postures that grasp the point are all of an offered branch."""
    good, _ = find_postures(made, POINT, home(made))
    offered = {posture.branch for posture in good}
    flange = made.grip(good[0].q_grip) @ np.linalg.inv(made.cell.gripper.flange_T_grip)
    for turn in np.linspace(0, 2 * np.pi, 90):
        spun = flange.copy()
        spun[:3, :3] = robots.transforms.rotation_exp(np.array([0, 0, turn])) @ flange[:3, :3]
        for q in robots.turns(melfa(), robots.inverse(melfa(), spun).q):
            if made.margins(q[None]).min() < 0:
                continue
            answers = robots.inverse(melfa(), spun, hold=q).q
            branch = int(np.nanargmin(np.abs(np.sin((answers - q) / 2)).max(axis=1)))
            assert branch in offered
