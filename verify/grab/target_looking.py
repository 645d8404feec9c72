"""Looking for a target in a pair of pictures: where it should be, or everywhere."""

import math
from dataclasses import dataclass

import numpy as np

from verify.grab.camshift import ROOM, Blob, Box, around, camshift
from verify.grab.camshift_search import find_all
from verify.grab.colour import ColourModel
from verify.grab.stereo_target import RIM
from verify.grab.stereo_target_camera import Placed, both, project
from verify.grab.stereo_target_pairing import (
    AREAS,
    Motion,
    Thing,
    join,
    pair_up,
    plausible,
    square_metres,
)
from verify.grab.target import Options
from verify.grab.target_association import Candidate
from verify.grab.target_identity import SEEN_WHOLE, Identity, lacking
from verify.grab.track3d import Track
from verify.records import Array, Image, StereoPair
from verify.rig import Camera, Rig

ALIKE = 0.6  # least similarity of the mixture of colours
LOOK_AROUND = 3  # pairs from one search for others to the next
PART = 0.3  # of the target that must be seen to say where it is
NEAR_SIGMA, MARGIN_PX = 4.0, 6.0  # of the searched window beyond the target itself
Windows = tuple[Box | None, Box | None]  # left, right; None: the whole picture
NOWHERE: Windows = (None, None)


@dataclass(frozen=True, slots=True)
class Look:
    """One pair, and what is known before it is looked at."""

    pair: StereoPair
    rig: Rig
    options: Options
    models: tuple[ColourModel, ColourModel]  # left, right
    identity: Identity


def look(now: Look, around_too: bool) -> tuple[list[Thing], Windows]:
    """See what is where: in the predicted windows alone, if that is enough.

    Args:
        now: the pair.
        around_too: look for others of the colour as well.

    Returns:
        The objects, and the windows that were searched for the target.
    """
    identity = now.identity
    ahead = identity.predicted(now.pair.t_left)
    if ahead is None or not identity.tracked:
        return _everywhere(now, None), NOWHERE
    thing, windows = _ahead(now, ahead)
    if thing is None:
        return _everywhere(now, None), NOWHERE
    if identity.settled and not around_too:
        return [thing], windows
    return _everywhere(now, thing), windows


def outside(now: Look, ahead: Track) -> str:
    """Name the picture that the target has left, by its prediction; "" for none."""
    known = now.identity.target
    assert known is not None
    sides = _sides(both(now.rig, now.pair), now.pair)
    for name, (camera, _, image) in zip(("left", "right"), sides, strict=True):
        pixel = project(camera, ahead.position)[0]
        depth = float(camera.inside(ahead.position)[2])
        half = _pixels(known.extent, camera.camera, depth) / 2
        last = np.array(image.shape[1::-1]) - 1
        if depth <= 0 or (pixel - half < 0).any() or (pixel + half > last).any():
            return name
    return ""


def candidate(thing: Thing, index: int) -> Candidate:
    """What an object is to the question who is who."""
    return Candidate(
        position=thing.place.point,
        covariance=thing.place.covariance,
        systematic=thing.place.systematic,
        area=float(thing.areas.min()),
        largest=float(thing.areas.max()),
        reach=float(thing.reaches.max()),
        extent=thing.size,
        index=index,
    )


def _ahead(now: Look, ahead: Track) -> tuple[Thing | None, Windows]:
    """Look for the target where it should be."""
    known = now.identity.target
    assert known is not None
    motion = Motion(ahead.velocity, ahead.velocity_covariance)
    blobs: list[Blob] = []
    windows: list[Box] = []
    doubts: list[float] = []
    sides = _sides(both(now.rig, now.pair), now.pair)
    for model, (camera, t, image) in zip(now.models, sides, strict=True):
        there = ahead.at(t)
        pixel, slope, exact = project(camera, there.position)
        depth = float(camera.inside(there.position)[2])
        sigma = np.sqrt(np.diag(slope @ there.position_covariance @ slope.T))
        extent = _pixels(known.extent, camera.camera, depth)
        region = around(pixel, 0.75 * extent + NEAR_SIGMA * sigma + MARGIN_PX)
        start = around(pixel, 0.5 * extent + sigma)
        blob = camshift(image, start, region, model, extent)
        if blob is None or blob.similarity < ALIKE or blob.cut:
            return None, NOWHERE
        share = blob.area * square_metres(exact, depth) / known.area
        if share < PART:
            return None, NOWHERE
        blobs.append(blob)
        windows.append(region)
        doubts.append(lacking(share) * float(extent.max()))
    thing = join(blobs[0], blobs[1], now.pair, now.rig, motion, (doubts[0], doubts[1]))
    if thing is None:
        return None, NOWHERE
    # a finger may hide most of it from one camera alone; what is too large is not half hidden
    hidden = thing.areas.max() < SEEN_WHOLE[1] * known.area
    if not plausible(thing, now.options, -math.log(PART) if hidden else AREAS):
        return None, NOWHERE
    return thing, (windows[0], windows[1])


def _everywhere(now: Look, target: Thing | None) -> list[Thing]:
    """Look for everything of the colour; the target itself may have been seen already."""
    pair = now.pair
    own = (None, None) if target is None else (target.left.box, target.right.box)
    found = []
    for image, model, but in zip((pair.left, pair.right), now.models, own, strict=True):
        blobs = find_all(image, model, but)
        found.append([b for b in blobs if b.similarity >= ALIKE and not b.cut])
    things = pair_up(found[0], found[1], pair, now.rig, now.options)
    things = [_closer(now, thing) for thing in things]
    return things if target is None else [target, *things]


def _closer(now: Look, thing: Thing) -> Thing:
    """Measure an object again by what is known of its velocity, and of the target's size."""
    pair, known = now.pair, now.identity.target
    moving = now.identity.nearest(pair.t_left, candidate(thing, 0))
    if moving is None:
        motion = Motion(np.zeros(3), np.eye(3) * now.options.speed**2)
    else:
        motion = Motion(moving.velocity, moving.velocity_covariance)
    if known is None:
        return join(thing.left, thing.right, pair, now.rig, motion) or thing
    blobs = [
        _trimmed(blob, image, model, _pixels(known.extent, camera, float(depth)))
        for blob, image, model, camera, depth in zip(
            (thing.left, thing.right),
            (pair.left, pair.right),
            now.models,
            (now.rig.left, now.rig.right),
            thing.place.depth,
            strict=True,
        )
    ]
    doubts = [
        lacking(float(area) / known.area) * float(blob.extent.max())
        for area, blob in zip(thing.areas, blobs, strict=True)
    ]
    return join(blobs[0], blobs[1], pair, now.rig, motion, (doubts[0], doubts[1])) or thing


def _trimmed(blob: Blob, image: Image, model: ColourModel, expected: Array) -> Blob:
    """Cut a patch that is larger than the target to the target's size."""
    if not (blob.extent > ROOM * expected).any():
        return blob
    return camshift(image, blob.box, blob.box, model, expected) or blob


def _sides(
    cameras: tuple[Placed, Placed], pair: StereoPair
) -> tuple[tuple[Placed, float, Image], tuple[Placed, float, Image]]:
    return (cameras[0], pair.t_left, pair.left), (cameras[1], pair.t_right, pair.right)


def _pixels(extent: Array, camera: Camera, depth: float) -> Array:
    """How large an extent (2,), m, looks at a depth, m: (2,) px, with the rim of mixed pixels."""
    looks: Array = extent * np.diag(camera.matrix)[:2] / depth + 2 * RIM
    return looks
