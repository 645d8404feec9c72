"""Linear propagation against drawing the whole chain anew: where it holds, where it does not."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from tests.support.spotted import HOMES, SPREAD, Spotted, spotted
from verify.analysis.uncertainty.draws import (
    ViewDraws,
    camera_draws,
    led_draws,
    refit_pose,
    used_spots,
)
from verify.analysis.uncertainty.monte_carlo import MAX_RATIO_ERROR, monte_carlo
from verify.core.records import Array


def visits(arm: str, seed: int, count: int = 8) -> Array:
    q: Array = HOMES[arm] + SPREAD * np.random.default_rng(seed).uniform(-1, 1, (count, 6))
    return q


def at(arm: str, bent_deg: float) -> Array:
    """Visits, the last with joint 5 bent by so little: axes 4 and 6 of that arm line up."""
    q = visits(arm, 1)
    q[-1] = HOMES[arm]
    q[-1, 4] = np.deg2rad(bent_deg)
    return q


@pytest.fixture(scope="module")
def both() -> dict[str, Spotted]:
    return {arm: spotted(arm, visits(arm, 1), 2) for arm in HOMES}


@pytest.mark.parametrize("arm", list(HOMES))
def test_a_pose_fitted_in_no_drawn_world_is_the_chains_own(
    arm: str, both: dict[str, Spotted]
) -> None:
    made = both[arm]
    rig, marker = made.session.rig, made.session.marker
    for seen in made.measurements:
        spots = used_spots(seen, rig, marker)
        sides = [
            camera_draws(camera, name, {}, np.array([s.pan]))
            for camera, name, s in ((rig.left, "left", seen.left), (rig.right, "right", seen.right))
        ]
        views = ViewDraws(sides[0], sides[1], spots.left)
        leds = led_draws(marker, {}, 1)[:, spots.led]
        off = seen.pose.rig_T_flange.copy()
        off[:3, 3] += 1e-3  # it finds its way back
        found = refit_pose(off, leds, spots.seen[None], views, spots.gain)
        assert_allclose(found[0], seen.pose.rig_T_flange, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("arm", list(HOMES))
def test_where_linear_propagation_holds_the_draws_agree_within_5_percent(
    arm: str, both: dict[str, Spotted]
) -> None:
    """Not by the ratio that the check uses, but by the plain scatter of 4,000 other draws."""
    message = both[arm].check()
    many = both[arm].check(draws=4000, seed=9)
    holds = message.holds & ~message.coupled
    assert holds.mean() > 0.9
    away = np.abs(many.scatter / many.linear - 1)[holds]
    assert away.max() < MAX_RATIO_ERROR + 3 / np.sqrt(2 * 4000)


def test_next_to_a_singularity_linear_propagation_is_reported_to_fail() -> None:
    # so near that the doubt of joint 5 reaches the singularity
    made = spotted("iust_6r", at("iust_6r", -0.4), 3, larger=2.0)
    found = made.check()
    last = int(np.flatnonzero(found.pairs == 7)[0])
    assert not found.holds[last, [3, 5]].any()
    assert found.coupled[last, 5]
    many = made.check(draws=4000, seed=11)
    away = np.abs(many.scatter / many.linear - 1)[last]
    assert away[5] > MAX_RATIO_ERROR
    others = np.arange(len(found.pairs)) != last
    assert found.holds[others].mean() > 0.9


def test_an_arm_at_full_stretch_that_cannot_reach_what_is_drawn_is_named() -> None:
    q = visits("rv_3sd_melfa", 1)
    tried = np.tile(HOMES["rv_3sd_melfa"], (2000, 1))
    tried[:, 2] = np.linspace(*np.deg2rad([-60.0, 179.9]), 2000)
    places = robots.forward(robots.load("rv_3sd_melfa"), tried)[:, :3, 3]
    q[-1] = tried[int(np.argmax(np.linalg.norm(places, axis=1)))]
    found = spotted("rv_3sd_melfa", q, 5).check()
    assert 7 in found.pairs
    assert not found.holds[found.pairs == 7].all()


def test_without_a_wholly_known_pose_there_is_no_check(both: dict[str, Spotted]) -> None:
    made = both["iust_6r"]
    part = replace(
        made.comparison, determined=tuple(np.eye(6)[:, :5] for _ in range(len(made.comparison)))
    )
    assert monte_carlo(replace(made, comparison=part)) is None
