"""CAMSHIFT in one picture, against shapes whose moments are known, and in a real video."""

import csv
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from tests.support.beside import shared
from tests.support.grasp.caps import BLUE, GREEN
from verify.core.records import Array, Image, StereoPair
from verify.core.rig import Camera, Rig
from verify.grasping.tracking.camshift import Blob, box_around, camshift, coarse_boxes, find_blobs
from verify.grasping.tracking.colour import named_colour
from verify.grasping.tracking.target import BoxSelection, TargetObservation
from verify.grasping.tracking.track import track

WOOD = (110, 150, 180)
WHOLE = (0, 0, 320, 240)


def picture(
    *ellipses: tuple[tuple[float, float], tuple[float, float], float, tuple[int, int, int]],
    noise: float = 2.0,
    seed: int = 1,
) -> Image:
    """Ellipses (centre, semi-axes, angle in degrees, colour) on wood, drawn to 1/16 px."""
    canvas = np.full((240, 320, 3), WOOD, dtype=np.uint8)
    for centre, axes, angle, colour in ellipses:
        place = tuple(round(16 * c) for c in centre)
        half = tuple(round(16 * a) for a in axes)
        cv2.ellipse(canvas, place, half, angle, 0, 360, colour, cv2.FILLED, cv2.LINE_AA, 4)
    noisy = canvas + np.random.default_rng(seed).normal(0, noise, canvas.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def found(image: Image, start: tuple[int, int, int, int] = WHOLE, **more: object) -> Blob:
    region = more.pop("region", WHOLE)
    return camshift(image, start, region, named_colour("blue"), **more)  # type: ignore[arg-type]


def test_centre_and_ellipse_are_those_of_the_shape_that_was_drawn() -> None:
    blob = found(picture(((150.3, 110.6), (24, 11), 30, BLUE)))
    long, short, angle = blob.ellipse
    np.testing.assert_allclose(blob.centre, [150.3, 110.6], atol=0.15)
    assert (long, short) == pytest.approx((48, 22), abs=2.5)  # the rim of mixed pixels
    assert np.degrees(angle) % 180 == pytest.approx(30, abs=1.5)


def test_the_centre_is_that_of_the_target_alone_and_of_all_of_it() -> None:
    beside = found(picture(((150, 110), (14, 14), 0, BLUE)), start=(155, 112, 30, 30))
    np.testing.assert_allclose(beside.centre, [150, 110], atol=0.2)  # the window climbs to it
    shiny = picture(((150, 110), (16, 16), 0, BLUE), ((156, 104), (5, 5), 0, (255, 250, 245)))
    np.testing.assert_allclose(found(shiny).centre, [150, 110], atol=0.2)
    pair = picture(((150, 110), (12, 12), 0, BLUE), ((178, 110), (12, 12), 0, BLUE))  # 4 px between
    blob = found(pair, start=box_around(np.array([150, 110]), np.array([12, 12])))
    np.testing.assert_allclose(blob.centre, [150, 110], atol=0.3)
    assert blob.share < 0.7  # the rest is elsewhere


def test_nothing_is_detected_outside_the_searched_region() -> None:
    image = picture(((150, 110), (14, 14), 0, BLUE))
    assert camshift(image, (220, 40, 30, 30), (200, 20, 80, 80), named_colour("blue")) is None


def test_a_touching_object_is_cut_at_the_expected_size_and_flagged() -> None:
    joined = picture(((150, 110), (12, 12), 0, BLUE), ((150, 136), (5, 16), 0, BLUE))
    blob = found(joined, expected=np.array([24.0, 24.0]))
    assert np.linalg.norm(blob.centre - [150, 110]) < 4.5
    assert blob.reach > 1.4 * blob.area > 0


def test_touching_the_border_is_flagged() -> None:
    assert found(picture(((5, 110), (12, 12), 0, BLUE))).cut
    inside = picture(((60, 110), (12, 12), 0, BLUE))
    assert not found(inside, start=(50, 100, 20, 20), region=(50, 90, 40, 40)).cut


def test_what_goes_on_beyond_the_region_is_truncated() -> None:
    touching = picture(((150, 110), (14, 14), 0, BLUE), ((176, 110), (14, 14), 0, BLUE))
    start, expected = (136, 96, 29, 29), np.array([29.0, 29.0])
    for width, truncated in ((40, True), (90, False)):
        region = (130, 90, width, 40)
        assert found(touching, start, region=region, expected=expected).truncated == truncated
    # at the picture's border it is cut, and goes on nowhere
    at_border = found(picture(((5, 110), (12, 12), 0, BLUE)), region=(0, 80, 40, 60))
    assert (at_border.cut, at_border.truncated) == (True, False)


def test_the_claimed_noise_of_the_centre_covers_the_scatter() -> None:
    blobs = [found(picture(((150.4, 110.2), (13, 9), 20, BLUE), seed=s)) for s in range(60)]
    scatter = np.std([b.centre for b in blobs], axis=0)
    claimed = np.sqrt(np.mean([np.diag(b.covariance) for b in blobs], axis=0))
    assert (scatter < 1.2 * claimed).all()
    assert (claimed < 0.15).all()  # and it is not simply large


def test_a_whole_picture_gives_every_patch_largest_first() -> None:
    image = picture(
        ((60, 60), (9, 9), 0, BLUE),
        ((200, 150), (14, 14), 0, BLUE),
        ((120, 190), (14, 14), 0, GREEN),
    )
    blobs = find_blobs(image, named_colour("blue"))
    np.testing.assert_allclose([b.centre for b in blobs], [[200, 150], [60, 60]], atol=0.4)
    assert len(coarse_boxes(image, named_colour("red"))) == 0


FOCAL, BASELINE, DISPARITY = 600.0, 0.1, 100  # px, m, px: 0.6 m away the cap is 29 mm wide


def shifted_pairs() -> Iterator[StereoPair]:
    """Make a stereo pair of each picture of the real video: the right one is the left one moved."""
    capture = cv2.VideoCapture(str(shared("data", "colour_video_visp", "cube_video.mp4")))
    number = 0
    while (taken := capture.read())[0]:
        left = np.asarray(taken[1], dtype=np.uint8)
        right = np.pad(left[:, DISPARITY:], ((0, 0), (0, DISPARITY), (0, 0)), mode="edge")
        yield StereoPair(number, number / 30.0, number / 30.0, 0.0, 0.0, left, right)
        number += 1
    capture.release()


def parallel_rig() -> Rig:
    """Two cameras beside each other in which the moved pictures are a scene DISPARITY px deep."""
    left, right = (
        Camera(
            matrix=np.array([[FOCAL, 0.0, 319.5], [0.0, FOCAL, 239.5], [0.0, 0.0, 1.0]]),
            distortion=np.zeros(5),
            pan_center=np.array([x, 0.0, 0.0]),
            pan_axis=np.array([0.0, 1.0, 0.0]),
            pan_zero=0.0,
            mount=np.eye(4),
        )
        for x in (0.0, BASELINE)
    )
    return Rig((640, 480), left, right, np.full((4, 4), np.nan), base_source="")


CapFilm = tuple[list[TargetObservation], list[str], list[Array]]


@pytest.fixture(scope="module")
def cap_followed() -> CapFilm:
    """The bottle's cap in the real video; its colour's centre by thresholds of its own."""
    table = shared("data", "colour_video_visp", "cap_visibility.csv")
    with table.open() as file:
        visible = [row["cap"] for row in csv.DictReader(file)]
    box = (331, 84, 29, 32)  # SOURCE.md: x 331..359, y 84..115 in every frame
    centres = []

    def watched() -> Iterator[StereoPair]:
        for pair in shifted_pairs():
            hsv = cv2.cvtColor(pair.left[84:116, 331:360], cv2.COLOR_BGR2HSV)
            lime = cv2.inRange(hsv, (24, 120, 90), (40, 255, 255))
            rows, columns = np.nonzero(lime)
            centre = [331 + columns.mean(), 84 + rows.mean()] if len(rows) else [np.nan, np.nan]
            centres.append(np.array(centre))
            yield pair

    return list(track(watched(), parallel_rig(), BoxSelection(box))), visible, centres


@pytest.mark.shared
def test_a_real_cap_is_found_within_3_px_in_99_percent_of_the_frames(cap_followed: CapFilm) -> None:
    seen, visible, centres = cap_followed
    frames = [i for i, state in enumerate(visible) if state == "in_sight"]
    near = [
        seen[i].status == "tracked"
        and (outline := seen[i].left) is not None
        and np.linalg.norm(outline.centre - centres[i]) < 3.0
        for i in frames
    ]
    assert len(frames) > 900
    assert np.mean(near) >= 0.99


@pytest.mark.shared
def test_a_hidden_real_cap_is_lost_and_found_again_each_time(cap_followed: CapFilm) -> None:
    seen, visible, _ = cap_followed
    hidden = [i for i, state in enumerate(visible) if state == "hidden"]
    assert hidden
    assert {seen[i].status for i in hidden} == {"lost"}
    assert all(seen[i].left is None and seen[i].right is None for i in hidden)
    ends = [i for i in hidden if visible[i + 1] != "hidden"]
    for end in ends:
        back = next(i for i in range(end, len(visible)) if visible[i] == "in_sight")
        assert any(s.status == "tracked" for s in seen[back : back + 3])
