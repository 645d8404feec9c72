"""The corrected arm is read back by `robots.load` as what was identified."""

from pathlib import Path

import numpy as np
import pytest

import robots
from tests.support.postures import linked
from tests.support.true_arm import readings
from verify.calibration.kinematics.chain import (
    ArmState,
    chain_of,
    change_state,
    geometry_parameters,
    offset_parameters,
)
from verify.calibration.kinematics.model import predict_poses
from verify.calibration.kinematics.robot_file import encode_robot

ORIGIN = ["Identified from a--b.", "Before: an arm."], {"x/rig.toml": "sha256:00"}


def corrected(arm: robots.Arm, *, geometry: bool) -> ArmState:
    state = ArmState(chain_of(arm), np.eye(4)[None], np.eye(4)[None])
    some = offset_parameters(state.chain)
    some += geometry_parameters(state.chain) if geometry else []
    return change_state(state, tuple(some), np.random.default_rng(1).normal(0, 0.01, len(some)))


@pytest.mark.parametrize(
    "name", ["iust_6r", "rv_3sd_melfa", "linked rv_3sd_melfa", "ur10", "panda"]
)
@pytest.mark.parametrize("geometry", [False, True])
def test_a_corrected_arm_is_read_back(name: str, geometry: bool, tmp_path: Path) -> None:
    """A table of which only offsets changed keeps its closed form."""
    arm = robots.load(name.split()[-1])
    arm = linked(arm, 2) if "linked" in name else arm
    state = corrected(arm, geometry=geometry)
    file, content = encode_robot(arm, state.chain, *ORIGIN, offsets_only=not geometry)
    (tmp_path / file).write_bytes(content)
    again = robots.load(str(tmp_path / file))
    q, none = readings(arm, 10, seed=2), np.zeros(10, dtype=np.int64)
    assert np.allclose(robots.forward(again, q), predict_poses(state, q, none, none), atol=1e-10)
    assert np.allclose([again.lower, again.upper], [arm.lower, arm.upper])
    assert b"sha256:00" in content
    assert b"Identified from a" in content
    if isinstance(arm, robots.DhArm) and not geometry:
        assert isinstance(again, robots.DhArm)
        assert (file, again.name) == (f"{arm.name}_identified.toml", f"{arm.name}_identified")
        assert robots.self_check(again, poses=50, seed=1).lost == 0
