"""Which patches are one object: rays that meet, sizes that agree, and order."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.grasp.caps import BLUE, Cap, pairs, small_rig, still
from verify.core.records import StereoPair
from verify.grasping.tracking.camshift import Blob, find_blobs
from verify.grasping.tracking.colour import named_colour
from verify.grasping.tracking.kalman import begin_track
from verify.grasping.tracking.pairing import join_blobs, pair_blobs
from verify.grasping.tracking.target import TrackingOptions

RIG = small_rig()
STILL = begin_track(0.0, np.zeros(3), np.zeros((3, 3)), speed=0.0)


def blobs(*caps: Cap) -> tuple[StereoPair, list[Blob], list[Blob]]:
    pair = next(pairs(caps, RIG, 0.1))
    model = named_colour("blue")
    return pair, find_blobs(pair.left, model), find_blobs(pair.right, model)


@pytest.mark.parametrize(
    "places",
    [
        [[-0.12, 0.06, 0.62], [0.02, 0.02, 0.7], [0.1, -0.1, 0.9]],
        [[-0.05, 0.02, 0.7], [0.0, 0.02, 0.7], [0.05, 0.02, 0.7]],
    ],
    ids=["anywhere", "at one height"],
)
def test_every_object_is_found_where_it_is(places: list[list[float]]) -> None:
    pair, lefts, rights = blobs(*[Cap(BLUE, still(*p)) for p in places])
    for order in (rights, rights[::-1]):
        things = pair_blobs(lefts, order, pair, RIG, TrackingOptions())
        found = np.array(sorted((t.place.point for t in things), key=lambda p: float(p[0])))
        np.testing.assert_allclose(found, places, atol=0.003)


def test_patches_that_differ_in_place_or_size_or_are_no_target_are_no_object() -> None:
    pair, lefts, rights = blobs(Cap(BLUE, still(0.0, 0.02, 0.7)))
    lifted = replace(rights[0], centre=rights[0].centre - [0.0, 6.0])
    smaller = replace(rights[0], area=0.4 * rights[0].area)
    for right in (lifted, smaller):
        assert pair_blobs(lefts, [right], pair, RIG, TrackingOptions()) == []
    for options in (TrackingOptions(sizes=(0.008, 0.03)), TrackingOptions(depths=(0.15, 0.6))):
        assert pair_blobs(lefts, rights, pair, RIG, options) == []


def test_a_moving_object_is_placed_at_the_left_pictures_instant() -> None:
    velocity = np.array([0.8, 0.0, 0.0])
    pair, lefts, rights = blobs(Cap(BLUE, lambda t: (0.8 * t, 0.02, 0.7)))
    known = replace(STILL, mean=np.concatenate([np.zeros(3), velocity]))
    moving = join_blobs(lefts[0], rights[0], pair, RIG, known)
    taken_still = join_blobs(lefts[0], rights[0], pair, RIG, STILL)
    assert abs(moving.place.point[2] - 0.7) < 0.002
    assert abs(taken_still.place.point[2] - 0.7) > 0.01  # 3 mm of motion in the 4 ms between
    any_velocity = begin_track(0.0, np.zeros(3), np.zeros((3, 3)), speed=0.5)
    unknown = join_blobs(lefts[0], rights[0], pair, RIG, any_velocity)
    assert math.sqrt(unknown.place.covariance[2, 2]) > 0.5 * abs(unknown.place.point[2] - 0.7)


@pytest.mark.parametrize("place", [(0.0, 0.02, 0.7), (0.2, 0.1, 0.75), (-0.1, -0.1, 1.1)])
def test_both_pictures_agree_on_the_area_of_a_cap(place: tuple[float, float, float]) -> None:
    pair, lefts, rights = blobs(Cap(BLUE, still(*place)))
    thing = pair_blobs(lefts, rights, pair, RIG, TrackingOptions())[0]
    assert thing.areas[0] == pytest.approx(thing.areas[1], rel=0.2)
    assert thing.size[0] == pytest.approx(0.04, abs=2.5 * thing.size_uncertainty[0])
