"""Axes from one-joint sweeps: against the table they were made with, in the scatter they state."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from robots.transforms import rotation_exp
from tests.support.motions import HOME
from tests.support.simulated import InMemory, in_memory, measured_at_spots, sample
from verify.analysis.sweeps.segments import find_sweeps
from verify.calibration.axes.joint import fit_axis
from verify.calibration.axes.table import SweepResult, axes_from_sweeps
from verify.core.readings import Readings
from verify.core.records import Array, Measurement
from verify.errors import InputError
from verify.measurement.systematics import stated_systematics
from verify.simulation.scenario import Scenario, ScenarioFault, SingleJoint

REPLICATES = 60
POSE_SIGMA = np.array([2e-5, 2e-5, 8e-5, 4e-4, 4e-4, 2e-4])  # m and rad


def circling(rng: np.random.Generator, n: int = 20) -> tuple[Array, Array, Array, Array, Array]:
    """Poses that turn about a line, with noise: direction, point, angles, poses, covariance."""
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    point = rng.normal(0, 0.3, 3)
    angle = np.deg2rad(np.linspace(-15, 15, n)) + 0.3
    start = np.eye(4)
    start[:3, :3] = Rotation.random(rng=rng).as_matrix()
    start[:3, 3] = rng.normal(0, 0.4, 3)
    turn = np.tile(np.eye(4), (n, 1, 1))
    turn[:, :3, :3] = rotation_exp(angle[:, None] * direction)
    turn[:, :3, 3] = point - turn[:, :3, :3] @ point
    poses = turn @ start
    noise = rng.normal(size=(n, 6)) * POSE_SIGMA
    poses[:, :3, :3] = rotation_exp(noise[:, 3:]) @ poses[:, :3, :3]
    poses[:, :3, 3] += noise[:, :3]
    return direction, point, angle, poses, np.tile(np.diag(POSE_SIGMA**2), (n, 1, 1))


@pytest.mark.slow
def test_d_squared_of_an_axis_is_chi_squared() -> None:
    lines, angles = [], []
    for seed in range(REPLICATES):
        rng = np.random.default_rng(seed)
        direction, point, angle, poses, covariance = circling(rng)
        axis = fit_axis(poses, covariance, angle + rng.normal(0, 1e-4, len(angle)))
        tilt = axis.across @ (direction - axis.direction)
        along = direction * (direction @ (axis.point - point))  # the same line's nearest point
        shift = axis.across @ (point + along - axis.point)
        error = np.concatenate([tilt, shift])
        lines.append(float(error @ np.linalg.solve(axis.covariance, error)) * axis.noise**2)
        off = axis.angle - axis.angle.mean() - (angle - angle.mean())
        spread = np.linalg.pinv(axis.angle_covariance, rcond=1e-9, hermitian=True)
        angles.append(float(off @ spread @ off) * axis.noise**2)
    for d2, degrees in ((lines, 4), (angles, 19)):
        low, high = chi2.ppf([0.005, 0.995], degrees * REPLICATES)
        assert low < sum(d2) < high


def sweeping(t: Array, joints: list[tuple[int, ...]], amplitude: float) -> Array:
    """Each group of joints swings in a slot of four seconds of its own."""
    q = np.tile(HOME, (len(t), 1))
    for slot, group in enumerate(joints):
        phase = np.clip((t - 4 * slot) / 4, 0, 1) * 2 * np.pi
        for joint in group:
            q[:, joint] += amplitude * np.sin(phase)
    return q


def test_sweeps_are_found_and_joints_that_move_together_are_named() -> None:
    groups = [(0,), (1,), (2, 3), (5,)]
    log = np.arange(-0.5, 16.5, 0.02)
    q = sweeping(log, groups, 0.3)
    q += np.random.default_rng(0).normal(0, np.deg2rad(0.01), q.shape)
    t = np.arange(0, 16, 0.2)
    sweeps, notes = find_sweeps(Readings(log, q), t, np.arange(100, 100 + len(t)))
    assert [s.joint for s in sweeps] == [0, 1, 5]
    for slot, sweep in zip((0, 1, 3), sweeps, strict=True):
        assert np.all(np.abs(t[sweep.rows] - (4 * slot + 2)) < 2.21)
        assert 0.55 < sweep.span < 0.62
    assert any("in pairs 14" in note and "joints 3 and 4 move together" in note for note in notes)


def scenario(faults: list[ScenarioFault], amplitude: float = 15.0, pairs: int = 150) -> Scenario:
    """One joint after the other, both cameras at one instant."""
    built = sample(pairs=pairs, rate_hz=5.0, skew_s=0.0, skew_jitter_s=0.0)
    motion = SingleJoint(home_deg=built.motion.home_deg, amplitude_deg=[amplitude] * 6)
    return msgspec.structs.replace(built, motion=motion, fault=faults)


def measured(session: InMemory) -> list[Measurement]:
    stated = stated_systematics(session.rig, session.marker, turning=False)
    return list(measured_at_spots(session, stated, np.random.default_rng(0), sigma=0.02))


@pytest.fixture(scope="module")
def faulty() -> tuple[InMemory, SweepResult]:
    """Joint 3's encoder: 1 % of gain and an offset that no sweep by itself can show."""
    session = in_memory(scenario([ScenarioFault(joint=3, gain=0.01, offset_deg=0.4)]))
    return session, axes_from_sweeps(session, measured(session))


def test_all_encoders_but_the_faulty_one_agree_with_the_rotation(
    faulty: tuple[InMemory, SweepResult],
) -> None:
    _, found = faulty
    assert [j.joint for j in found.joints] == [1, 2, 3, 4, 5, 6]
    for joint in found.joints:
        gear = 1 / 1.01 if joint.joint == 3 else 1.0
        assert abs(joint.gear - gear) < 3.5 * joint.gear_uncertainty
        assert joint.gear_uncertainty < 1e-3
        assert np.rad2deg(np.sqrt(np.mean(joint.nonlinearity**2))) < 0.02  # readings: 0.01°
    assert [i for i, d in enumerate(found.decisions[:6]) if "not 1" in d] == [2]


def test_axes_lie_as_in_the_table(faulty: tuple[InMemory, SweepResult]) -> None:
    session, found = faulty
    assert [p.joints for p in found.pairs] == [(i, i + 1) for i in range(1, 6)]
    assert [p.parallel for p in found.pairs] == [False, True, True, False, False]
    for joint, pair in enumerate(found.pairs):
        assert_allclose(abs(pair.distance_table), abs(session.arm.a[joint]), atol=1e-9)
        assert abs(pair.distance - pair.distance_table) < 4 * pair.distance_uncertainty
        assert pair.distance_uncertainty < 3e-4  # of use: a link's millimetre is no secret
        assert pair.agrees


def test_what_a_base_by_axes_1_and_2_would_rest_on_is_said(
    faulty: tuple[InMemory, SweepResult],
) -> None:
    _, found = faulty
    assert any("rests on joint 1's encoder" in d for d in found.decisions)


def test_a_link_longer_than_in_the_table_is_found(faulty: tuple[InMemory, SweepResult]) -> None:
    session, _ = faulty
    shorter = session.arm.a - np.array([0, 1e-3, 0, 0, 0, 0])
    output = replace(session, arm=replace(session.arm, a=shorter))
    wrong = [p for p in axes_from_sweeps(output, measured(session)).pairs if not p.agrees]
    assert [p.joints for p in wrong] == [(2, 3)]
    assert_allclose(wrong[0].distance - wrong[0].distance_table, 1e-3, atol=2e-4)


def test_spans_that_are_too_small_are_left_out_and_none_left_is_refused() -> None:
    session = in_memory(scenario([], amplitude=1.5, pairs=60))
    with pytest.raises(InputError, match=r"Joint 1 turns by [23]\.\d° only; 5° are needed"):
        axes_from_sweeps(session, measured(session))
    late = replace(session, encoders=replace(session.encoders, t=1e3 * session.encoders.t))
    with pytest.raises(InputError, match="look like milliseconds"):
        axes_from_sweeps(late, measured(session))


def test_a_motion_of_all_joints_is_refused() -> None:
    session = in_memory(sample(skew_s=0.0, skew_jitter_s=0.0, pairs=30))
    with pytest.raises(InputError, match="no joint is swept alone"):
        axes_from_sweeps(session, measured(session))
