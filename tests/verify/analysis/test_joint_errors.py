"""Judgement on tracks with known truth: the numbers a metrologist would check by hand."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import robots
from tests.support.motions import (
    ARM,
    ESTIMATED,
    HOME,
    LOG,
    PAIRS,
    POSTURES,
    compared,
    make_track,
    model_of,
    read,
    swinging,
)
from verify.analysis.comparison import compare, flange_error
from verify.analysis.joint_errors import ResolvedErrors, resolve_errors
from verify.analysis.least_squares import solve
from verify.analysis.model import visibility
from verify.analysis.verdict import judge_joint
from verify.core.readings import Readings
from verify.core.records import Array


def test_with_base_and_leds_from_the_encoders_joints_1_and_6_are_invisible() -> None:
    seen = visibility(model_of(*compared(1), "motion", "motion"))
    assert seen.fraction[0] == seen.fraction[5] == 0
    assert np.isnan(seen.detectable[[0, 5]]).all()
    assert np.all(seen.fraction[1:5] > 0)
    assert np.all(seen.fraction[1:5] < 0.3)  # metrology.md section 1.3: local work hides most
    assert_allclose(seen.fraction_since, 1)


def test_with_everything_given_every_offset_is_visible_and_an_estimated_clock_costs_a_little() -> (
    None
):
    track, comparison = compared(1)
    assert_allclose(visibility(model_of(track, comparison, "fixture", "jig")).fraction, 1)
    seen = visibility(model_of(track, comparison, "fixture", "jig", ESTIMATED))
    assert np.all((seen.fraction > 0.9) & (seen.fraction < 1))


@pytest.mark.parametrize(("base", "body"), [("motion", "motion"), ("fixture", "motion")])
@pytest.mark.parametrize(("name", "home_deg"), POSTURES.items())
def test_the_visible_share_is_what_is_left_of_an_offset_after_registering_by_brute_force(
    name: str, home_deg: tuple[float, ...], base: str, body: str
) -> None:
    """Inject 0.01°, fit base and LED body by a general optimiser, compare what remains."""
    from scipy.optimize import least_squares

    arm = robots.load(name)

    def motion(t: Array) -> Array:
        return swinging(t) - HOME + np.deg2rad(home_deg)

    rng = np.random.default_rng(2)
    track = make_track(PAIRS, motion(PAIRS), rng, arm)
    comparison = compare(track, arm, read(motion, LOG, 0.0, rng), 0.0)
    model = model_of(track, comparison, base, body)
    flange = comparison.base_T_encoder
    whole = np.linalg.cholesky(np.linalg.inv(comparison.covariance_measured[0])).T

    def residual(parameters: Array, moved: Array) -> Array:
        shift, tool = parameters[:6] * (base == "motion"), parameters[6:]
        turn_base = Rotation.from_rotvec(shift[3:]).as_matrix()
        turn_tool = Rotation.from_rotvec(tool[3:]).as_matrix()
        rotation = turn_base @ moved[:, :3, :3] @ turn_tool
        place = (moved[:, :3, 3] + moved[:, :3, :3] @ tool[:3]) @ turn_base.T + shift[:3]
        turn = Rotation.from_matrix(rotation @ np.swapaxes(flange[:, :3, :3], 1, 2)).as_rotvec()
        return (np.concatenate([place - flange[:, :3, 3], turn], axis=1) @ whole.T).ravel()

    for joint in (1, 3, 4):
        moved = robots.forward(arm, comparison.q + np.deg2rad(0.01) * np.eye(6)[joint])
        before = np.linalg.norm(residual(np.zeros(12), moved))
        fit = least_squares(residual, np.zeros(12), args=(moved,), xtol=1e-14, ftol=1e-14)
        share = np.linalg.norm(fit.fun) / before
        assert_allclose(visibility(model).fraction[joint], share, rtol=0.02)


def crooked(seed: int, joint: int, error: Callable[[Array], Array]) -> ResolvedErrors:
    """What is resolved where a joint's readings are off by an error of their own angle."""
    rng = np.random.default_rng(seed)
    track = make_track(PAIRS, swinging(PAIRS), rng)
    readings = read(swinging, LOG, 0.0, rng)
    q = readings.q + error(readings.q[:, [joint]]) * np.eye(6)[joint]
    comparison = compare(track, ARM, Readings(readings.t, q), 0.0)
    return resolve_errors(model_of(track, comparison, "fixture", "jig"))


def test_an_error_that_grows_with_the_angle_is_judged_at_its_end_not_by_its_mean() -> None:
    """A gain of 1 % about the middle has mean zero and 0.25° at the ends of a 50° swing."""
    resolved = crooked(9, 5, lambda q: 0.01 * (q - np.deg2rad(30.0)))
    verdict = judge_joint(resolved, 5, np.deg2rad(0.15), 0.0)
    assert verdict.verdict == "nonconform"
    assert abs(abs(np.rad2deg(verdict.worst)) - 0.25) < 0.02


def test_an_error_that_no_term_describes_is_a_lack_of_fit() -> None:
    resolved = crooked(10, 1, lambda q: np.deg2rad(0.1) * np.sin(40 * q))
    assert resolved.lack_of_fit
    assert judge_joint(resolved, 0, np.deg2rad(1.0), 0.0).reason == "lack_of_fit"


def test_a_tolerance_below_what_is_detectable_is_undecided() -> None:
    model = model_of(*compared(7), "fixture", "jig")
    least = float(visibility(model).detectable[0])
    verdict = judge_joint(resolve_errors(model), 0, least / 2, least)
    assert (verdict.verdict, verdict.reason) == ("undecided", "not_detectable")


def test_a_prior_column_is_generalised_least_squares() -> None:
    """Fitting columns of unit variance is the same as counting their covariance in full."""
    rng = np.random.default_rng(12)
    rows, prior, target = rng.normal(size=(40, 3)), rng.normal(size=(40, 2)), rng.normal(size=40)
    covariance = np.eye(40) + prior @ prior.T
    weight = np.linalg.inv(covariance)
    expected = np.linalg.inv(rows.T @ weight @ rows)
    value = expected @ rows.T @ weight @ target
    fit = solve(rows, target, prior)
    assert_allclose(fit.value, value, atol=1e-10)
    assert_allclose(fit.covariance, expected, atol=1e-10)
    rest = target - rows @ value
    assert_allclose(fit.chi2, rest @ weight @ rest, rtol=1e-10)


@pytest.mark.parametrize(("size_deg", "tolerance"), [(0.3, 1e-4), (30.0, 1e-12)])
def test_the_flange_is_off_as_far_as_the_poses_are_apart(size_deg: float, tolerance: float) -> None:
    _, comparison = compared(1)
    error = np.tile(np.deg2rad([size_deg, 0, -size_deg, 0, size_deg / 2, 0]), (len(comparison), 1))
    reading, true = robots.forward(ARM, comparison.q), robots.forward(ARM, comparison.q - error)
    found = flange_error(comparison, ARM, error)
    turned = Rotation.from_matrix(reading[:, :3, :3] @ true[:, :3, :3].swapaxes(1, 2))
    assert_allclose(found[:, :3], reading[:, :3, 3] - true[:, :3, 3], atol=tolerance)
    assert_allclose(found[:, 3:], turned.as_rotvec(), atol=tolerance)
