from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.support.scene import make_rig, project
from verify.core.records import Array, Sighting
from verify.core.rig import Camera
from verify.measurement.alignment import RawSightings, align, spot_instants

RIG = make_rig()
CAMERA = RIG.left
SIGMA = 0.02  # px


def raw(
    centre: Array, t: float, leds: list[int] | None = None, pan: float = 0.0, depth: float = 0.6
) -> RawSightings:
    """Spots of the left picture, and the same again of the right one."""
    m, own = len(centre), leds or list(range(len(centre)))
    return RawSightings(
        led=np.array(own * 2),
        centre=np.concatenate([centre, centre]),
        covariance=np.tile(SIGMA**2 * np.eye(2), (2 * m, 1, 1)),
        peak=np.full(2 * m, 180.0),
        taken=np.full(2 * m, t),
        depth=np.full(2 * m, depth),
        width=np.full(2 * m, 4.0),
        merged=np.zeros(2 * m, np.bool_),
        left=m,
        instants=(t, t),
        pans=(pan, pan),
    )


def carried(
    now: RawSightings, *neighbours: RawSightings, t: float = 1.0, alone: bool = False
) -> Sighting:
    """Align both pictures; the left one's."""
    late = [n for n in neighbours if n.taken[0] > now.taken[0]]
    early = [n for n in neighbours if n.taken[0] < now.taken[0]]
    around = [*early[:1], *[None] * (not early), *late, *[None] * (not late), *early[1:]]
    aligned = align(now, [*around, None][:3], t, RIG, alone=alone)
    assert aligned is not None
    left, right = aligned.sides
    if now.pans == (0.0, 0.0):
        assert_allclose(right.centre, left.centre, atol=1e-9)
    return left


START = np.array([[600.0, 300.0], [700.0, 420.0], [500.0, 350.0]])
SPEED = np.array([[120.0, -40.0], [110.0, -30.0], [130.0, -45.0]])  # px/s


@pytest.mark.parametrize("interval", [-0.067, 0.067], ids=["pair before", "pair after"])
def test_a_steady_motion_is_carried_to_the_common_instant_exactly(interval: float) -> None:
    now, neighbour = raw(START, 1.004), raw(START + SPEED * interval, 1.004 + interval)
    aligned = carried(now, neighbour)
    assert_allclose(aligned.centre, START - SPEED * 0.004, atol=1e-9)
    assert_allclose(aligned.velocity, SPEED, rtol=1e-9)
    assert aligned.t == pytest.approx(1.0)


@pytest.mark.parametrize("neighbour", [0.937, 1.071])
def test_an_acceleration_costs_its_lever(neighbour: float) -> None:
    acceleration = np.array([800.0, 300.0])  # px/s²

    def at(t: float) -> Array:
        return START + SPEED * (t - 1.0) + acceleration * (t - 1.0) ** 2 / 2

    aligned = carried(raw(at(1.004), 1.004), raw(at(neighbour), neighbour))
    assert_allclose(aligned.centre - at(1.0), aligned.lever[:, :1] * acceleration, rtol=1e-9)


def test_both_neighbours_know_the_acceleration_and_a_jerk_costs_its_lever() -> None:
    acceleration, jerk = np.array([800.0, 300.0]), np.array([-4000.0, 9000.0])  # px/s², px/s³

    def at(t: float) -> Array:
        s = t - 1.0
        return START + SPEED * s + acceleration * s**2 / 2 + jerk * s**3 / 6

    aligned = carried(*(raw(at(t), t) for t in (1.004, 0.94, 1.068)))
    assert_allclose(aligned.lever[:, [0, 2]], 0)
    assert_allclose(aligned.centre - at(1.0), aligned.lever[:, 1:2] * jerk, rtol=1e-6)
    # so do the two pairs before, where there is none after: the last pair, before a gap
    last = carried(*(raw(at(t), t) for t in (1.004, 0.94, 0.87)))
    assert_allclose(last.lever[:, [0, 2]], 0)
    assert_allclose(last.centre - at(1.0), last.lever[:, 1:2] * jerk, rtol=1e-6)
    # the pair before the one before shows the jerk as well
    cubic = carried(*(raw(at(t), t) for t in (1.004, 0.94, 1.068, 0.87)))
    assert_allclose(cubic.centre, np.broadcast_to(at(1.0), START.shape), atol=1e-9)
    assert_allclose(cubic.lever[:, :2], 0)
    lever = 0.004 * 0.06 * 0.068 * 0.13 / 24
    assert_allclose(np.abs(cubic.lever[:, 2]), lever, rtol=1e-9)
    # the velocity is that of the pair's instant
    assert_allclose(aligned.velocity, SPEED, atol=0.064 * 0.068 * np.abs(jerk).max() / 6)


@pytest.mark.parametrize("both", [False, True], ids=["line", "parabola"])
def test_the_covariance_is_that_of_the_curve_through_noisy_sightings(both: bool) -> None:
    rng = np.random.default_rng(3)
    centres = []
    for _ in range(4000):
        noise = rng.normal(0, SIGMA, (3, *START.shape))
        now = raw(START + noise[0], 1.02)
        before = raw(START - SPEED * 0.067 + noise[1], 0.953)
        after = raw(START + SPEED * 0.067 + noise[2], 1.087)
        aligned = carried(now, before, after) if both else carried(now, before)
        centres.append(aligned.centre)
    assert_allclose(np.std(centres, axis=0), np.sqrt(aligned.covariance[0, 0, 0]), rtol=0.05)


def test_an_led_that_the_neighbour_did_not_see_moves_like_the_others_with_their_spread() -> None:
    before = raw((START - SPEED * 0.083)[:2], 0.937, leds=[0, 1])
    aligned = carried(raw(START, 1.02), before)
    assert_allclose(aligned.velocity[2], SPEED[:2].mean(axis=0), rtol=1e-9)
    assert np.trace(aligned.covariance[2]) > np.trace(aligned.covariance[0])


def test_a_base_that_turned_between_the_pairs_is_not_taken_for_a_motion_of_the_arm() -> None:
    points = np.array([[0.05, 0.02, 0.6], [-0.1, 0.04, 0.62], [0.0, -0.05, 0.58]])
    turned = CAMERA.pan + np.deg2rad(2.0)
    now = raw(project(CAMERA, turned, points), 1.02, pan=turned)
    inverse = np.linalg.inv(CAMERA.rig_T_camera(CAMERA.pan))
    depth = points @ inverse[2, :3] + inverse[2, 3]
    before = raw(project(CAMERA, CAMERA.pan, points), 0.953, pan=CAMERA.pan)
    before = replace(before, depth=np.tile(depth, 2))
    assert_allclose(carried(now, before).velocity, 0, atol=1e-6)


def test_with_a_rolling_shutter_each_spot_has_the_instant_of_its_row() -> None:
    camera: Camera = replace(CAMERA, line_time=2e-5)
    instants = spot_instants(1.0, START, camera, 720)
    assert_allclose(instants, 1.0 + (START[:, 1] - 359.5) * 2e-5)
    taken = np.tile(instants, 2)
    now = replace(raw(START, 1.0), taken=taken)
    before = replace(raw(START - SPEED * 0.067, 0.933), taken=taken - 0.067)
    aligned = carried(now, before)
    assert_allclose(aligned.centre, START - SPEED * (instants - 1.0)[:, None], atol=1e-9)


def test_spots_that_have_to_be_moved_need_a_neighbour_that_shows_one_of_them() -> None:
    now, other = raw(START, 1.02), raw(START, 0.953, leds=[3, 4, 5])
    for before in (None, other):
        assert align(now, [before, None, None], 1.0, RIG) is None
        there = align(now, [before, None, None], 1.02, RIG)
        assert there is not None
        assert_array_equal(there.centre, now.centre)
        assert_array_equal(there.covariance, now.covariance)
        assert not there.velocity.any()
        assert not there.lever.any()
    # each picture by itself: the right one is not moved by what the left one shows
    halved = replace(raw(START, 0.953), led=np.array([0, 1, 2, 3, 4, 5]))
    assert align(now, [halved, None, None], 1.0, RIG) is None


def test_a_picture_without_leds_is_aligned() -> None:
    def left_alone(one: RawSightings) -> RawSightings:
        return one.take(np.arange(6) < 3)

    before = left_alone(raw(START - SPEED * 0.067, 0.953))
    aligned = align(left_alone(raw(START, 1.02)), [before, None, None], 1.0, RIG)
    assert aligned is not None
    left, right = aligned.sides
    assert_allclose(left.centre, START - SPEED * 0.02, atol=1e-9)
    assert (len(left), len(right)) == (3, 0)
