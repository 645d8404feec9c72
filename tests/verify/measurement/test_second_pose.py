"""Two LEDs in both images and one in the left alone: two poses explain them, one is true."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from robots.transforms import difference
from tests.support.scene import facing, make_marker, make_rig, project, sight
from verify.core.records import Array
from verify.measurement.pose import fit_pose, fit_stack, second_start, stack_sightings

SIGMA = 0.05  # px
SEEN = [0, 1, 2], [0, 1]
RIG, MARKER = make_rig(), make_marker(3)


def turned_about(pose: Array, point: Array, turn: Rotation) -> Array:
    moved = pose.copy()
    moved[:3, :3] = turn.as_matrix() @ pose[:3, :3]
    moved[:3, 3] = point + turn.as_matrix() @ (pose[:3, 3] - point)
    return moved


def edge_on(rng: np.random.Generator, off: float = 0.0) -> Array:
    """A flange whose third LED turns about the line through the others in a plane that holds the
    left camera's optical centre, but for an angle `off`, rad."""
    pose = facing(*rng.uniform([-0.05, -0.05, 0.5], [0.05, 0.05, 0.7]))
    pose = turned_about(pose, pose[:3, 3], Rotation.from_rotvec(rng.normal(0, 0.2, 3)))
    first, second, third = MARKER.leds @ pose[:3, :3].T + pose[:3, 3]
    line = (second - first) / np.linalg.norm(second - first)
    foot = first + line * (line @ (third - first))
    sight_line = RIG.left.rig_T_camera(RIG.left.pan)[:3, 3] - foot
    sight_line /= np.linalg.norm(sight_line)
    wanted = line - sight_line * (line @ sight_line)
    axis = np.cross(line, wanted)
    angle = np.arctan2(np.linalg.norm(axis), line @ wanted) + off
    return turned_about(pose, foot, Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle))


def other_start(pose: Array) -> Array:
    views = stack_sightings(*sight(RIG, MARKER, pose, SIGMA, leds=SEEN), RIG, MARKER.leds)
    found = second_start(pose, SEEN, MARKER.leds, views.cameras)
    assert found is not None
    return found


def turn_between(pose: Array, other: Array) -> float:
    return float(np.linalg.norm(difference(pose, other)[3:]))


def test_the_second_pose_shows_the_same_pixels_where_the_circle_is_seen_edge_on() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        pose = edge_on(rng)
        other = other_start(pose)
        for camera, leds in zip((RIG.left, RIG.right), SEEN, strict=True):
            pixels = [
                project(camera, camera.pan, MARKER.leds[leds] @ p[:3, :3].T + p[:3, 3])
                for p in (pose, other)
            ]
            assert_allclose(*pixels, atol=1e-6)
        assert_allclose(other_start(other), pose, atol=1e-9)


def test_only_two_leds_in_both_images_and_more_in_one_have_a_second_pose() -> None:
    views = stack_sightings(*sight(RIG, MARKER, facing(), SIGMA), RIG, MARKER.leds)
    for seen in (([0, 1, 2], [0, 1, 2]), ([0, 1], [0, 1]), ([0, 1, 2], [0]), ([0, 1, 2], [])):
        assert second_start(facing(), seen, MARKER.leds, views.cameras) is None


def test_the_pose_that_explains_the_spots_better_is_found_from_the_other_one() -> None:
    """Seen 5° from its edge the circle is wide enough for 0.05 px."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        truth = edge_on(rng, np.deg2rad(5.0))
        start = other_start(truth)
        pose = fit_pose(*sight(RIG, MARKER, truth, SIGMA, rng, leds=SEEN), RIG, MARKER, start)
        off = difference(pose.rig_T_flange, truth)
        assert off @ np.linalg.solve(pose.covariance, off) < 30  # chi², six degrees of freedom


def test_a_choice_that_stays_open_widens_the_covariance() -> None:
    rng, inside = np.random.default_rng(6), []
    for _ in range(150):
        truth = edge_on(rng, rng.normal(0, np.deg2rad(0.2)))
        start = truth if rng.random() < 0.5 else other_start(truth)
        pose = fit_pose(*sight(RIG, MARKER, truth, SIGMA, rng, leds=SEEN), RIG, MARKER, start)
        off = difference(pose.rig_T_flange, truth)[3:]
        inside.append(np.abs(off) <= 1.96 * np.sqrt(np.diag(pose.covariance)[3:]))
    assert np.mean(inside) > 0.93


@pytest.mark.parametrize("doubt", [0.01, 10.0])
def test_what_is_expected_settles_the_choice_if_it_is_sure_enough(doubt: float) -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        truth = edge_on(rng)
        other = other_start(truth)
        apart = turn_between(other, truth)
        views = stack_sightings(*sight(RIG, MARKER, truth, SIGMA, rng, leds=SEEN), RIG, MARKER.leds)
        pose = fit_stack(views, RIG, MARKER, other, expected=(truth, doubt))
        widest = np.sqrt(np.linalg.eigvalsh(pose.covariance[3:, 3:]).max())
        if apart < 0.1:
            continue
        if doubt < 1:
            assert turn_between(pose.rig_T_flange, truth) < 5 * widest
            assert widest < 0.1 * apart
        else:  # a share of 0.025 at least
            assert widest > 0.15 * apart
