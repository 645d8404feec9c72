"""Constraints of a posture: the arm's links, the cameras' view, and refusals."""

from dataclasses import replace

import numpy as np
import pytest

import robots
from tests.support.planning import HOME_DEG, wish
from tests.support.scene import project
from verify.errors import InputError
from verify.planning.constraints import (
    MARGIN_PX,
    REASONS,
    SPACING,
    LinkChain,
    PostureConstraints,
    dexterity,
    visible_leds,
)
from verify.planning.request import PlanningSetup, PlanRequest
from verify.planning.roadmap import build_roadmap, clear_legs

HOME = np.deg2rad(HOME_DEG)


@pytest.mark.parametrize("name", ["iust_6r", "rv_3sd_melfa", "ur10", "panda"])
def test_the_skeleton_is_the_arm(name: str) -> None:
    """Against robots' own kinematics, pinocchio's for a URDF."""
    arm = robots.load(name)
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper, (30, arm.dof))
    links = LinkChain(arm)
    frames = robots.link_frames(arm, q)
    moves = robots.jacobian(arm, q).copy()
    moves[:, :3] /= robots.coupling.LENGTH_SCALE
    least = np.linalg.svd(moves, compute_uv=False)[:, -1]
    np.testing.assert_allclose(dexterity(frames), least, atol=1e-12)
    points = links.points(frames)
    assert np.linalg.norm(np.diff(points, axis=1), axis=2).max() < SPACING * 1.0001
    still = links.points(robots.link_frames(arm, q * 0))[0]
    assert np.ptp(points[:, ~links.moving], axis=0).max(initial=0.0) < 1e-9
    assert len(links.way) == len(still)


def test_leds_are_where_opencv_projects_them(bench: PlanningSetup) -> None:
    q = HOME + np.deg2rad(8) * np.random.default_rng(1).uniform(-1, 1, (20, 6))
    poses = robots.forward(bench.arm, q)
    seen = visible_leds(bench, poses, MARGIN_PX, np.deg2rad(60))
    for camera, view in zip((bench.rig.left, bench.rig.right), seen, strict=True):
        for pose, pixels in zip(bench.rig.rig_T_base @ poses, view.pixels, strict=True):
            points = bench.marker.leds @ pose[:3, :3].T + pose[:3, 3]
            np.testing.assert_allclose(pixels, project(camera, camera.pan, points), atol=1e-6)
        height, width = bench.rig.image_size[1], bench.rig.image_size[0]
        rim = np.stack(
            [view.pixels[..., 0], width - 1 - view.pixels[..., 0], view.pixels[..., 1],
             height - 1 - view.pixels[..., 1]]
        ).min(axis=0)  # fmt: skip
        np.testing.assert_array_equal(view.inside, rim > MARGIN_PX)


def test_leds_behind_the_flange_are_invisible(bench: PlanningSetup) -> None:
    pose = robots.forward(bench.arm, HOME[None])
    facing = visible_leds(bench, pose, 0.0, np.deg2rad(60))
    turned = pose.copy()
    turned[:, :3, 1:3] *= -1  # half a turn about the flange's x
    hidden = visible_leds(bench, turned, 0.0, np.deg2rad(60))
    assert all(view.facing.all() for view in facing)
    assert not any(view.facing.any() for view in hidden)
    assert all(view.facing.all() for view in visible_leds(bench, turned, 0.0, np.pi))


def test_touching_images_are_reported(bench: PlanningSetup) -> None:
    leds = bench.marker.leds.copy()
    leds[1] = leds[0] + [0.004, 0.0, 0.0]
    close = replace(bench, marker=replace(bench.marker, leds=leds))
    seen = visible_leds(close, robots.forward(bench.arm, HOME[None]), 0.0, np.pi)
    for view in seen:
        assert view.apart.tolist() == [[False, False, True]]


@pytest.mark.parametrize("reason", REASONS[3:6])
def test_no_led_goes_below_the_floor_or_near_to_camera_or_arm(
    reason: str, bench: PlanningSetup
) -> None:
    q = build_roadmap(PostureConstraints(bench, wish()), np.random.default_rng(0)).q[:1]
    frames, rig = robots.link_frames(bench.arm, q)[0], bench.rig
    camera = np.linalg.inv(rig.rig_T_base) @ rig.left.rig_T_camera(rig.left.pan)[:, 3]
    there = dict(zip(REASONS[3:6], ([0.4, 0.0, -0.01], camera[:3], frames[1, :3, 3]), strict=True))
    arm_T_led = np.linalg.inv(frames[-1]) @ [*there[reason], 1.0]
    marker = replace(
        bench.marker,
        names=(*bench.marker.names, "far"),
        colours=(*bench.marker.colours, "white"),
        leds=np.vstack([bench.marker.leds, arm_T_led[:3]]),
    )
    assert PostureConstraints(bench, wish()).reason(q).tolist() == [-1]
    found = PostureConstraints(replace(bench, marker=marker), wish()).reason(q)
    assert [REASONS[k] for k in found] == [reason]


def test_every_posture_and_leg_of_the_roadmap_keeps_everything(bench: PlanningSetup) -> None:
    constraints = PostureConstraints(bench, wish())
    known = build_roadmap(constraints, np.random.default_rng(0))
    assert constraints.good(known.q).all()
    assert np.all(np.abs(known.q - HOME) <= np.deg2rad(35) + 1e-9)
    assert np.isfinite(known.time).all()
    for row in known.q[:50]:
        assert robots.coupled(bench.arm, row) is None
    way = [0, *known.path(0, len(known.q) - 1)]
    assert way[-1] == len(known.q) - 1
    legs = known.q[way]
    assert clear_legs(constraints, legs[:-1], legs[1:]).all()
    total = np.abs(np.diff(legs, axis=0)).max(axis=1).sum()
    assert total == pytest.approx(known.time[0, -1])


@pytest.mark.parametrize(
    ("changed", "message", "remedy"),
    [
        ({"view_angle": 0.02}, REASONS[1], "--view-angle-deg"),
        ({"floor": 3.0}, REASONS[3], "--floor-mm"),
    ],
)
def test_an_impossible_plan_is_refused_with_counts(
    changed: dict[str, float], message: str, remedy: str, bench: PlanningSetup
) -> None:
    constraints = PostureConstraints(bench, wish(**changed))
    with pytest.raises(InputError) as problem:
        build_roadmap(constraints, np.random.default_rng(0))
    assert f" by {message}" in problem.value.found
    assert remedy in problem.value.remedy
    assert "none of 40,000 postures of iust_6r" in problem.value.found


def test_a_rig_that_points_elsewhere_is_refused(bench: PlanningSetup) -> None:
    away = bench.rig.rig_T_base.copy()
    away[0, 3] += 5.0
    elsewhere = replace(bench, rig=replace(bench.rig, rig_T_base=away))
    with pytest.raises(InputError, match="40,000 by fewer than 3 LEDs inside both pictures"):
        build_roadmap(PostureConstraints(elsewhere, PlanRequest()), np.random.default_rng(0))
