"""What is foretold against what the whole tool states of the recorded session, and brute force."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from tests.verify.planning import scene
from verify.analysis import analyse
from verify.comparison import compare
from verify.planning.foresight import Foreseen
from verify.planning.kinds import kind
from verify.planning.plan import Plan, predict
from verify.planning.prediction import shown
from verify.planning.sources import RANDOM, sources
from verify.planning.wishes import KINDS, Bench
from verify.readings import Readings
from verify.records import Array
from verify.regression import solve

AGREES = 0.2  # of an uncertainty: noise of the pictures is taken as one number


def test_a_recorded_session_states_what_was_foretold(
    bench: Bench, made: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through rendered pictures, detection, identification, and cameras that are off as stated."""
    session = scene.recorded(
        bench, made, lambda plan: monkeypatch.setattr("verify.sim.sessions.plan", plan)
    )
    np.testing.assert_allclose(session.rig.rig_T_base, bench.rig.rig_T_base, atol=1e-9)
    summary = analyse(session).summary
    foretold = made.prediction.judged
    assert summary["pairs"]["measured"] == len(made.prediction.foreseen.track)
    for key, predicted in (
        ("standard_uncertainty_deg", np.sqrt(np.diag(foretold.means.covariance))),
        ("minimum_detectable_error_deg", foretold.visibility.detectable),
        ("minimum_separable_error_deg", foretold.visibility.separable),
    ):
        stated = [joint[key] for joint in summary["joints"]]
        np.testing.assert_allclose(np.rad2deg(predicted), stated, rtol=AGREES, err_msg=key)


def test_a_recorded_session_knows_its_clock_as_was_foretold(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it states grows with what offsets do not explain, which is another in every world."""
    made = scene.planned(bench, scene.wish(), scene.conditions(clock_uncertainty=None))
    session = scene.recorded(
        bench,
        made,
        lambda plan: monkeypatch.setattr("verify.sim.sessions.plan", plan),
        msgspec.structs.replace(scene.SCENARIO, clock=None),
    )
    stated = analyse(session).summary["clock"]["standard_uncertainty_s"]
    foretold = made.prediction.clock.standard_uncertainty
    assert made.prediction.clock.source == "estimated"
    assert foretold is not None
    assert 0.5 < foretold / stated < 2.0


def test_much_less_is_noticed_than_by_turning_joint_1_alone(bench: Bench, made: Plan) -> None:
    t = made.prediction.foreseen.t
    home, sweep = np.deg2rad(scene.HOME_DEG), np.deg2rad(20.0)

    def quarter(at: Array) -> Array:
        q = np.tile(home, (len(at), 1))
        q[:, 0] += sweep * np.sin(np.pi * (np.asarray(at) / t[-1] - 0.5))
        return q

    usual = predict(
        bench, quarter, t, scene.wish(), scene.conditions(), np.random.default_rng(0)
    ).judged.visibility
    ours = made.prediction.judged.visibility
    assert (ours.detectable < usual.detectable).all()
    assert (ours.detectable[1:5] < 0.5 * usual.detectable[1:5]).all()
    assert (ours.separable < usual.separable).all()


def test_a_registration_through_the_encoders_hides_joints_1_and_6(bench: Bench) -> None:
    blind = replace(
        bench,
        rig=replace(bench.rig, base_source="motion"),
        marker=replace(bench.marker, source="motion"),
    )
    made = scene.planned(blind, scene.wish(), scene.conditions())
    visible = made.prediction.judged.visibility
    assert visible.fraction[[0, 5]].tolist() == [0.0, 0.0]
    assert np.isnan(visible.detectable[[0, 5]]).all()
    assert np.isfinite(visible.detectable[1:5]).all()
    offsets, gains, backlash = made.prediction.shown
    assert np.isnan(offsets.standard_uncertainty[[0, 5]]).all()
    assert np.isfinite(backlash.standard_uncertainty).all()
    assert np.isfinite(gains.standard_uncertainty).all()


def test_an_error_of_a_given_clock_would_be_noticed(made: Plan) -> None:
    clock = made.prediction.clock
    assert (clock.source, clock.standard_uncertainty) == ("given", 0.0)
    assert clock.detectable is not None
    assert 1e-5 < clock.detectable < 1e-2


@pytest.mark.parametrize("name", ["offsets", "gains", "backlash", "eccentricity"])
def test_a_kind_s_column_is_what_such_a_fault_does(bench: Bench, made: Plan, name: str) -> None:
    """Readings with the fault in, set against the same poses: the whitened twist they add."""
    seen = made.prediction.foreseen
    columns = kind(name, seen.model).columns
    for j in (1, 4):
        size = 1e-4
        effects = [faulty(bench, seen, name, j, part, size) for part in range(len(columns))]
        for effect, column in zip(effects, columns, strict=True):
            np.testing.assert_allclose(
                effect / size, column[:, j], atol=2e-2 * np.abs(column[:, j]).max()
            )


def faulty(bench: Bench, seen: Foreseen, name: str, j: int, part: int, size: float) -> Array:
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


def test_offsets_alone_are_the_judgement_s_own(made: Plan) -> None:
    model = made.prediction.foreseen.model
    alone = shown(model, ("offsets",))[0]
    np.testing.assert_allclose(
        alone.detectable, made.prediction.judged.visibility.detectable, rtol=1e-9
    )
    fit = solve(np.concatenate([model.offsets, model.fitted], axis=1), model.xi, model.prior)
    np.testing.assert_allclose(
        alone.standard_uncertainty, np.sqrt(np.diag(fit.covariance)[:6]), rtol=1e-9
    )


@pytest.mark.parametrize(("skew", "line_time"), [(0.0, 0.0), (0.006, 0.0), (-0.003, 2e-5)])
def test_pictures_taken_one_after_the_other_give_the_same_poses(
    bench: Bench, made: Plan, skew: float, line_time: float
) -> None:
    """Each LED at its own instant: what alignment leaves lies within what it states."""
    rig = bench.rig
    rolling = replace(
        rig,
        left=replace(rig.left, line_time=line_time),
        right=replace(rig.right, line_time=line_time),
    )
    foretold = predict(
        replace(bench, rig=rolling), made.timed.q, made.prediction.foreseen.t, scene.wish(),
        replace(scene.conditions(), skew=skew), np.random.default_rng(0),
    )  # fmt: skip
    seen = foretold.foreseen
    assert len(seen.track) == len(seen.t)
    # readings alone are noisy here: a chi-squared with far fewer degrees of freedom than rows
    assert np.mean(seen.model.xi**2) < 1.2
    if skew:
        u, before = (one.judged.means.random for one in (foretold, made.prediction))
        assert (u > before).all()


def test_the_sources_make_up_the_uncertainty(made: Plan) -> None:
    foretold = made.prediction
    parts = sources(foretold.foreseen, foretold.judged)
    assert {part.name for part in parts} >= {RANDOM, "rig", "robot base", "LED body"}
    whole = sum(part.share**2 for part in parts)
    np.testing.assert_allclose(whole, np.diag(foretold.judged.means.covariance), rtol=1e-9)


def test_all_that_can_be_asked_for(bench: Bench) -> None:
    made = scene.planned(bench, scene.wish(observe=KINDS), scene.conditions())
    found = made.prediction.geometry
    assert found is not None
    assert found.support.candidates == 6 + 6 + 2 + 6 + 6  # offsets, α, Hayati's β, a, d
    assert {h.parameter.name for h in found.support.held if h.redundant} == {"d_2", "d_3"}
    assert [one.name for one in made.prediction.shown] == list(KINDS[:4])


def test_a_duration_is_filled_and_not_exceeded(bench: Bench) -> None:
    made = scene.planned(bench, scene.wish(poses=None, duration=40.0), scene.conditions())
    assert 25.0 < made.timed.duration <= 40.0
    assert max(stop.pose or 0 for stop in made.timed.stops) >= 4
