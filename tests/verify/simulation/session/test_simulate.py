import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.simulated import played
from verify.core.records import Array
from verify.simulation.scenario import ScenarioEncoders, ScenarioFault, ScenarioRecording
from verify.simulation.session.simulate import SimulatedSession

# Encoders tick every 20 ms from 0 and pairs fall on ticks: reading and truth at one instant.
RECORDING = ScenarioRecording(pairs=60, rate_hz=25.0)


def error_deg(session: SimulatedSession) -> tuple[Array, Array, Array]:
    """Encoder less truth, truth, both in degrees, and d from the truth's own differences."""
    at = np.searchsorted(session.encoder_t, session.t[:, 0] - 1e-4)
    assert_allclose(session.encoder_t[at], session.t[:, 0], atol=1e-9)
    truth = np.degrees(session.truth)
    direction = np.sign(np.degrees(session.world.joints(session.t[:, 0] + 1e-5)) - truth)
    return np.degrees(session.encoder_q[at]) - truth, truth, direction


def faulty(*faults: ScenarioFault) -> SimulatedSession:
    return played(recording=RECORDING, fault=list(faults))


def test_each_fault_is_what_the_interface_defines_and_leaves_the_other_joints_alone() -> None:
    session = faulty(
        ScenarioFault(joint=1, offset_deg=0.4),
        ScenarioFault(joint=2, gain=0.01),
        ScenarioFault(joint=3, backlash_deg=0.6),
        ScenarioFault(joint=4, eccentricity_deg=0.3, phase_deg=25.0, per_turn=2),
        ScenarioFault(joint=5, step_deg=-0.2, step_t_s=1.5),
    )
    error, truth, direction = error_deg(session)
    assert_allclose(error[:, 0], 0.4, atol=1e-10)
    assert_allclose(error[:, 1], 0.01 * truth[:, 1], atol=1e-10)
    assert set(direction[:, 2]) == {-1, 1}
    assert_allclose(error[:, 2], 0.3 * direction[:, 2], atol=1e-10)
    wave = np.cos(2 * np.radians(truth[:, 3] - 25.0))
    assert_allclose(error[:, 3], 0.3 * wave, atol=1e-10)
    late = session.t[:, 0] >= 1.5
    assert_allclose(error[:, 4], -0.2 * late, atol=1e-10)
    assert_allclose(error[:, 5], 0, atol=1e-10)


def test_faults_of_one_joint_add_up() -> None:
    error, truth, _ = error_deg(
        faulty(
            ScenarioFault(joint=5, offset_deg=0.2),
            ScenarioFault(joint=5, offset_deg=0.1, gain=-0.02),
        )
    )
    assert_allclose(error[:, 4], 0.3 - 0.02 * truth[:, 4], atol=1e-10)


def test_the_clock_offset_is_what_brings_encoder_time_to_camera_time() -> None:
    encoders = ScenarioEncoders(noise_deg=0.0, clock_offset_s=0.137, clock_drift_ppm=200.0)
    session = played(recording=RECORDING, encoders=encoders)
    # the offset grows with the cameras' time: t = stamp + offset + drift t
    t = session.encoder_t + 0.137
    for _ in range(5):
        t = session.encoder_t + 0.137 + 200e-6 * t
    assert_allclose(session.encoder_q, session.world.joints(t), atol=1e-12)
    assert t[0] < session.t.min() - 0.5
    assert t[-1] > session.t.max() + 0.5


def test_readings_are_multiples_of_the_resolution() -> None:
    session = played(encoders=ScenarioEncoders(noise_deg=0.01, resolution_deg=0.05))
    counts = np.degrees(session.encoder_q) / 0.05
    assert_allclose(counts, np.round(counts), atol=1e-8)


def test_encoder_noise_has_the_stated_spread() -> None:
    exact, noisy = (
        played(recording=RECORDING, encoders=ScenarioEncoders(noise_deg=noise, rate_hz=500.0))
        for noise in (0.0, 0.02)
    )
    spread = np.degrees(noisy.encoder_q - exact.encoder_q)
    # 10,000 numbers: the standard deviation itself is good to 0.7 %; four of those
    assert spread.std() == pytest.approx(0.02, rel=0.028)
