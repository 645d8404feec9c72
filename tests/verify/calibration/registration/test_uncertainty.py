"""What a registration hides, by brute force at spot level: no pictures needed."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from robots.transforms import difference
from tests.bench.registration import adjusted, spot_level
from tests.support.simulated import sample
from verify.calibration.registration.adjustment import AdjustedRegistration
from verify.calibration.registration.uncertainty import (
    absorbed_offsets,
    absorption,
    visible_fractions,
)
from verify.core.records import Array
from verify.simulation.session.simulate import SimulatedSession, simulate_session

OFFSET = np.deg2rad(0.1)


@pytest.fixture(scope="module")
def session() -> SimulatedSession:
    return simulate_session(msgspec.structs.replace(sample(), fault=[]))


@pytest.fixture(scope="module")
def healthy(session: SimulatedSession) -> AdjustedRegistration:
    return adjusted(session, spot_level(session, 0.0, np.random.default_rng(1)))


@pytest.mark.parametrize("joint", range(6))
def test_an_offset_moves_the_fit_by_what_it_takes_in_and_leaves_the_visible_fraction(
    session: SimulatedSession, healthy: AdjustedRegistration, joint: int
) -> None:
    error = np.zeros(6)
    error[joint] = OFFSET
    spotted = spot_level(session, 0.0, np.random.default_rng(1))
    faulty = adjusted(session, spotted, error)
    expected = -absorption(healthy)[:, joint] * OFFSET
    base = difference(faulty.at.rig_T_base[None], healthy.at.rig_T_base[None])[0]
    np.testing.assert_allclose(base, expected[:6], atol=5e-6 + 0.02 * np.abs(expected[:6]).max())
    leds = faulty.at.leds - healthy.at.leds
    body = expected[6:9] + np.cross(expected[9:], healthy.at.leds)
    np.testing.assert_allclose(leds, body, atol=1e-5 + 0.02 * np.abs(body).max())

    def size(residual: Array) -> float:
        white = np.linalg.solve(np.linalg.cholesky(spotted.covariance), residual[:, :, None])
        return float(np.linalg.norm(white))

    left = size(faulty.predicted.residual - healthy.predicted.residual)
    whole = size(healthy.predicted.by_joint[:, :, joint] * OFFSET)
    assert left / whole == pytest.approx(visible_fractions(healthy)[joint], abs=0.006)


def test_the_first_and_the_last_joint_are_hidden_altogether(healthy: AdjustedRegistration) -> None:
    fractions = visible_fractions(healthy)
    assert fractions[[0, 5]].tolist() == [0.0, 0.0]
    assert np.all(fractions[1:5] > 0.01)


def test_with_base_and_leds_held_nothing_takes_anything_in(healthy: AdjustedRegistration) -> None:
    free = np.zeros(healthy.at.size, dtype=bool)
    held = replace(healthy, free=free, inverse=np.zeros_like(healthy.inverse))
    assert not absorbed_offsets(held).any()
    assert visible_fractions(held).tolist() == [1.0] * 6
