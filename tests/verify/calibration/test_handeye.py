import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from verify.calibration.handeye import solve_hand_eye, solve_robustly
from verify.core.records import Array


def motions(places: Array, turns: Rotation) -> Array:
    stack = np.tile(np.eye(4), (len(places), 1, 1))
    stack[:, :3, :3], stack[:, :3, 3] = turns.as_matrix(), places
    return stack


def random_motions(n: int, rng: np.random.Generator) -> Array:
    return motions(rng.normal(size=(n, 3)), Rotation.random(n, random_state=rng))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_a_closed_loop_is_solved_exactly_and_a_mirrored_body_is_recognised(
    rng: np.random.Generator,
) -> None:
    x, y = random_motions(2, rng)
    b = random_motions(8, rng)
    solved = solve_hand_eye(y @ b @ np.linalg.inv(x), b)
    np.testing.assert_allclose(solved.x, x, atol=1e-12)
    np.testing.assert_allclose(solved.y, y, atol=1e-12)
    assert not solved.mirrored
    assert np.abs(solved.residual).max() < 1e-12
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    assert solve_hand_eye(mirror @ y @ b @ np.linalg.inv(x) @ mirror, b).mirrored


def test_a_wrong_pose_is_left_out(rng: np.random.Generator) -> None:
    x, y = random_motions(2, rng)
    b = random_motions(12, rng)
    a = y @ b @ np.linalg.inv(x)
    a[:, :3, 3] += rng.normal(0, 1e-4, (12, 3))
    a[7, :3, 3] += 0.05
    solved, good = solve_robustly(a, b, 6.0)
    assert np.flatnonzero(~good).tolist() == [7]
    np.testing.assert_allclose(solved.y[:3, 3], y[:3, 3], atol=5e-4)


def test_two_poses_are_too_few(rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="3 poses or more"):
        solve_hand_eye(random_motions(2, rng), random_motions(2, rng))
