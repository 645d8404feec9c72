"""Predictions against the results of the recorded session, and brute force."""

from dataclasses import replace
from functools import partial

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support import planning
from tests.support.motions import compared_session
from verify.analysis.comparison import compare
from verify.analysis.joint_errors import resolve_errors
from verify.analysis.least_squares import solve
from verify.analysis.model import build_model
from verify.analysis.session import analyse
from verify.analysis.uncertainty.budget import budget
from verify.core.readings import Readings
from verify.core.records import Array
from verify.planning.design import fault_kind
from verify.planning.foresight import PredictedSession, estimate_means
from verify.planning.plan import SessionPlan, predict_session
from verify.planning.prediction import RANDOM_SOURCE, predict_faults, uncertainty_sources
from verify.planning.request import FAULT_KINDS, PlanningSetup

PLAN_MOTION = "verify.simulation.session.simulate.plan_motion"
AGREES = 0.2  # of an uncertainty: noise of the pictures is taken as one number


@pytest.mark.slow
def test_a_recorded_session_agrees_with_the_prediction(
    bench: PlanningSetup, made: SessionPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through rendered pictures, detection, identification, and cameras that are off as stated."""
    session = planning.recorded(bench, made, partial(monkeypatch.setattr, PLAN_MOTION))
    np.testing.assert_allclose(session.rig.rig_T_base, bench.rig.rig_T_base, atol=1e-9)
    summary = analyse(session).summary
    foretold = made.prediction.analysis
    assert summary["pairs"]["measured"] == len(made.prediction.session.track)
    for key, predicted in (
        ("standard_uncertainty_deg", np.sqrt(np.diag(foretold.resolved.mean_covariance))),
        ("minimum_detectable_error_deg", foretold.visibility.detectable),
        ("minimum_separable_error_deg", foretold.visibility.separable),
    ):
        stated = [joint[key] for joint in summary["joints"]]
        np.testing.assert_allclose(np.rad2deg(predicted), stated, rtol=AGREES, err_msg=key)


@pytest.mark.slow
def test_a_recorded_sessions_clock_agrees_with_the_prediction(
    bench: PlanningSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it states grows with what offsets do not explain, which is another in every world."""
    made = planning.planned(bench, planning.wish(), planning.conditions(clock_uncertainty=None))
    unknown = msgspec.structs.replace(planning.SCENARIO, clock=None)
    session = planning.recorded(bench, made, partial(monkeypatch.setattr, PLAN_MOTION), unknown)
    stated = analyse(session).summary["clock"]["standard_uncertainty_s"]
    foretold = made.prediction.clock.standard_uncertainty
    assert made.prediction.clock.source == "estimated"
    assert 0.5 < foretold / stated < 2.0


def test_much_less_is_noticed_than_by_turning_joint_1_alone(
    bench: PlanningSetup, made: SessionPlan
) -> None:
    t = made.prediction.session.t
    home, sweep = np.deg2rad(planning.HOME_DEG), np.deg2rad(20.0)

    def quarter(at: Array) -> Array:
        q = np.tile(home, (len(at), 1))
        q[:, 0] += sweep * np.sin(np.pi * (np.asarray(at) / t[-1] - 0.5))
        return q

    usual = predict_session(
        bench, quarter, t, planning.wish(), planning.conditions(), np.random.default_rng(0)
    ).analysis.visibility
    ours = made.prediction.analysis.visibility
    assert (ours.detectable < usual.detectable).all()
    assert (ours.detectable[1:5] < 0.5 * usual.detectable[1:5]).all()
    assert (ours.separable < usual.separable).all()


def test_a_registration_through_the_encoders_hides_joints_1_and_6(bench: PlanningSetup) -> None:
    blind = replace(
        bench,
        rig=replace(bench.rig, base_source="motion"),
        marker=replace(bench.marker, source="motion"),
    )
    made = planning.planned(blind, planning.wish(), planning.conditions())
    visible = made.prediction.analysis.visibility
    assert visible.fraction[[0, 5]].tolist() == [0.0, 0.0]
    assert np.isnan(visible.detectable[[0, 5]]).all()
    assert np.isfinite(visible.detectable[1:5]).all()
    offsets, gains, backlash = made.prediction.faults
    assert np.isnan(offsets.standard_uncertainty[[0, 5]]).all()
    assert np.isfinite(backlash.standard_uncertainty).all()
    assert np.isfinite(gains.standard_uncertainty).all()


def test_an_error_of_a_given_clock_would_be_noticed(made: SessionPlan) -> None:
    clock = made.prediction.clock
    assert (clock.source, clock.standard_uncertainty) == ("given", 0.0)
    assert 1e-5 < clock.detectable < 1e-2


@pytest.mark.parametrize("name", ["offsets", "gains", "backlash", "eccentricity"])
def test_a_kind_s_column_is_what_such_a_fault_does(
    bench: PlanningSetup, made: SessionPlan, name: str
) -> None:
    """Readings with the fault in, set against the same poses: the whitened twist they add."""
    seen = made.prediction.session
    columns = fault_kind(name, seen.model).columns
    size, unit = 1e-4, 0.01 if name == "gains" else np.deg2rad(1.0)
    for j in (1, 4):
        effects = [faulty(bench, seen, name, j, part, size) for part in range(len(columns))]
        for effect, column in zip(effects, columns, strict=True):
            np.testing.assert_allclose(
                effect / size * unit, column[:, j], atol=2e-2 * np.abs(column[:, j]).max()
            )


def faulty(
    bench: PlanningSetup, seen: PredictedSession, name: str, j: int, part: int, size: float
) -> Array:
    """Whitened change of the twists by a fault of joint j, rad or ratio."""
    clean = seen.comparison
    shape = {
        "offsets": np.ones(len(clean)),
        "gains": clean.q[:, j],
        "backlash": clean.direction[:, j] / 2,
        "eccentricity": (np.cos(clean.q[:, j]), np.sin(clean.q[:, j]))[part],
    }[name]
    q = clean.q.copy()
    q[:, j] += size * shape
    # single visits at rest, each its own burst of readings: what is read is what is put in
    t = 10.0 * np.arange(len(q))
    log = (t[:, None] + np.linspace(-0.2, 0.2, 5)).ravel()
    still = replace(seen.track, t=np.asarray(t, dtype=np.float64))
    xi = [
        compare(still, bench.arm, Readings(log, np.repeat(rows, 5, axis=0)), 0.0).xi
        for rows in (q, clean.q)
    ]
    return seen.model.white.rows((xi[0] - xi[1])[:, :, None])[:, 0]


def test_offsets_alone_agree_with_the_analysis(made: SessionPlan) -> None:
    model = made.prediction.session.model
    alone = predict_faults(model, ("offsets",))[0]
    np.testing.assert_allclose(
        np.deg2rad(alone.detectable), made.prediction.analysis.visibility.detectable, rtol=1e-9
    )
    fit = solve(np.concatenate([model.offsets, model.fitted], axis=1), model.xi, model.prior)
    np.testing.assert_allclose(
        np.deg2rad(alone.standard_uncertainty), np.sqrt(np.diag(fit.covariance)[:6]), rtol=1e-9
    )


@pytest.mark.parametrize(("skew", "line_time"), [(0.0, 0.0), (0.006, 0.0), (-0.003, 2e-5)])
def test_pictures_taken_one_after_the_other_give_the_same_poses(
    bench: PlanningSetup, made: SessionPlan, skew: float, line_time: float
) -> None:
    """Each LED at its own instant: what alignment leaves lies within what it states."""
    rig = bench.rig
    rolling = replace(
        rig,
        left=replace(rig.left, line_time=line_time),
        right=replace(rig.right, line_time=line_time),
    )
    foretold = predict_session(
        replace(bench, rig=rolling), made.timed.q, made.prediction.session.t, planning.wish(),
        replace(planning.conditions(), skew=skew), np.random.default_rng(0),
    )  # fmt: skip
    seen = foretold.session
    assert len(seen.track) == len(seen.t)
    # readings alone are noisy here: a chi-squared with far fewer degrees of freedom than rows
    assert np.mean(seen.model.xi**2) < 1.2
    if skew:
        u, before = (
            np.diag(p.analysis.resolved.mean_covariance) for p in (foretold, made.prediction)
        )
        assert u.sum() > before.sum()


def test_the_sources_make_up_the_uncertainty(made: SessionPlan) -> None:
    foretold = made.prediction
    parts = uncertainty_sources(foretold.analysis)
    assert set(parts) >= {RANDOM_SOURCE, "rig", "robot base", "LED body"}
    whole = sum(share**2 for share in parts.values())
    np.testing.assert_allclose(
        whole, np.diag(foretold.analysis.resolved.mean_covariance), rtol=1e-9
    )


def test_every_request_is_predicted(bench: PlanningSetup) -> None:
    made = planning.planned(bench, planning.wish(observe=FAULT_KINDS), planning.conditions())
    found = made.prediction.geometry
    assert found.support.candidates == 6 + 6 + 2 + 6 + 6  # offsets, α, Hayati's β, a, d
    assert {h.parameter.name for h in found.support.held if h.redundant} == {"d_2", "d_3"}
    assert [one.name for one in made.prediction.faults] == list(FAULT_KINDS[:4])


def test_a_duration_is_filled_and_not_exceeded(bench: PlanningSetup) -> None:
    made = planning.planned(bench, planning.wish(poses=None, duration=40.0), planning.conditions())
    assert 25.0 < made.timed.duration <= 40.0
    assert max(stop.pose or 0 for stop in made.timed.stops) >= 4


@pytest.mark.parametrize("degrees", [5.0, 20.0, np.inf])
def test_a_plan_s_coverage_factor_is_the_budget_s(
    bench: PlanningSetup, made: SessionPlan, degrees: float
) -> None:
    """A calibration from few boards rules some joints and not others."""
    seen = made.prediction.session
    rig = replace(bench.rig, covariance=replace(bench.rig.covariance, degrees_of_freedom=degrees))
    systematics = replace(seen.systematics, degrees_of_freedom=degrees, uncounted=())
    model = build_model(seen.comparison, seen.track, rig, bench.marker, seen.clock, systematics)
    judged = estimate_means(replace(seen, systematics=systematics, model=model))
    compared = compared_session(
        seen.track,
        seen.comparison,
        systematics,
        seen.clock,
        arm=bench.arm,
        rig=rig,
        marker=bench.marker,
    )
    stated = budget(model, compared, resolve_errors(model)).coverage_factor
    assert_allclose(judged.coverage_factor, stated, rtol=1e-9)
    assert np.all(stated < 2.65)
    assert np.any(stated > 2.0) if degrees < 10 else np.any(stated == 2.0)
