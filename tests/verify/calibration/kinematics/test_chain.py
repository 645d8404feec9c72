"""A chain is the same arm: against pinocchio, and its columns against differences."""

import numpy as np
import pytest

import robots
from robots.transforms import difference
from tests.support.postures import linked
from tests.support.true_arm import readings
from verify.calibration.kinematics.chain import (
    ArmState,
    chain_of,
    change_state,
    geometry_parameters,
    offset_parameters,
    registration_parameters,
)
from verify.calibration.kinematics.model import predict_poses, predict_with_jacobian

ARMS = (*robots.names(), *robots.example_names())


def at_home(arm: robots.Arm) -> ArmState:
    return ArmState(chain_of(arm), np.eye(4)[None], np.eye(4)[None])


@pytest.mark.parametrize("name", ARMS)
def test_a_chain_puts_the_flange_where_the_arm_does(name: str) -> None:
    arm = robots.load(name)
    q, none = readings(arm, 20, seed=1), np.zeros(20, dtype=np.int64)
    assert np.allclose(
        predict_poses(at_home(arm), q, none, none), robots.forward(arm, q), atol=1e-12
    )


def test_the_ur10s_table_is_that_of_its_maker() -> None:
    """UR10's published table but for the senses of axes: d1, a2, a3, d4, d5 of the datasheet."""
    chain = chain_of(robots.load("ur10"))
    lengths = [chain.d[0], chain.a[1], chain.a[2], chain.d[3], chain.d[4]]
    assert np.allclose(lengths, [0.1273, 0.612, 0.5723, 0.163941, 0.1157], atol=1e-9)
    assert np.allclose(np.degrees(np.abs(chain.alpha[:5])), [90, 0, 0, 90, 90], atol=1e-9)
    assert chain.hayati == (1, 2)


@pytest.mark.parametrize("name", ["iust_6r", "rv_3sd_melfa", "ur10", "panda"])
def test_columns_are_what_small_changes_do(name: str) -> None:
    arm = robots.load(name)
    arm = linked(arm) if name == "rv_3sd_melfa" else arm
    state = at_home(arm)
    parameters = (
        *registration_parameters(1, 1, position_only=False),
        *offset_parameters(state.chain),
        *geometry_parameters(state.chain),
    )
    start = np.random.default_rng(2).normal(0, 0.02, len(parameters))
    start[[i for i, p in enumerate(parameters) if p.axis in ("rx", "ry", "rz")]] = 0.0
    state = change_state(state, parameters, start)
    q, none = readings(arm, 8, seed=3), np.zeros(8, dtype=np.int64)
    _, columns = predict_with_jacobian(state, q, none, none, parameters)
    step = 1e-6
    for k, parameter in enumerate(parameters):
        change = step * np.eye(len(parameters))[k]
        ahead = predict_poses(change_state(state, parameters, change), q, none, none)
        behind = predict_poses(change_state(state, parameters, -change), q, none, none)
        seen = difference(ahead, behind) / (2 * step)
        assert np.allclose(columns[:, :, k], seen, atol=1e-7), parameter.name
