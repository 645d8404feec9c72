"""Judgement on tracks with known truth: the numbers a metrologist would check by hand.

The stated uncertainty of the mean errors holds the truth: metrology.md section 5 (b), small.

Each replicate draws one true world about the stated rig, base, and marker, projects its LEDs with
OpenCV, and hands the measurement what the files state. The arm is healthy, so every mean error is
zero and d² of the six means follows chi-squared with six degrees of freedom.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import robots
from tests.support.drawn_rig import SPOT_SIGMA, believed, drawn
from tests.support.motions import (
    ARM,
    ESTIMATED,
    GIVEN,
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
from tests.support.scene import sight
from verify.analysis.comparison import compare
from verify.analysis.diagnosis.causes import Cause
from verify.analysis.diagnosis.diagnose import find_causes
from verify.analysis.joint_errors import MeanErrors, mean_errors, resolve_errors
from verify.analysis.least_squares import solve
from verify.analysis.model import JointErrorModel, build_model, visibility
from verify.analysis.verdict import judge_joint
from verify.core.fiducials import Marker
from verify.core.readings import Readings
from verify.core.records import Array, Measurement
from verify.core.rig import Rig
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import Systematics, sensitivities, stated_systematics
from verify.measurement.track import collect_track


def diagnosed(model: JointErrorModel) -> list[Cause]:
    return find_causes(model, resolve_errors(model)).causes


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
        offset = np.deg2rad(0.01) * np.eye(6)[joint]
        moved = robots.forward(arm, comparison.q + offset)
        before = np.linalg.norm(residual(np.zeros(12), moved))
        fit = least_squares(residual, np.zeros(12), args=(moved,), xtol=1e-14, ftol=1e-14)
        share = np.linalg.norm(fit.fun) / before
        assert_allclose(visibility(model).fraction[joint], share, rtol=0.02)


def test_a_detectable_but_inseparable_offset_is_ambiguous() -> None:
    track, comparison = compared(6)
    seen = visibility(model_of(track, comparison, "motion", "motion"))
    assert seen.separable[2] > 2 * seen.detectable[2]
    size = 6 / 4.13 * seen.detectable[2]  # six standard uncertainties: noticed every time
    error = size * np.eye(6)[2]
    causes = diagnosed(model_of(*compared(6, error), "motion", "motion"))
    assert [c.kind for c in causes] == ["ambiguous"]
    assert causes[0].joint is None
    assert 3 in {c.joint for c in causes[0].candidates}


def test_a_healthy_joint_conforms_and_an_offset_beyond_the_tolerance_does_not() -> None:
    tolerance = np.deg2rad(0.2)
    track, comparison = compared(7, np.deg2rad([0, 0, 0.3, 0, 0, 0]))
    model = model_of(track, comparison, "fixture", "jig")
    resolved, seen = resolve_errors(model), visibility(model)
    verdicts = [judge_joint(resolved, j, tolerance, float(seen.detectable[j])) for j in range(6)]
    assert [v.verdict for v in verdicts] == ["conform"] * 2 + ["nonconform"] + ["conform"] * 3
    tight = judge_joint(resolved, 0, float(seen.detectable[0]) / 2, float(seen.detectable[0]))
    assert (tight.verdict, tight.reason) == ("undecided", "not_detectable")


def test_an_error_that_grows_with_the_angle_is_judged_at_its_end_not_by_its_mean() -> None:
    """A gain of 1 % about the middle has mean zero and 0.25° at the ends of a 50° swing."""
    rng = np.random.default_rng(9)
    track = make_track(PAIRS, swinging(PAIRS), rng)
    readings = read(swinging, LOG, 0.0, rng)
    middle = np.deg2rad(30.0)
    crooked = readings.q.copy()
    crooked[:, 5] += 0.01 * (crooked[:, 5] - middle)
    comparison = compare(track, ARM, type(readings)(readings.t, crooked), 0.0)
    model = model_of(track, comparison, "fixture", "jig")
    verdict = judge_joint(resolve_errors(model), 5, np.deg2rad(0.15), 0.0)
    assert verdict.verdict == "nonconform"
    assert abs(abs(np.rad2deg(verdict.worst)) - 0.25) < 0.02


def test_an_error_that_no_term_describes_is_a_lack_of_fit() -> None:
    rng = np.random.default_rng(10)
    track = make_track(PAIRS, swinging(PAIRS), rng)
    readings = read(swinging, LOG, 0.0, rng)
    crooked = readings.q.copy()
    crooked[:, 1] += np.deg2rad(0.1) * np.sin(40 * crooked[:, 1])
    comparison = compare(track, ARM, type(readings)(readings.t, crooked), 0.0)
    resolved = resolve_errors(model_of(track, comparison, "fixture", "jig"))
    assert resolved.lack_of_fit
    assert judge_joint(resolved, 0, np.deg2rad(1.0), 0.0).reason == "lack_of_fit"


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


REPLICATES = 40  # d²/6 is then known to 9 %
VISITS = 6
SPREAD = np.deg2rad([12.0, 8.0, 9.0, 12.0, 14.0, 25.0])


def replicate(rig: Rig, marker: Marker, parameters: Systematics, seed: int) -> MeanErrors:
    """A few visits of a healthy arm in one true world, measured with what is stated."""
    rng = np.random.default_rng(seed)
    true_rig, true_marker = drawn(rig, marker, rng)
    q = HOME + SPREAD * rng.uniform(-1, 1, (VISITS, 6))
    t = 5.0 * np.arange(VISITS)
    poses: Array = true_rig.rig_T_base @ robots.forward(ARM, q)
    measurements, effects = [], []
    for i in range(VISITS):
        true_pose: Array = poses[i]
        left, right = sight(true_rig, true_marker, true_pose, SPOT_SIGMA, rng)
        pose = fit_pose(left, right, rig, marker, true_pose)
        seen = Measurement(i, float(t[i]), "measured", len(marker), pose, left, right)
        measurements.append(seen)
        effects.append(sensitivities(parameters, seen, rig, marker))
    track = collect_track(measurements, rig, effects)
    log = (t[:, None] + np.linspace(-0.2, 0.2, 5)).ravel()
    comparison = compare(track, ARM, Readings(log, np.repeat(q, 5, axis=0)), 0.0)
    model = build_model(comparison, track, rig, marker, GIVEN, parameters)
    return mean_errors(model, resolve_errors(model), parameters)


@pytest.mark.slow
def test_d_squared_of_the_mean_errors_is_chi_squared() -> None:
    rig, marker = believed(doubts=True)
    parameters = stated_systematics(rig, marker, turning=False)
    means = [replicate(rig, marker, parameters, seed) for seed in range(REPLICATES)]
    d2 = [float(m.mean @ np.linalg.solve(m.covariance, m.mean)) for m in means]
    degrees = 6 * REPLICATES
    low, high = chi2.ppf(0.005, degrees), chi2.ppf(0.995, degrees)
    assert low < sum(d2) < high
    z = np.array([m.mean / np.sqrt(np.diag(m.covariance)) for m in means])
    # six intervals of a replicate hold or miss together at worst: binomial of 40, three deviations
    assert np.mean(np.abs(z) < 1.96) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / REPLICATES)
