"""Parse the box that a person has drawn, learn its colour, and find it in the other picture."""

import cv2
import numpy as np

from verify.core.records import Image, StereoPair
from verify.core.rig import Rig
from verify.errors import InputError
from verify.grasping.tracking.camshift import Box, camshift, clip_box, find_blobs
from verify.grasping.tracking.colour import MIN_WEIGHT, ColourModel, learn_colour, to_hsv
from verify.grasping.tracking.pairing import StereoObject, pair_blobs
from verify.grasping.tracking.target import BoxSelection, TrackingOptions

SURROUNDINGS = 0.75  # of the box, on every side: colours that are not the target's
_DRAWING_HINT = "Draw it close around a coloured object."
MIN_BOX_SIDE = 8  # px, either side of a box


def parse_box(text: str, option: str = "--roi") -> Box:
    """Read x,y,w,h in whole pixels.

    Raises:
        InputError: something else stands there, or the box is too small to learn a colour from.
    """
    expected = "x,y,w,h in whole pixels is expected, such as --roi 610,340,48,52"
    try:
        x, y, width, height = [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError(option, f'is "{text}"', expected) from None
    if min(x, y) < 0:
        raise InputError(option, f'is "{text}"', "x and y count from the picture's upper left, 0,0")
    if min(width, height) < MIN_BOX_SIDE:
        found = f"is {width} x {height} px"
        raise InputError(option, found, f"{MIN_BOX_SIDE} x {MIN_BOX_SIDE} px is the least")
    return x, y, width, height


def parse_drawn(text: str, place: str) -> BoxSelection:
    """Read what a person drew: left or right, a space, and x,y,w,h as `parse_box` reads it.

    Raises:
        InputError: something else stands there.
    """
    side, _, box = text.partition(" ")
    if side not in ("left", "right"):
        raise InputError(place, f'"{side}" is no picture', "left or right is expected")
    return BoxSelection(parse_box(box, place), "left" if side == "left" else "right")


def model_from_box(image: Image, box: Box, alike: ColourModel | None = None) -> ColourModel:
    """Learn a target's colours from a box around it, against its surroundings.

    The image is (h, w, 3) BGR; what fills the ellipse inside the box (x, y, width, height, px)
    counts as the target. `alike`: colours that are not learned as surroundings: another such object
    may stand there.

    Raises:
        InputError: the picture is grey, the box reaches out of it, or nothing in the box has a
            colour of its own.
    """
    if clip_box(box, image) != box:
        found = "reaches out of the picture"
        raise InputError("--roi", found, f"it has {image.shape[1]} x {image.shape[0]} px")
    x, y, width, height = box
    dx, dy = round(SURROUNDINGS * width), round(SURROUNDINGS * height)
    rx, ry, rw, rh = clip_box((x - dx, y - dy, width + 2 * dx, height + 2 * dy), image)
    hsv = to_hsv(image[ry : ry + rh, rx : rx + rw])
    outside = np.full((rh, rw), 255, dtype=np.uint8)
    inside = np.zeros_like(outside)
    outside[y - ry : y - ry + height, x - rx : x - rx + width] = 0
    if alike is not None:
        outside[alike.back_project(hsv) > MIN_WEIGHT] = 0
    middle = (x - rx + width // 2, y - ry + height // 2)
    cv2.ellipse(inside, middle, (width // 2, height // 2), 0, 0, 360, 255, cv2.FILLED)
    model = learn_colour(hsv, inside, outside)
    if model.mixture is None or not model.mixture.any():
        found = "holds no colour that its surroundings do not have"
        raise InputError("--roi", found, "", _DRAWING_HINT)
    return model


def counterpart(
    pair: StereoPair, rig: Rig, drawn: BoxSelection, options: TrackingOptions
) -> tuple[tuple[ColourModel, ColourModel], StereoObject | None]:
    """Learn a drawn target, and find it in the other picture.

    There it lies on the epipolar line of its centre and has its colours and its size, within the
    options' limits. Others that look the same are told from it by what else stands in the picture
    that was drawn in. Returns the colours in the left and in the right picture, and the target as
    both cameras see it; None where nothing in the other picture fits, or more than one thing does.

    Raises:
        InputError: see `model_from_box`; or nothing in the box hangs together.
    """
    pictures = [pair.left, pair.right]
    own = 0 if drawn.side == "left" else 1
    model = model_from_box(pictures[own], drawn.box)
    blob = camshift(pictures[own], drawn.box, drawn.box, model)
    if blob is None:
        raise InputError("--roi", "holds no patch of one colour", "", _DRAWING_HINT)
    here = [blob, *find_blobs(pictures[own], model, blob.box)]
    there = [other for other in find_blobs(pictures[1 - own], model) if not other.cut]
    lefts, rights = (here, there) if own == 0 else (there, here)
    things = pair_blobs(lefts, rights, pair, rig, options)
    taken = [(thing.left, thing.right)[1 - own] for thing in things]
    chosen = next((thing for thing in things if (thing.left, thing.right)[own] is blob), None)
    free = [other for other in there if not any(other is one for one in taken)]
    for other in free:  # unexplained otherwise: it might be the counterpart as well
        left, right = (blob, other) if own == 0 else (other, blob)
        if pair_blobs([left], [right], pair, rig, options):
            return (model, model), None
    if chosen is None:
        return (model, model), None
    box = (chosen.left, chosen.right)[1 - own].box
    theirs = model_from_box(pictures[1 - own], box, model)
    return ((model, theirs) if own == 0 else (theirs, model)), chosen
