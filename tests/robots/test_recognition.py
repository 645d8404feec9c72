"""Closed forms found in URDFs: the family, the file's own postures, and every other answer."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from robots.inverse import near
from robots.transforms import Array, difference
from tests.support.makers import IRB_120, KR6_R900_SIXX, LR_MATE_200ID, XARM6, PublishedArm

FAMILY = {
    "ur3": "parallel_axes",
    "ur5": "parallel_axes",
    "ur10": "parallel_axes",
    "z1": "parallel_axes",
    "kinova": "spherical_wrist",
    "talos_left_arm": "intersecting_axes",
    "panda": "intersecting_axes, from flange to base",
    "xarm7": "intersecting_axes, from flange to base",
    "xarm6": "offset_wrist",
}
TEN_THOUSAND = ("ur3", "ur5", "ur10", "z1", "panda", "xarm6")
EVERY_ARM = pytest.mark.parametrize("name", FAMILY)


def loaded(name: str) -> robots.UrdfArm:
    if name == "xarm6":  # example-robot-data has none
        with TemporaryDirectory() as folder:
            return loaded(str(XARM6.write(Path(folder))))
    arm = robots.load(name)
    assert isinstance(arm, robots.UrdfArm)
    return arm


def regular(arm: robots.UrdfArm, q: Array) -> Array:
    """Postures (m,) whose six solved joints are away from every singularity.

    Where a file rounds its angles, farther: a stretched elbow may not close in the family's chain.
    """
    least = 1e-4 if arm.closed_form and arm.closed_form.exact else 1e-2
    values = np.linalg.svd(robots.jacobian(arm, q)[..., :6], compute_uv=False)
    return values[:, -1] > least * values[:, 0]


def check_answers(arm: robots.UrdfArm, poses: int, seed: int) -> None:
    """Random postures are among the answers to their poses, and pinocchio reaches each by all."""
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (poses, arm.dof))
    pose = robots.forward(arm, q)
    found = robots.inverse(arm, pose, hold=q).q
    exists = np.isfinite(found[..., 0])
    asked = np.broadcast_to(pose[:, None], (*exists.shape, 4, 4))[exists]
    apart = np.abs(difference(robots.forward(arm, found[exists]), asked))
    assert apart.max() < 1e-9
    sound = regular(arm, q)
    assert sound.mean() > 0.5
    away = np.abs(near(found, q[:, None]) - q[:, None]).max(axis=-1)
    assert np.where(exists, away, np.inf)[sound].min(axis=-1).max() < 1e-8


@EVERY_ARM
def test_the_family_is_found_and_postures_are_among_their_answers(name: str) -> None:
    arm = loaded(name)
    assert str(arm.closed_form) == FAMILY[name]
    check_answers(arm, 300, 1)


@pytest.mark.slow
@EVERY_ARM
def test_thousands_of_postures_are_among_their_answers(name: str) -> None:
    check_answers(loaded(name), 10_000 if name in TEN_THOUSAND else 2000, 2)


def solved_from_many_starts(arm: robots.UrdfArm, pose: Array, hold: Array) -> Array:
    """Answers (k, n) that iterations from random postures meet: no closed form has a part in it."""
    random = np.random.default_rng(3)
    found: list[Array] = []
    frozen = np.arange(arm.dof) >= 6
    for _ in range(300):
        q = np.where(frozen, hold, random.uniform(-np.pi, np.pi, arm.dof))
        for _ in range(60):
            error = difference(pose, robots.forward(arm, q))
            size = float(error @ error)
            if size < 1e-22 or not np.isfinite(size):
                break
            moves = robots.jacobian(arm, q)[:, :6]
            step = moves.T @ np.linalg.solve(
                moves @ moves.T + 0.1 * min(size, 1.0) * np.eye(6), error
            )
            q = q + np.pad(step, (0, arm.dof - 6))
        else:
            continue
        if not any(np.abs(near(q, other) - other).max() < 1e-5 for other in found):
            found.append(near(q, np.zeros(arm.dof)))
    return np.array(found)


QUICK = ("z1", "panda")


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in FAMILY]
)
def test_no_answer_is_missing_that_iterations_find(name: str) -> None:
    arm = loaded(name)
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, (40, arm.dof))
    values = np.linalg.svd(robots.jacobian(arm, q)[..., :6], compute_uv=False)
    posture = q[np.argmax(values[:, -1] / values[:, 0])]
    pose = robots.forward(arm, posture)
    branches = robots.inverse(arm, pose, hold=posture).q
    ours = branches[np.isfinite(branches[:, 0])]
    theirs = solved_from_many_starts(arm, pose, posture)
    apart = np.abs(near(ours[:, None], theirs[None]) - theirs[None]).max(axis=-1)
    assert apart.min(axis=0).max() < 1e-6  # each of theirs is one of ours
    assert apart.min(axis=1).max() < 1e-6


@pytest.mark.parametrize("name", ["ur3", "ur5", "ur10", "z1"])
def test_another_librarys_closed_form_finds_the_same_solutions(name: str) -> None:
    eaik = pytest.importorskip("eaik.IK_HP")
    arm = loaded(name)
    points = np.vstack([np.zeros(3), arm.rest_frames[:, :3, 3]])
    theirs = eaik.HPRobot(arm.rest_frames[:6, :3, 2], np.diff(points, axis=0))
    q = np.random.default_rng(5).uniform(-np.pi, np.pi, (40, 6))
    values = np.linalg.svd(robots.jacobian(arm, q), compute_uv=False)
    for posture in q[values[:, -1] > 0.02 * values[:, 0]]:
        pose = robots.forward(arm, posture)
        branches = robots.inverse(arm, pose).q
        ours = branches[np.isfinite(branches[:, 0])]
        turned = pose.copy()
        turned[:3, :3] = pose[:3, :3] @ arm.rest_frames[-1, :3, :3].T  # their tool has no turn
        answer = theirs.IK(turned)
        other = np.asarray(answer.Q)[~np.asarray(answer.is_LS, dtype=bool)]
        apart = np.abs(near(ours[:, None], other[None]) - other[None]).max(axis=-1)
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-4


@pytest.mark.parametrize("published", [LR_MATE_200ID, KR6_R900_SIXX, IRB_120], ids=lambda p: p.name)
def test_a_makers_urdf_has_the_family_of_its_robot_file(
    published: PublishedArm, tmp_path: Path
) -> None:
    arm = loaded(str(published.write(tmp_path)))
    assert str(arm.closed_form) == "spherical_wrist"
    check_answers(arm, 300, 6)


def test_a_seventh_joint_keeps_the_angle_that_is_given() -> None:
    arm = loaded("panda")
    q = np.array([0.1, 0.2, 0.3, -1.5, 0.5, 1.6, 0.7])
    pose = robots.forward(arm, q)
    for angle in (0.7, 0.6):
        found = robots.inverse(arm, pose, hold=np.array([0, 0, 0, 0, 0, 0, angle])).q
        exists = np.isfinite(found[:, 0])
        assert exists.any()
        assert_allclose(found[exists, 6], angle)
        assert_allclose(robots.forward(arm, found[exists]), [pose] * exists.sum(), atol=1e-12)


def test_a_tilted_axis_leaves_the_family_and_the_inverse_says_so(tmp_path: Path) -> None:
    path = IRB_120.write(tmp_path)
    path.write_text(
        path.read_text().replace('axis xyz="0.0 1.0 0.0"', 'axis xyz="0.0 1.0 0.001"', 1)
    )
    arm = loaded(str(path))
    assert arm.closed_form is None
    with pytest.raises(ValueError, match="irb_120 has no closed form"):
        robots.inverse(arm, np.eye(4))


@pytest.mark.parametrize("name", ["ur5", "xarm7"])
def test_the_nearest_answer_is_found_however_far_the_start(name: str) -> None:
    arm = loaded(name)
    q = np.random.default_rng(7).uniform(-1.5, 1.5, (50, arm.dof))
    start = q + 0.1 if arm.dof > 6 else q + np.pi / 3
    found, reached = robots.nearest(arm, robots.forward(arm, q), start)
    assert reached.all()
    assert (
        np.linalg.norm(found - start, axis=-1) <= np.linalg.norm(q - start, axis=-1) + 1e-9
    ).all()
