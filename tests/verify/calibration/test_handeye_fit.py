import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom
from scipy.stats import t as student

from robots.transforms import difference
from verify.calibration.handeye import solve_hand_eye
from verify.calibration.handeye_fit import FittedLoop, fit_hand_eye, fit_streams
from verify.records import Array

PLACE, TURN = 1.2e-3, np.deg2rad(0.6)  # m, rad: scatter of a pose
POSES, DRAWS = 12, 200
OFFSET = 0.137  # s


def motions(places: Array, turns: Rotation) -> Array:
    stack = np.tile(np.eye(4), (len(places), 1, 1))
    stack[:, :3, :3], stack[:, :3, 3] = turns.as_matrix(), places
    return stack


def random_motions(n: int, rng: np.random.Generator) -> Array:
    return motions(rng.normal(scale=0.3, size=(n, 3)), Rotation.random(n, random_state=rng))


def seen(
    x: Array,
    y: Array,
    b: Array,
    rng: np.random.Generator,
    place: float = PLACE,
    turn: float = TURN,
) -> Array:
    a = y @ b @ np.linalg.inv(x)
    turns = Rotation.from_rotvec(rng.normal(0, turn, (len(b), 3))).as_matrix()
    a[:, :3, 3] += rng.normal(0, place, (len(b), 3))
    a[:, :3, :3] = turns @ a[:, :3, :3]
    return a


def test_exact_poses_are_solved_exactly() -> None:
    rng = np.random.default_rng(1)
    x, y = random_motions(2, rng)
    b = random_motions(8, rng)
    fitted = fit_hand_eye(y @ b @ np.linalg.inv(x), b)
    np.testing.assert_allclose(fitted.x, x, atol=1e-9)
    np.testing.assert_allclose(fitted.y, y, atol=1e-9)


def off(fitted: FittedLoop, x: Array, y: Array) -> Array:
    """Estimate less truth, (12,), as the covariance counts it."""
    z = difference(np.linalg.inv(fitted.x), np.linalg.inv(x))
    return np.concatenate([z, difference(fitted.y, y)])


def test_the_stated_covariance_holds_the_truth() -> None:
    """95 % of the errors, each in its own uncertainty, within Student's limit of 30."""
    inside, scatters = np.zeros(12), []
    for seed in range(DRAWS):
        rng = np.random.default_rng(seed)
        x, y = random_motions(2, rng)
        b = random_motions(POSES, rng)
        fitted = fit_hand_eye(seen(x, y, b, rng), b)
        u = np.sqrt(np.diag(fitted.covariance))
        inside += np.abs(off(fitted, x, y)) < student.ppf(0.975, 6 * POSES // 2 - 6) * u
        scatters.append((fitted.place, fitted.turn))
    least, most = binom.ppf([0.0005, 0.9995], DRAWS, 0.95)
    assert np.all((least <= inside) & (inside <= most)), inside
    place, turn = np.mean(np.square(scatters), axis=0)
    assert place == pytest.approx(PLACE**2, rel=0.1)
    assert turn == pytest.approx(TURN**2, rel=0.1)


def test_places_tell_the_turns_that_a_target_seen_from_the_front_does_not() -> None:
    """Turns seen 3° badly, places well: the closed form knows the base's turn far less."""
    fitted_off, closed_off = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        x, y = random_motions(2, rng)
        b = random_motions(POSES, rng)
        a = seen(x, y, b, rng, place=2e-4, turn=np.deg2rad(3.0))
        fitted_off.append(off(fit_hand_eye(a, b), x, y)[9:])
        closed_off.append(difference(solve_hand_eye(a, b).y, y)[3:])
    assert np.std(fitted_off) < 0.2 * np.std(closed_off)


def test_a_clock_between_the_streams_is_found_within_its_uncertainty() -> None:
    t = np.arange(0.0, 8.0, 0.1)
    beyond = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        x, y = random_motions(2, rng)
        a = seen(x, y, swinging(t - OFFSET), rng)
        fitted = fit_streams(t, a, swinging, OFFSET + rng.uniform(-0.02, 0.02))
        u = fitted.offset_standard_uncertainty
        assert u is not None
        beyond.append((fitted.offset - OFFSET) / u)
    assert np.sqrt(np.mean(np.square(beyond))) == pytest.approx(1.0, abs=3 * np.sqrt(1 / 80))


def swinging(t: Array) -> Array:
    """A body that turns and travels, each axis at its own rate."""
    wave = np.stack([np.sin(2.1 * t), np.cos(1.7 * t), np.sin(1.3 * t + 1)], axis=1)
    return motions(0.3 * wave, Rotation.from_rotvec(0.8 * wave[:, ::-1]))


def test_a_wild_pose_is_told_and_left_out() -> None:
    rng = np.random.default_rng(7)
    x, y = random_motions(2, rng)
    b = random_motions(POSES, rng)
    a = seen(x, y, b, rng)
    a[4, 0, 3] += 0.2
    fitted = fit_hand_eye(a, b)
    assert np.flatnonzero(~fitted.good).tolist() == [4]
    assert np.linalg.norm(fitted.residual[4, :3]) == pytest.approx(0.2, abs=0.02)


def test_turns_about_one_axis_are_refused() -> None:
    rng = np.random.default_rng(8)
    x, y = random_motions(2, rng)
    about_z = Rotation.from_rotvec(np.outer(np.linspace(-1, 1, 9), [0, 0, 1]))
    b = motions(rng.normal(size=(9, 3)), about_z)
    with pytest.raises(ValueError, match="one axis"):
        fit_hand_eye(y @ b @ np.linalg.inv(x), b)


def test_a_mirror_is_refused() -> None:
    rng = np.random.default_rng(9)
    x, y = random_motions(2, rng)
    b = random_motions(8, rng)
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="mirror"):
        fit_hand_eye(mirror @ y @ b @ np.linalg.inv(x) @ mirror, b)
