"""A rendered session with a known fault, by its pictures: what comes back, and what cannot."""

import numpy as np
import pytest

from tests.verify.recorded import require_shared
from verify.arm_identification import Identified, Wish, chain_of, identify
from verify.arm_identification.parameters import Parameter
from verify.arm_identification.session_poses import Gathered, Seen, gather, less_repetitive, see
from verify.session import open_session

FAULT_DEG = 0.40  # joint 3 reads too high by it, says the session's own note


@pytest.fixture(scope="module")
def seen() -> Seen:
    session = open_session(require_shared() / "multi_joint_fault_6r")
    return see(session, lambda _done, _total: None)


def found(gathered: Gathered, *, free: bool) -> Identified:
    chain = chain_of(gathered.seen[0].session.arm)
    wish = Wish(free_base=free, free_tool=free, splits=0)
    return identify(chain, gathered.poses, wish, gathered.state(chain))


def offset_deg(identified: Identified, joint: int) -> tuple[float, float]:
    fit = identified.level("offsets").fit
    k = fit.parameters.index(Parameter("correction", joint - 1))
    u = float(np.sqrt(fit.covariance[k, k]))
    return float(np.degrees(-fit.change[k])), float(np.degrees(u))


@pytest.mark.shared
def test_the_faulty_encoder_comes_back_and_no_other(seen: Seen) -> None:
    gathered = gather([seen])
    assert not gathered.free_base
    first = found(gathered, free=False)
    again = found(less_repetitive(gathered, first), free=False)
    assert again.chosen.name == "offsets"
    for joint, truth in enumerate([0.0, 0.0, FAULT_DEG, 0.0, 0.0, 0.0], start=1):
        error, u = offset_deg(again, joint)
        assert abs(error - truth) < 3 * u, joint
        assert u < 0.02


@pytest.mark.shared
def test_through_its_own_encoders_joints_1_and_6_cannot_show(seen: Seen) -> None:
    identified = found(gather([seen]), free=True)
    held = {h.parameter.name: h for h in identified.level("offsets").support.held}
    assert set(held) == {"offset_1", "offset_6"}
    assert held["offset_1"].with_[0][0].name == "base_rz"
    assert held["offset_6"].with_[0][0].name == "tool_rz"
    error, u = offset_deg(identified, 3)
    assert abs(error - FAULT_DEG) < 3 * u
    assert u > 2 * offset_deg(found(gather([seen]), free=False), 3)[1]


@pytest.mark.shared
def test_sessions_with_one_rig_and_marker_share_what_these_state(seen: Seen) -> None:
    both = gather([seen, seen])
    single = gather([seen]).poses.nuisance.shape[2]
    assert both.poses.base.max() == both.poses.tool.max() == 0
    assert both.poses.nuisance.shape[2] == single + seen.own.shape[2]
    assert len(np.unique(both.poses.block)) == 20
