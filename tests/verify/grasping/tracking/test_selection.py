"""What a person selects: a box in text, a box in a picture, and the target in the other one."""

import numpy as np
import pytest

from tests.support.grasp.caps import BLUE, GREEN, Cap, pairs, small_rig, still
from tests.support.scene import project
from verify.core.records import Array, StereoPair
from verify.errors import InputError
from verify.grasping.tracking.selection import counterpart, model_from_box, parse_box
from verify.grasping.tracking.target import BoxSelection, TrackingOptions

RIG = small_rig()
HERE = np.array([0.0, 0.02, 0.7])


def film(*caps: Cap) -> StereoPair:
    return next(pairs(caps, RIG, 0.1))


def box(place: Array, side: str = "left", half: int = 16) -> BoxSelection:
    camera = RIG.left if side == "left" else RIG.right
    x, y = project(camera, camera.pan, place[None])[0]
    corner = (round(x) - half, round(y) - half, 2 * half, 2 * half)
    return BoxSelection(corner, "left" if side == "left" else "right")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("610,340,48", "x,y,w,h in whole pixels is expected"),
        ("a,b,c,d", "x,y,w,h in whole pixels is expected"),
        ("-5,2,30,30", "upper left"),
        ("5,2,30,4", "is 30 x 4 px; 8 x 8 px is the least"),
    ],
)
def test_a_box_is_four_whole_numbers_and_other_text_is_refused_in_one_line(
    text: str, message: str
) -> None:
    assert parse_box("610,340,48,52") == (610, 340, 48, 52)
    with pytest.raises(InputError, match=message) as refusal:
        parse_box(text)
    assert str(refusal.value).startswith("--roi: ")
    assert "\n" not in str(refusal.value)


def test_a_box_outside_the_picture_or_without_a_colour_of_its_own_is_refused() -> None:
    with pytest.raises(InputError, match="reaches out of the picture; it has 640 x 360 px"):
        model_from_box(film().left, (620, 100, 40, 40))
    with pytest.raises(InputError, match="holds no colour"):
        model_from_box(film().left, (300, 40, 40, 40))  # the grey wall


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("other", [GREEN, BLUE], ids=["others", "others of its colour"])
def test_the_target_is_found_in_the_other_picture(side: str, other: tuple[int, int, int]) -> None:
    others = [Cap(other, still(x, 0.02, 0.7)) for x in (-0.1, 0.1)]
    pair = film(Cap(BLUE, still(*HERE)), *others)
    _, thing = counterpart(pair, RIG, box(HERE, side), TrackingOptions())
    np.testing.assert_allclose(thing.place.point, HERE, atol=0.002)


def test_objects_in_one_picture_alone_are_not_found() -> None:
    lone = np.array([0.45, 0.02, 0.7])  # beyond the right picture's border
    pair = film(Cap(BLUE, still(*lone)), Cap(BLUE, still(-0.1, -0.12, 0.9)))
    assert counterpart(pair, RIG, box(lone), TrackingOptions())[1] is None
