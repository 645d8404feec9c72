"""A rendered session with a known fault, by its pictures: what comes back, and what cannot."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.recorded import require_shared
from verify.calibration.kinematics.chain import Parameter, chain_of
from verify.calibration.kinematics.identify import (
    IdentificationOptions,
    IdentificationResult,
    identify_arm,
)
from verify.calibration.kinematics.sessions import (
    CombinedPoses,
    SessionPoses,
    gather_sessions,
    session_to_poses,
)
from verify.io.session.session import open_session

pytestmark = pytest.mark.slow

FAULT_DEG = 0.40  # joint 3 reads too high by it, says the session's own note


@pytest.fixture(scope="module")
def seen() -> SessionPoses:
    session = open_session(require_shared() / "multi_joint_fault_6r")
    return session_to_poses(session, lambda _done, _total: None)


def found(gathered: CombinedPoses, *, free: bool) -> IdentificationResult:
    chain = chain_of(gathered.sessions[0].session.arm)
    wish = IdentificationOptions(free_base=free, free_tool=free, splits=2)
    return identify_arm(chain, gathered.poses, wish, gathered.state(chain))


def offset_deg(identified: IdentificationResult, joint: int) -> tuple[float, float]:
    fit = identified.level("offsets").fit
    k = fit.parameters.index(Parameter("correction", joint - 1))
    u = float(np.sqrt(fit.covariance[k, k]))
    return float(np.degrees(-fit.change[k])), float(np.degrees(u))


@pytest.mark.shared
def test_through_its_own_encoders_joints_1_and_6_cannot_show(seen: SessionPoses) -> None:
    identified = found(gather_sessions([seen]), free=True)
    held = {h.parameter.name: h for h in identified.level("offsets").support.held}
    assert set(held) == {"offset_1", "offset_6"}
    assert held["offset_1"].confounded_with[0][0].name == "base_rz"
    assert held["offset_6"].confounded_with[0][0].name == "tool_rz"
    error, u = offset_deg(identified, 3)
    assert abs(error - FAULT_DEG) < 3 * u
    assert u > 2 * offset_deg(found(gather_sessions([seen]), free=False), 3)[1]


@pytest.mark.shared
def test_sessions_with_one_rig_and_marker_share_what_these_state(seen: SessionPoses) -> None:
    other = replace(seen, session=replace(seen.session, folder=Path("another")))
    both = gather_sessions([seen, other])
    single = gather_sessions([seen]).poses.nuisance.shape[2]
    assert both.poses.base.max() == both.poses.tool.max() == 0
    assert both.poses.nuisance.shape[2] == single + seen.own.shape[2]
    assert len(np.unique(both.poses.block)) == 20
