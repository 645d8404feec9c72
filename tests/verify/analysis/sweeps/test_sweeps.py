"""Single-joint sweeps: faults put in come back, healthy joints stay so, no registration enters."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

import robots
from tests.support import motions
from tests.support.motions import ARM, ESTIMATED, GIVEN, HOME, make_track, model_of
from tests.support.scene import make_marker, make_rig
from verify.analysis.comparison import ReadingUncertainty, compare
from verify.analysis.sweeps.axis import SweepData, fit_axis, fit_circles
from verify.analysis.sweeps.segments import comparison_segments
from verify.analysis.sweeps.sweeps import JointSweep, judge_sweeps
from verify.core.readings import Readings
from verify.core.records import Array
from verify.measurement.systematics import stated_systematics
from verify.simulation.scenario import ScenarioFault
from verify.simulation.session.simulate import reading_error
from verify.simulation.world.motion import MotionProfile, SequentialSwings, StationaryPoses

SLOT = 6.0  # s a joint
T, LOG = np.arange(0.5, 0.5 + 6 * SLOT, 0.1), np.arange(0.0, 1.0 + 6 * SLOT, 0.02)
FAULTS = (
    ScenarioFault(joint=2, backlash_deg=0.3),
    ScenarioFault(joint=3, gain=0.005),
    ScenarioFault(joint=5, gain=-0.004, backlash_deg=-0.2),
)


def one_by_one(amplitude_deg: float = 25.0) -> SequentialSwings:
    return SequentialSwings(HOME, np.full(6, np.deg2rad(amplitude_deg)), 0.5, SLOT)


def swept(
    seed: int,
    faults: tuple[ScenarioFault, ...] = (),
    motion: MotionProfile | None = None,
    *,
    clock_off: float | None = None,
    grain: float | None = None,
    moved: Callable[[Array], Array] = np.copy,
) -> list[JointSweep]:
    """Sweeps of the arm; `moved` makes of its poses (n, 4, 4) those that are measured."""
    rng = np.random.default_rng(seed)
    path = one_by_one() if motion is None else motion
    track = make_track(T, path.angles(T), rng)
    track = replace(track, base_T_flange=moved(track.base_T_flange))
    q = path.angles(LOG)
    read = q + reading_error(LOG, q, path.direction(LOG), faults)
    read = read + rng.normal(0, np.deg2rad(0.005), q.shape)
    read = read if grain is None else np.round(read / grain) * grain
    comparison = compare(
        track, ARM, Readings(LOG, read), clock_off or 0.0, stated=ReadingUncertainty(grain)
    )
    clock = GIVEN if clock_off is None else ESTIMATED
    model = model_of(track, comparison, "fixture", "jig", clock)
    stated = stated_systematics(make_rig(), make_marker(), turning=False)
    return judge_sweeps(
        model, motions.compared_session(track, comparison, stated, clock, encoder_resolution=grain)
    )


@cache
def healthy() -> tuple[JointSweep, ...]:
    return tuple(s for seed in range(12) for s in swept(100 + seed))


def pull(value: float, uncertainty: float, truth: float = 0.0) -> float:
    return (value - truth) / uncertainty


def test_when_all_joints_move_there_is_no_sweep() -> None:
    assert comparison_segments(motions.compared(1)[1], None) == []


def test_faults_come_back_with_the_uncertainty_that_is_stated() -> None:
    gain = {2: 0.005, 4: -0.004}
    hysteresis = {1: np.deg2rad(0.3), 4: np.deg2rad(-0.2)}
    pulls = []
    for seed in range(12):
        for s in swept(200 + seed, FAULTS):
            pulls.append(pull(s.gain.value, s.gain.uncertainty, gain.get(s.joint, 0.0)))
            there = hysteresis.get(s.joint, 0.0)
            pulls.append(pull(s.hysteresis.value, s.hysteresis.uncertainty, there))
            assert s.gain.uncertainty < 6e-4
            assert s.hysteresis.uncertainty < np.deg2rad(0.015)
    square = float(np.sum(np.square(pulls)))
    assert chi2.ppf(0.0005, len(pulls)) < square < chi2.ppf(0.9995, len(pulls))


def test_healthy_joints_have_no_findings() -> None:
    pulls = [pull(s.gain.value, s.gain.uncertainty) for s in healthy()]
    pulls += [pull(s.hysteresis.value, s.hysteresis.uncertainty) for s in healthy()]
    square = float(np.sum(np.square(pulls)))
    assert chi2.ppf(0.0005, len(pulls)) < square < chi2.ppf(0.9995, len(pulls))
    assert np.abs(pulls).max() < 4.0
    assert not any(s.eccentric for s in healthy())
    for chances in ([s.nonlinear_p for s in healthy()], [s.wobble_p for s in healthy()]):
        assert kstest(chances, "uniform").pvalue > 1e-3


def test_an_eccentric_encoder_shows_where_the_joint_turns_far_enough() -> None:
    fault = (ScenarioFault(joint=6, eccentricity_deg=0.3, phase_deg=float(np.rad2deg(HOME[5]))),)
    pulls = []
    for seed in range(8):
        last = swept(300 + seed, fault, one_by_one(70.0))[-1]
        assert last.joint == 5
        assert last.eccentric
        pulls.append(pull(last.eccentricity.value, last.eccentricity.uncertainty, np.deg2rad(0.3)))
        pulls.append(pull(last.phase.value, last.phase.uncertainty, HOME[5]))
        assert last.nonlinear_p > 1e-4
    assert np.sum(np.square(pulls)) < chi2.ppf(0.9995, len(pulls))
    short = swept(1, (ScenarioFault(joint=6, eccentricity_deg=1.5),))[-1]
    # over 50° a wave is a bow, and a bow no eccentricity
    assert not short.eccentric
    assert short.nonlinear_p < 1e-3


def test_one_way_shows_no_hysteresis_and_no_figure_is_made_up_for_it() -> None:
    turned = HOME + np.deg2rad(40) * np.eye(6)[2]
    one_way = StationaryPoses(np.stack([HOME, turned]), np.array([-np.inf, 1.0]), 20.0)
    found = swept(1, (ScenarioFault(joint=3, gain=0.01),), one_way)
    assert [s.joint for s in found] == [2]
    assert np.isnan(found[0].hysteresis.value)
    assert abs(pull(found[0].gain.value, found[0].gain.uncertainty, 0.01)) < 4


def test_results_do_not_depend_on_base_and_led_poses() -> None:
    rng = np.random.default_rng(5)
    elsewhere = np.tile(np.eye(4), (2, 1, 1))
    elsewhere[:, :3, :3] = Rotation.random(2, random_state=rng).as_matrix()
    elsewhere[:, :3, 3] = rng.normal(0, 0.2, (2, 3))
    elsewhere[1, :3, 3] = 0.0  # what a lever does to the poses' noise is not the sweep's matter
    moved = swept(7, FAULTS, moved=lambda poses: elsewhere[0] @ poses @ elsewhere[1])
    for plain, other in zip(swept(7, FAULTS), moved, strict=True):
        assert_allclose(other.gain.value, plain.gain.value, atol=0.35 * plain.gain.uncertainty)
        u = plain.hysteresis.uncertainty
        assert_allclose(other.hysteresis.value, plain.hysteresis.value, atol=0.35 * u)


def test_an_error_of_the_clock_is_not_taken_for_hysteresis() -> None:
    given, fitted = swept(1), swept(1, clock_off=0.01)  # the readings' clock is right as it is
    assert all(abs(pull(s.hysteresis.value, s.hysteresis.uncertainty)) < 4 for s in fitted)
    for known, free in zip(given, fitted, strict=True):
        assert free.hysteresis.uncertainty > 1.3 * known.hysteresis.uncertainty


def test_readings_of_a_coarse_grain_flicker_and_still_rest() -> None:
    found = swept(3, (ScenarioFault(joint=4, backlash_deg=0.4),), grain=float(np.deg2rad(0.1)))
    assert [s.joint for s in found] == [0, 1, 2, 3, 4, 5]
    fourth = found[3].hysteresis
    assert abs(pull(fourth.value, fourth.uncertainty, np.deg2rad(0.4))) < 4


def test_play_that_is_taken_up_shows_as_hysteresis_and_as_nothing_else() -> None:
    """The driven side rests until the play is taken up: the truth follows step by step."""
    path, play = one_by_one(35.0), np.deg2rad(0.3)
    fine = np.arange(0.0, T[-1] + 0.01, 0.005)
    driving = path.angles(fine)
    driven = driving[:, 3].copy()
    for i in range(1, len(fine)):
        low, high = driving[i, 3] - play / 2, driving[i, 3] + play / 2
        driven[i] = min(max(driven[i - 1], low), high)
    true = path.angles(T)
    true[:, 3] = np.interp(T, fine, driven)

    def measured(poses: Array) -> Array:
        noise = poses @ np.linalg.inv(robots.forward(ARM, path.angles(T)))
        return np.asarray(noise @ robots.forward(ARM, true))

    for seed in range(4):
        for s in swept(400 + seed, motion=path, moved=measured):
            there = play if s.joint == 3 else 0.0
            assert abs(pull(s.hysteresis.value, s.hysteresis.uncertainty, there)) < 3.5
            assert abs(pull(s.gain.value, s.gain.uncertainty)) < 4
            assert not s.eccentric
            assert s.hysteresis.uncertainty < np.deg2rad(0.02)


def test_one_pose_far_off_is_left_out_and_accuses_no_joint() -> None:
    def measured(poses: Array) -> Array:
        wrong = poses.copy()
        wrong[80, 0, 3] += 0.02
        return wrong

    second = swept(500, motion=one_by_one(35.0), moved=measured)[1]
    assert second.joint == 1
    assert len(second.outlying) == 1
    assert abs(pull(second.gain.value, second.gain.uncertainty)) < 4
    assert second.gain.uncertainty < 1e-3
    assert not second.eccentric
    assert second.nonlinear_p > 1e-3


def test_poses_that_repeat_while_the_joint_turns_make_no_eccentricity() -> None:
    def measured(poses: Array) -> Array:
        wrong = poses.copy()
        wrong[80:86] = wrong[80]
        return wrong

    second = swept(500, motion=one_by_one(35.0), moved=measured)[1]
    assert second.joint == 1
    assert not second.eccentric
    assert abs(pull(second.gain.value, second.gain.uncertainty)) < 4


@pytest.mark.parametrize("joint", range(6))
def test_the_axis_is_where_pinocchio_has_it(joint: int) -> None:
    """Noise-free poses of a UR5 by pinocchio, one joint turning through 60°."""
    arm = robots.load("ur5")
    model, data = arm.model, arm.model.createData()
    q = np.tile([0.4, -1.1, 1.3, -0.7, 0.9, 0.2], (30, 1))
    q[:, joint] += np.linspace(0, np.deg2rad(60), 30)
    poses = []
    for one in q:
        pinocchio.forwardKinematics(model, data, one)
        poses.append(data.oMi[6].homogeneous.copy())
    seen = SweepData(
        poses=np.array(poses),
        covariance=np.tile(np.diag([1e-10] * 3 + [1e-8] * 3), (30, 1, 1)),
        held=np.zeros((30, 6, 0)),
        q=q[:, joint],
        reading_variance=np.full(30, 1e-12),
    )
    terms = q[:, [joint]] - q[:, joint].mean()
    fit, line = fit_axis(seen, terms), fit_circles(seen, terms).state
    frame = data.oMi[joint + 1]
    # the axis that the joint's Jacobian column turns about, in the world
    column = pinocchio.computeJointJacobians(model, data, q[-1])[:, joint]
    axis = column[3:] / np.linalg.norm(column[3:])
    assert_allclose(line.direction, axis, atol=1e-8)
    assert_allclose(np.cross(line.point - frame.translation, axis), 0, atol=1e-8)
    assert_allclose(fit.value, 0, atol=1e-8)
    assert fit.chi2_rest < 1e-3


def test_a_base_that_gives_way_is_no_fixed_axis() -> None:
    """The flange leaves its circle by 0.3 mm, once there and back: no turn explains that."""

    def soft(poses: Array) -> Array:
        given = poses.copy()
        given[:, 2, 3] += 3e-4 * np.sin(2 * one_by_one().angles(T)[:, 1] / np.deg2rad(25))
        return given

    found = swept(8, moved=soft)
    assert found[1].wobble_p < 1e-6
    assert min(s.wobble_p for s in found if s.joint != 1) > 1e-3


def test_a_pair_off_the_circle_is_left_out_and_listed_and_a_tenth_of_them_are_not() -> None:
    for wrong in ([85], list(range(66, 116, 4))):
        off = np.zeros((len(T), 4, 4))
        off[wrong, :3, 3] = 1.5e-3
        second = swept(9, moved=off.__add__)[1]
        assert second.joint == 1
        if len(wrong) == 1:
            assert second.outlying.tolist() == wrong
            assert wrong[0] not in second.rows
            assert second.wobble_p > 1e-3
            assert abs(pull(second.gain.value, second.gain.uncertainty)) < 4
        else:
            assert not len(second.outlying)
            assert second.wobble_p < 1e-6
