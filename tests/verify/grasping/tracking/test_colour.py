"""Colours by name and as learned: what counts as the target's and what does not."""

import numpy as np
import pytest

from tests.support.grasp.caps import BLUE, GREEN, RED, YELLOW
from verify.core.records import Array, Image
from verify.errors import InputError
from verify.grasping.tracking.colour import NAMED_HUES_DEG, learn_colour, named_colour, to_hsv
from verify.grasping.tracking.selection import model_from_box

PLAIN = {"blue": BLUE, "green": GREEN, "red": RED, "yellow": YELLOW, "orange": (20, 130, 240)}
DULL = [(128, 128, 128), (110, 150, 180), (130, 160, 215), (150, 185, 150), (20, 20, 24)]


def flat(bgr: tuple[int, int, int], side: int = 8) -> Image:
    return np.full((side, side, 3), bgr, dtype=np.uint8)


def disc(inside: tuple[int, int, int], around: tuple[int, int, int], radius: int = 20) -> Image:
    rows, columns = np.indices((100, 100))
    picture = np.full((100, 100, 3), around, dtype=np.uint8)
    picture[(rows - 50) ** 2 + (columns - 50) ** 2 <= radius**2] = inside
    noise = np.random.default_rng(2).normal(0, 3, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def paper_hue(bgr: Array) -> float:
    """Eqs. 9 and 10 of the grasping paper, degrees."""
    b, g, r = bgr.astype(float)
    root = np.sqrt((r - g) ** 2 + (r - b) * (g - b))
    angle = np.degrees(np.arccos(0.5 * ((r - g) + (r - b)) / root))
    return float(angle if b <= g else 360.0 - angle)


def test_the_hue_is_the_papers_but_for_hexagon_and_rounding() -> None:
    rng = np.random.default_rng(3)
    colours = rng.integers(0, 256, (400, 1, 3)).astype(np.uint8)
    vivid = [c for c in colours if np.ptp(c) > 60]
    for colour in vivid:
        ours = 2.0 * to_hsv(colour[None])[0, 0, 0]
        off = (ours - paper_hue(colour[0]) + 180.0) % 360.0 - 180.0
        assert abs(off) < 1.12 + 2.0  # geometric against hexagonal hue, and steps of 2°


@pytest.mark.parametrize("name", PLAIN)
def test_a_plain_colour_has_its_name_and_no_other(name: str) -> None:
    fits = {
        other: float(named_colour(other).back_project(to_hsv(flat(PLAIN[name]))).mean())
        for other in NAMED_HUES_DEG
    }
    assert fits.pop(name) > 200
    assert max(fits.values()) < 100


@pytest.mark.parametrize("bgr", DULL, ids=["grey", "wood", "skin", "pale paper", "black"])
def test_dull_colours_have_no_name(bgr: tuple[int, int, int]) -> None:
    for name in NAMED_HUES_DEG:
        assert named_colour(name).back_project(to_hsv(flat(bgr))).max() <= 127, name


def test_an_unknown_colour_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(InputError, match=r'--target: "turquoise" is not known; .*blue'):
        named_colour("turquoise")


def test_a_learned_colour_is_the_targets_and_not_its_surroundings() -> None:
    picture = disc(GREEN, (60, 170, 190))  # green on olive, both vivid
    weights = model_from_box(picture, (30, 30, 41, 41)).back_project(to_hsv(picture))
    rows, columns = np.indices((100, 100))
    away = np.hypot(rows - 50, columns - 50)
    assert (weights[away < 18] > 127).mean() > 0.98
    assert (weights[away > 22] > 127).mean() < 0.005


def test_brightness_distinguishes_objects_of_one_colour_and_its_gate_follows_the_light() -> None:
    darker = tuple(int(0.55 * c) for c in GREEN)
    picture = disc(GREEN, darker)  # type: ignore[arg-type]  # three numbers
    model = model_from_box(picture, (30, 30, 41, 41))
    weights = model.back_project(to_hsv(picture))
    assert (weights[40:60, 40:60] > 127).mean() > 0.95
    assert (weights[:, :20] > 127).mean() < 0.05
    dim = (picture // 2).astype(np.uint8)
    followed = model.in_light(model.value / 2).back_project(to_hsv(dim))
    assert (model.back_project(to_hsv(dim))[40:60, 40:60] > 127).mean() < 0.05
    assert (followed[40:60, 40:60] > 127).mean() > 0.9
    assert (followed[:, :20] > 127).mean() < 0.05


def test_the_similarity_is_that_of_bhattacharyya() -> None:
    picture = np.hstack([flat(BLUE), flat(GREEN)])
    hsv = to_hsv(picture)
    both = np.full(hsv.shape[:2], 255, dtype=np.uint8)
    left = both.copy()
    left[:, 8:] = 0
    model = learn_colour(hsv, left, 255 - left)
    assert model.similarity(hsv, left) == pytest.approx(1.0)
    assert model.similarity(hsv, both) == pytest.approx(np.sqrt(0.5))  # half of it is the target's
    assert model.similarity(hsv, 255 - left) == 0.0
