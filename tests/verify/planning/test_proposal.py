"""Rigs that do not exist yet: where they stand, what they state, and whether worlds agree."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import robots
from tests.support.proposed import measured_means, proposal
from verify.core.records import Array
from verify.errors import InputError
from verify.measurement.systematics import stated_systematics
from verify.planning.plan import SessionPlan
from verify.planning.prediction import (
    conform_limits,
    group_sources,
    joint_levers,
    uncertainty_sources,
)
from verify.planning.proposal import ProposedRig, build_setup, work_posture

ARMS = ("iust_6r", "rv_3sd")
WORLDS = 12
P_CHANCE = 0.0005
RIGS = {
    "6R, 1.5 m": ("iust_6r", ProposedRig(distance=1.5)),
    "RV-3SD, narrow, 5 LEDs": (
        "rv_3sd",
        ProposedRig(distance=0.8, baseline=0.2, field_of_view=np.deg2rad(45.0), leds=5),
    ),
    "6R, 640x480": (
        "iust_6r",
        ProposedRig(image_size=(640, 480), baseline=0.3, led_circle=0.16),
    ),
}


@pytest.mark.slow
def test_errors_in_simulated_worlds_scatter_as_predicted() -> None:
    """The simulator's own rig, draws and projection, against the prediction's covariance.

    Means of a sound arm are errors of the measurement. Pooled, a U that is 16 % off fails.
    """
    pooled, count = 0.0, 0
    for name, (robot, rig) in RIGS.items():
        one = proposal(robot, rig)
        errors = np.array([measured_means(one, seed) for seed in range(WORLDS)])
        covariance = one.made.prediction.analysis.resolved.mean_covariance
        squared = float(np.einsum("ni,ij,nj->", errors, np.linalg.inv(covariance), errors))
        assert P_CHANCE < chi2.cdf(squared, errors.size) < 1 - P_CHANCE, name
        pooled, count = pooled + squared, count + errors.size
    assert P_CHANCE < chi2.cdf(pooled, count) < 1 - P_CHANCE


@pytest.mark.parametrize("robot", ARMS)
def test_both_axes_meet_in_the_leds_before_the_work(robot: str) -> None:
    arm, rig = robots.load(robot), ProposedRig(baseline=0.5, distance=1.2)
    work = work_posture(arm, 0.0)
    setup = build_setup(arm, rig, work, 0.0)
    flange = setup.rig.rig_T_base @ robots.forward(arm, work[None])[0]
    leds = setup.marker.leds @ flange[:3, :3].T + flange[:3, 3]
    middle = leds.mean(axis=0)
    np.testing.assert_allclose(middle, [0.0, 0.0, 1.2], atol=1e-9)
    for camera, x in ((setup.rig.left, -0.25), (setup.rig.right, 0.25)):
        placed = camera.rig_T_camera(camera.pan)
        np.testing.assert_allclose(placed[:3, 3], [x, 0.0, 0.0], atol=1e-12)
        along = middle - placed[:3, 3]
        np.testing.assert_allclose(placed[:3, 2], along / np.linalg.norm(along), atol=1e-9)
        image = camera.project(middle @ placed[:3, :3] - placed[:3, 3] @ placed[:3, :3])
        np.testing.assert_allclose(image, [639.5, 359.5], atol=1e-6)
        assert np.rad2deg(np.arctan(640 / camera.matrix[0, 0])) == pytest.approx(30.0)


def test_an_uncertainty_of_nothing_is_taken_as_exact() -> None:
    arm = robots.load("iust_6r")
    work = work_posture(arm, 0.0)
    exact = dict.fromkeys(ProposedRig().uncertainties, 0.0)
    setup = build_setup(arm, ProposedRig(uncertainties=exact), work, 0.0)
    stated = stated_systematics(setup.rig, setup.marker, turning=False)
    assert not stated.names
    assert set(stated.uncounted) >= {"rig", "robot base", "LED body", "LED positions"}
    usual = build_setup(arm, ProposedRig(), work, 0.0)
    stated = stated_systematics(usual.rig, usual.marker, turning=False)
    assert stated.uncounted == ("robot table",)


def test_a_flange_that_looks_down_leaves_no_place_for_cameras() -> None:
    arm = robots.load("rv_3sd")
    rng = np.random.default_rng(3)
    q = rng.uniform(arm.lower, arm.upper, (500, arm.dof))
    ahead = robots.forward(arm, q)[:, :3, 2]
    down = q[int(np.argmin(ahead[:, 2]))]
    with pytest.raises(InputError, match="the flange looks down"):
        build_setup(arm, ProposedRig(distance=3.0), down, 0.0)


def test_groups_make_up_the_mean_s_uncertainty(made: SessionPlan) -> None:
    foretold = made.prediction
    groups = group_sources(uncertainty_sources(foretold.analysis))
    whole = sum(u**2 for u in groups.values())
    np.testing.assert_allclose(
        whole, np.diag(foretold.analysis.resolved.mean_covariance), rtol=1e-9
    )


def test_a_lever_is_what_a_small_turn_moves(made: SessionPlan) -> None:
    session = made.prediction.session
    arm, step = robots.load("iust_6r"), 1e-6
    q = session.comparison.q

    def place(at: Array) -> Array:
        return np.asarray(robots.forward(arm, at)[:, :3, 3])

    for j, lever in enumerate(joint_levers(session)):
        moved = q.copy()
        moved[:, j] += step
        way = np.linalg.norm(place(moved) - place(q), axis=1).max() / step
        assert lever == pytest.approx(way, abs=1e-4)


def test_what_conforms_leaves_the_guard_band(made: SessionPlan) -> None:
    """No error conforms whose largest uncertainty takes up the tolerance."""
    foretold = made.prediction
    largest = foretold.analysis.resolved.uncertainty.max(axis=0)
    wide = np.maximum(foretold.analysis.visibility.detectable, 3 * largest)
    np.testing.assert_allclose(conform_limits(foretold.analysis, wide), wide - 1.645 * largest)
    assert np.isnan(conform_limits(foretold.analysis, largest)).all()
    unseen = replace(
        foretold.analysis,
        visibility=replace(foretold.analysis.visibility, detectable=2 * wide),
    )
    assert np.isnan(conform_limits(unseen, wide)).all()
