"""Truth: cv2.projectPoints of LEDs whose names the test knows, amid clutter it threw in."""

import time
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tests.support.leds.scene import (
    BLUE,
    EQUILATERAL,
    GREEN,
    GREY,
    PANS,
    RED,
    ROW,
    SIZE,
    TWO,
    Scene,
    hide,
    make_marker,
    make_scene,
    make_spots,
    moved,
    near,
    random_leds,
)
from tests.support.scene import project
from verify.core.records import Array, StereoPair
from verify.measurement.correspondence.assign import PosePrediction, TrackedLeds, track_leds

SEES = 0.005  # m, the least difference between two triangles of LEDs that counts as asymmetric


@pytest.mark.slow
def test_every_asymmetric_marker_with_three_leds_in_both_images_is_identified() -> None:
    for trial in range(240):
        rng = np.random.default_rng(trial)
        count = 3 + trial % 3
        scene = make_scene(
            rng,
            random_leds(rng, count, SEES),
            clutter=int(rng.integers(0, 11)),
            lamps=int(rng.integers(0, 4)),
            skew_px=rng.uniform(0, 2),
            missing=hide(rng, count),
        )
        found = scene.identify()
        assert (scene.outcome(found), found.choice) == ("complete", "geometry")
        off = np.linalg.inv(scene.rig_T_flange) @ found.rig_T_flange
        assert np.linalg.norm(off[:3, 3]) < 0.015  # coarse: 2 px of skew are 4-10 mm of depth
        assert Rotation.from_matrix(off[:3, :3]).magnitude() < 0.1


def test_a_marker_of_any_shape_is_never_identified_wrongly() -> None:
    outcomes: Counter[str] = Counter()
    for trial in range(120):
        rng = np.random.default_rng(10_000 + trial)
        leds = random_leds(rng, 3 + trial % 4)
        scene = make_scene(rng, leds, clutter=20, lamps=2, skew_px=rng.uniform(0, 2))
        outcomes[scene.outcome(scene.identify())] += 1
    assert outcomes["wrong"] == 0
    assert outcomes["complete"] >= 110  # the others are nearly symmetric, and say so


def test_an_led_in_one_camera_is_listed_for_that_camera() -> None:
    rng = np.random.default_rng(5)
    scene = make_scene(rng, random_leds(rng, 5, SEES), clutter=5, missing=((1,), (3,)))
    found = scene.identify()
    assert scene.outcome(found) == "complete"
    assert_array_equal(found.left_led, [0, 2, 3, 4])
    assert_array_equal(found.right_led, [0, 1, 2, 4])


SQUARE = 0.05 * np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
ISOSCELES = np.array([[0.06, 0, 0.01], [-0.02, 0.03, 0.01], [-0.02, -0.03, 0.01]])
EVEN_ROW = np.array([[-0.05, 0, 0], [0, 0, 0], [0.05, 0, 0]])
SYMMETRIC = {
    "two": TWO,
    "isosceles": ISOSCELES,
    "even row": EVEN_ROW,
    "equilateral": EQUILATERAL,
    "square": SQUARE,
}


@pytest.mark.parametrize("shape", SYMMETRIC)
@pytest.mark.parametrize("seed", range(8))
def test_a_symmetric_marker_is_ambiguous_until_the_past_or_the_encoders_choose(
    shape: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    scene = make_scene(rng, SYMMETRIC[shape], skew_px=1.0)
    found = scene.identify()
    assert found.status == "ambiguous_leds"
    assert len(found.left_led) == len(found.right_led) == 0
    assert found.rig_T_flange is None

    past = PosePrediction(near(scene.rig_T_flange, rng, 0.008, 0.08), 0.01, 0.1)
    found = scene.identify(prediction=past)
    assert scene.outcome(found) == "complete"
    assert found.choice == "continuity"

    found = scene.identify(expected=(near(scene.rig_T_flange, rng, 0.06, 0.1),))
    assert scene.outcome(found) == "complete"
    assert found.choice == "encoders"


def test_the_encoders_choose_and_leave_no_trace_in_the_pose() -> None:
    rng = np.random.default_rng(3)
    scene = make_scene(rng, EQUILATERAL)
    poses = []
    for _ in range(2):
        found = scene.identify(expected=(near(scene.rig_T_flange, rng, 0.05, 0.1),))
        assert found.rig_T_flange is not None
        poses.append(found.rig_T_flange)
    assert_array_equal(poses[0], poses[1])


def test_encoders_that_fit_no_candidate_choose_none() -> None:
    scene = make_scene(np.random.default_rng(3), TWO)
    far = moved(scene.rig_T_flange, np.array([0.6, 0, 0]), np.zeros(3))
    assert scene.identify(expected=(far,)).status == "ambiguous_leds"
    across = scene.rig_T_flange.copy()
    across[:3, :3] = across[:3, :3] @ Rotation.from_euler("z", 90, degrees=True).as_matrix()
    assert scene.identify(expected=(across,)).status == "ambiguous_leds"


def test_encoders_as_near_to_one_candidate_as_to_another_choose_none() -> None:
    rng = np.random.default_rng(2)
    scene = make_scene(rng, np.zeros((1, 3)), lamps=1, missing=((0,), (0,)))
    lamps = scene.rig_T_flange[:3, 3] + [[0.03, 0, 0], [-0.03, 0, 0]]
    scene.spots = (
        make_spots(project(scene.rig.left, PANS[0], lamps), np.full((2, 3), GREY)),
        make_spots(project(scene.rig.right, PANS[1], lamps), np.full((2, 3), GREY)),
    )
    assert scene.identify(expected=(scene.rig_T_flange,)).status == "ambiguous_leds"


@pytest.mark.parametrize("seed", range(8))
def test_two_of_four_leds_are_found_with_the_past_or_the_encoders(seed: int) -> None:
    rng = np.random.default_rng(seed)
    leds = random_leds(rng, 4, SEES)
    lost = tuple(int(led) for led in rng.permutation(4)[:2])
    scene = make_scene(rng, leds, clutter=5, missing=(lost, lost))
    assert scene.outcome(scene.identify()) in ("ambiguous_leds", "too_few_leds")
    found = scene.identify(expected=(near(scene.rig_T_flange, rng, 0.03, 0.1),))
    assert scene.outcome(found) in ("complete", "ambiguous_leds")
    in_one_image = make_scene(rng, leds, clutter=5, missing=((3,), (2,)))  # two more LEDs
    for each in (scene, in_one_image):
        past = PosePrediction(near(each.rig_T_flange, rng, 0.004, 0.04), 0.005, 0.05)
        assert each.outcome(each.identify(prediction=past)) == "complete"


@pytest.mark.parametrize("seed", range(10))
def test_a_single_led_is_the_one_pair_of_spots_or_where_it_was_expected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    led = np.array([[0.03, 0, 0.02]])
    scene = make_scene(rng, led, clutter=1)
    found = scene.identify()
    assert scene.outcome(found) == "complete"
    assert found.choice == "geometry"
    scene = make_scene(rng, led, lamps=6)
    assert scene.identify().status == "ambiguous_leds"
    past = PosePrediction(near(scene.rig_T_flange, rng, 0.008, 0.1), 0.01, 0.1)
    found = scene.identify(prediction=past)
    assert scene.outcome(found) == "complete"
    assert found.choice == "continuity"
    expected = near(scene.rig_T_flange, rng, 0.02, 0.1)
    assert scene.outcome(scene.identify(expected=(expected,))) in ("complete", "ambiguous_leds")


WHITE = (210.0, 205.0, 190.0)


def test_colours_settle_what_geometry_leaves_open() -> None:
    rng = np.random.default_rng(1)
    names = ("red", "green", "blue")
    scene = make_scene(rng, EQUILATERAL, colours=(RED, GREEN, BLUE), names=names, clutter=3)
    found = scene.identify()
    assert scene.outcome(found) == "complete"
    assert found.choice == "colour"
    two = make_scene(rng, TWO, colours=(WHITE, RED), names=("white", "red"))
    assert two.outcome(two.identify()) == "complete"
    some = make_scene(
        rng, SQUARE, colours=(RED, WHITE, WHITE, WHITE), names=("red", *["white"] * 3)
    )
    found = some.identify()
    assert found.status == "ambiguous_leds"  # the flip about red stays


def test_grey_images_have_no_colours_and_infrared_leds_appear_violet_or_white() -> None:
    rng = np.random.default_rng(1)
    scene = make_scene(rng, EQUILATERAL, names=("red", "green", "blue"))
    found = scene.identify()
    assert found.status == "ambiguous_leds"
    violet = (220.0, 120.0, 200.0)
    leds = random_leds(rng, 3, SEES)
    scene = make_scene(rng, leds, colours=(violet, WHITE, violet), names=("infrared",) * 3)
    assert scene.outcome(scene.identify()) == "complete"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lamps", "clutter", "hint", "wrong"),
    [(0, 10, "", 0.01), (10, 0, "", 0.01), (10, 0, "encoders", 0.02), (10, 0, "prediction", 0.02)],
    ids=["random spots", "lamps", "lamps and encoders", "lamps and prediction"],
)
def test_clutter_is_seldom_taken_for_leds(
    lamps: int, clutter: int, hint: str, wrong: float
) -> None:
    outcomes: Counter[str] = Counter()
    for trial in range(120):
        rng = np.random.default_rng(trial)
        leds, none = random_leds(rng, 4), tuple(range(4))
        scene = make_scene(rng, leds, lamps=lamps, clutter=clutter, missing=(none, none))
        past = PosePrediction(scene.rig_T_flange, 0.005, 0.05) if hint == "prediction" else None
        expected = (scene.rig_T_flange,) if hint == "encoders" else ()
        outcomes[scene.outcome(scene.identify(past, expected=expected))] += 1
    refused = outcomes["too_few_leds"] + outcomes["ambiguous_leds"]
    assert refused >= (1 - wrong) * 120


def test_one_led_of_several_is_taken_only_where_the_past_expects_it() -> None:
    rng = np.random.default_rng(9)
    scene = make_scene(rng, random_leds(rng, 4, SEES), missing=((0, 1, 3), (0, 1, 3)))
    assert scene.identify().status == "too_few_leds"
    assert scene.identify(expected=(scene.rig_T_flange,)).status == "too_few_leds"
    found = scene.identify(PosePrediction(near(scene.rig_T_flange, rng, 0.004, 0.04), 0.005, 0.05))
    assert scene.outcome(found) == "complete"
    assert found.choice == "continuity"
    far = PosePrediction(near(scene.rig_T_flange, rng, 0.3, 0.04), 0.005, 0.05)
    assert scene.identify(far).status == "too_few_leds"


def test_a_jump_that_the_prediction_missed_is_found_all_the_same() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        scene = make_scene(rng, random_leds(rng, 4, SEES), clutter=10)
        past = PosePrediction(near(scene.rig_T_flange, rng, 0.2, 1.0), 0.003, 0.02)
        found = scene.identify(prediction=past)
        assert scene.outcome(found) == "complete"
        assert found.choice == "geometry"


def test_a_mirror_image_of_the_marker_is_never_taken_whole() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        leds = random_leds(rng, 4, SEES)
        if abs(np.linalg.det(leds[1:] - leds[0])) < 2e-5:  # m³; a flat one is its own mirror image
            continue
        scene = make_scene(rng, leds * [1, 1, -1])
        scene.marker = make_marker(leds)
        found = scene.identify()
        assert len(found.left_led) + len(found.right_led) < 8


FLAT = np.array([[0.06, 0.005, 0], [-0.045, 0.04, 0], [-0.02, -0.055, 0], [0.03, 0.05, 0]])


@pytest.mark.parametrize(("leds", "clutter"), [(FLAT, 5), (ROW, 8)], ids=["flat", "on one line"])
def test_flat_markers_are_identified_from_their_true_side(leds: Array, clutter: int) -> None:
    for seed in range(30):
        scene = make_scene(np.random.default_rng(seed), leds, clutter=clutter, skew_px=0.5)
        found = scene.identify(skew=0.5)
        assert (scene.outcome(found), found.choice) == ("complete", "geometry")
        off = scene.rig_T_flange[:3, :3].T @ found.rig_T_flange[:3, :3]
        # of LEDs on one line, the turn about it is not seen
        assert leds is ROW or Rotation.from_matrix(off).magnitude() < 0.06


def test_a_marker_file_more_than_half_a_millimetre_off_still_serves() -> None:
    for seed in range(30):
        rng = np.random.default_rng(seed)
        leds = random_leds(rng, 4, SEES)
        off = rng.normal(size=(4, 3))
        scene = make_scene(rng, leds + 6e-4 * off / np.linalg.norm(off, axis=1, keepdims=True))
        scene.marker = make_marker(leds)
        assert scene.outcome(scene.identify()) == "complete"


def test_a_clean_spot_is_taken_before_a_merged_one() -> None:
    rng = np.random.default_rng(4)
    scene = make_scene(rng, random_leds(rng, 4, SEES))
    left = scene.spots[0]
    led = int(scene.spot_of_led[0][0])
    ghost = left.centre[led] + [0.25, 0.0]
    doubled = make_spots(
        np.vstack([left.centre, ghost]),
        np.vstack([left.colour, left.colour[:1]]),
        merged=np.arange(5) == led,
    )
    found = replace(scene, spots=(doubled, scene.spots[1])).identify()
    assert found.left_spot[found.left_led == 0] == 4


def test_a_doubtful_spot_leaves_two_poses_and_the_motion_says_which() -> None:
    """With one of three LEDs doubtful in a picture, its ray meets its circle twice."""
    off = {True: [], False: []}
    for seed in range(60):
        rng = np.random.default_rng(seed)
        scene = make_scene(rng, random_leds(rng, 3, SEES))
        left, right = scene.spots
        spot = int(scene.spot_of_led[0][0])
        centre, covariance = left.centre.copy(), left.covariance.copy()
        centre[spot, 0] += 1.6
        covariance[spot] = 1.4**2 * np.eye(2)
        doubtful = replace(left, centre=centre, covariance=covariance)
        past = PosePrediction(near(scene.rig_T_flange, rng, 1e-3, 5e-3), 2e-3, 0.01)
        for predicted in off:
            found = replace(scene, spots=(doubtful, right)).identify(
                prediction=past if predicted else None
            )
            assert found.rig_T_flange is not None
            turn = found.rig_T_flange[:3, :3].T @ scene.rig_T_flange[:3, :3]
            off[predicted].append(float(np.arccos(min((np.trace(turn) - 1) / 2, 1.0))))
    assert max(off[True]) < np.deg2rad(3.0) < max(off[False])


def test_no_spots_in_an_image_or_behind_the_cameras_are_too_few() -> None:
    rng = np.random.default_rng(7)
    scene = make_scene(rng, random_leds(rng, 3, SEES))
    none = make_spots(np.zeros((0, 2)), np.zeros((0, 3)))
    left, right = scene.spots
    past = PosePrediction(scene.rig_T_flange, 0.01, 0.1)
    for spots in ((none, none), (left, none), (none, right)):
        found = replace(scene, spots=spots).identify(prediction=past)
        assert found.status == "too_few_leds"
    assert replace(scene, spots=(right, left)).identify().status == "too_few_leds"


def test_a_scene_full_of_lamps_on_one_line_takes_bounded_time() -> None:
    rng = np.random.default_rng(8)
    scene = make_scene(rng, random_leds(rng, 6))
    pans = [scene.rig.left.rig_T_camera(PANS[0]), scene.rig.right.rig_T_camera(PANS[1])]
    ends = np.array([pan[:3, 3] for pan in pans])
    middle = ends.mean(axis=0) + np.array([0, 0, 0.8])
    along = 4 * np.linspace(-0.5, 0.5, 48)[:, None] * (ends[1] - ends[0])  # one epipolar plane
    lamps = [
        make_spots(project(camera, pan, middle + along), np.full((48, 3), GREY))
        for camera, pan in zip((scene.rig.left, scene.rig.right), PANS, strict=True)
    ]
    begin = time.process_time()
    replace(scene, spots=(lamps[0], lamps[1])).identify(expected=(scene.rig_T_flange,))
    took = time.process_time() - begin
    assert took < 1.0  # s, several times what it takes on one slow core


def followed(scene: Scene, past: PosePrediction, least: float = np.nan) -> TrackedLeds | None:
    black = np.zeros((SIZE[1], SIZE[0]), dtype=np.uint8)
    return track_leds(
        StereoPair(0, 1.0, 1.004, *PANS, black, black),
        scene.spots,
        scene.rig,
        scene.marker,
        past,
        likely=(1.4, np.full(2, least)),
        motion_tolerance_px=2.0,
    )


def test_where_nothing_is_open_the_prediction_alone_gives_what_the_search_gives() -> None:
    clear = 0
    for trial in range(120):
        rng = np.random.default_rng(40_000 + trial)
        count, clutter = 3 + trial % 3, trial % 2 * int(rng.integers(1, 4))
        scene = make_scene(
            rng, random_leds(rng, count, SEES), clutter=clutter, skew_px=rng.uniform(0, 1.5)
        )
        past = PosePrediction(near(scene.rig_T_flange, rng, 0.004, 0.04), 0.005, 0.05)
        own = scene.identify(past)
        if own.choice != "geometry":
            continue
        assert followed(scene, past) is None  # nothing says that the pair before had no rival
        tracked = followed(scene, replace(past, choice="geometry"))
        if tracked is None:
            continue
        clear += 1
        assert clutter == 0
        found = tracked.correspondence
        for name in ("left_led", "left_spot", "right_led", "right_spot", "rig_T_flange"):
            assert_array_equal(getattr(found, name), getattr(own, name))
        assert (found.choice, found.status) == ("geometry", "measured")
    assert clear > 40


def test_tracked_leds_are_gathered_each_at_its_own_instant_and_what_is_no_led_is_left_out() -> None:
    rng = np.random.default_rng(7)
    plain = make_scene(rng, random_leds(rng, 4, SEES))
    rig = replace(plain.rig, left=replace(plain.rig.left, line_time=2e-5))
    past = PosePrediction(plain.rig_T_flange, 0.005, 0.05, "geometry")
    dim = (make_spots(np.array([[300.0, 200.0]]), np.array([GREY])), 20.0)
    vague = (replace(dim[0], covariance=4.0 * np.eye(2)[None]), 200.0)
    sides = []
    for spots in plain.spots:
        extra = [replace(spot, peak=np.array([peak])) for spot, peak in (dim, vague)]
        own = replace(spots, peak=np.linspace(220.0, 150.0, 4), diameter=np.linspace(4.0, 5.0, 4))
        names = ("centre", "covariance", "peak", "diameter", "merged", "saturated", "colour")
        parts = (extra[1], own, extra[0])
        sides.append(
            replace(own, **{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})
        )
    scene = replace(plain, rig=rig, spots=(sides[0], sides[1]))
    assert followed(scene, past) is None  # a dim spot is one more where no peak is known
    tracked = followed(scene, past, least=60.0)
    assert tracked is not None
    found = tracked.correspondence
    for side, (first, (led, spot)) in enumerate(zip((0, 4), found.sides, strict=True)):
        assert_array_equal(led, np.arange(4))
        assert_array_equal(spot, plain.spot_of_led[side])
        own, camera = slice(first, first + 4), (rig.left, rig.right)[side]
        for name, kept in (("centre", tracked.centre), ("covariance", tracked.covariance),
                           ("peak", tracked.peak), ("diameter", tracked.width)):  # fmt: skip
            assert_array_equal(kept[own], getattr(scene.spots[side], name)[1 + spot])
        rows = tracked.centre[own, 1] - 359.5
        assert_allclose(tracked.taken[own], (1.0, 1.004)[side] + rows * camera.line_time)
        points = scene.marker.leds @ plain.rig_T_flange[:3, :3].T + plain.rig_T_flange[:3, 3]
        inverse = np.linalg.inv(camera.rig_T_camera(PANS[side]))
        assert_allclose(tracked.depth[own], points @ inverse[2, :3] + inverse[2, 3], rtol=0.01)
