"""The coverage factor that a plan foretells is the one that a session's budget states."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.testing import assert_allclose

from verify.joints import solve_joints
from verify.judgement.budget import budget
from verify.judgement.model import build
from verify.judgement.resolved import resolve
from verify.planning.foresight import judge
from verify.planning.plan import Plan
from verify.planning.wishes import Bench
from verify.session import Session


@pytest.mark.parametrize("degrees", [5.0, 20.0, np.inf])
def test_a_plan_s_coverage_factor_is_the_budget_s(bench: Bench, made: Plan, degrees: float) -> None:
    """A calibration from few boards rules some joints and not others."""
    seen = made.prediction.foreseen
    assert bench.rig.covariance is not None
    rig = replace(bench.rig, covariance=replace(bench.rig.covariance, degrees_of_freedom=degrees))
    systematics = replace(seen.systematics, degrees_of_freedom=degrees)
    model = build(seen.comparison, seen.track, rig, bench.marker, seen.clock, systematics)
    judged = judge(replace(seen, systematics=systematics, model=model), bench.arm)
    session = SimpleNamespace(
        arm=bench.arm, rig=rig, encoder_resolution=None, encoder_time_standard_uncertainty=None,
        instrument=None,
    )  # fmt: skip
    stated = budget(
        model, seen.comparison, solve_joints(seen.comparison, bench.arm), judged.errors,
        judged.means, resolve(model), cast("Session", session), systematics, seen.track,
        seen.clock,
    ).coverage_factor  # fmt: skip
    assert_allclose(judged.means.coverage_factor, stated, rtol=1e-9)
    assert np.all((stated > 2.0) & (stated < 2.65)) if degrees < 10 else np.any(stated == 2.0)
