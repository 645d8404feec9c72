"""Search a pair of pictures for the target: where it is predicted, or everywhere."""

import math
from dataclasses import dataclass

import numpy as np

from verify.core.records import Array, Image, StereoPair
from verify.core.rig import Camera, Rig
from verify.grasping.tracking import association, camshift
from verify.grasping.tracking.colour import ColourModel
from verify.grasping.tracking.kalman import KalmanTrack, begin_track
from verify.grasping.tracking.pairing import (
    MAX_LOG_AREA_RATIO,
    StereoObject,
    is_plausible,
    join_blobs,
    pair_blobs,
)
from verify.grasping.tracking.stereo import RIM_WIDTH, PannedCamera, place_cameras, project
from verify.grasping.tracking.target import TrackingOptions

MIN_SIMILARITY = 0.6  # least similarity of the mixture of colours
SEARCH_PERIOD = 3  # pairs from one search for others to the next
CERTAIN_AREA_RANGE = 0.9, 1.1  # of the target's area: no doubt about the centre
CERTAIN_AREA_AGREEMENT = 0.95  # of the smaller area to the larger one: noise, and a side view
MIN_VISIBLE_SHARE = 0.3  # of the target that must be in view to locate it
WINDOW_SIGMA, WINDOW_MARGIN_PX = 4.0, 6.0  # of the searched window beyond the target itself
Windows = tuple[camshift.Box | None, camshift.Box | None]  # left, right; None: the whole picture
NO_WINDOWS: Windows = (None, None)


@dataclass(frozen=True, slots=True)
class TargetSearch:
    """One pair, and what is known before it is searched."""

    pair: StereoPair
    rig: Rig
    options: TrackingOptions
    models: tuple[ColourModel, ColourModel]  # left, right
    identity: association.TargetIdentity


def search_pair(now: TargetSearch, all_objects: bool) -> tuple[list[StereoObject], Windows]:
    """Find the objects of a pair: in the predicted windows alone, if that is enough.

    `all_objects`: search for others of the colour as well. With them, the windows that were
    searched for the target.
    """
    identity = now.identity
    ahead = None if identity.target is None else identity.target.track.at(now.pair.t_left)
    found = _search_predicted(now, ahead) if ahead is not None and identity.tracked else None
    if found is None:
        return _search_pictures(now, None), NO_WINDOWS
    thing, windows = found
    if identity.settled and not all_objects:
        return [thing], windows
    return _search_pictures(now, thing), windows


def left_picture(now: TargetSearch, ahead: KalmanTrack) -> str:
    """Name the picture that the target has left, by its prediction; "" for none."""
    target = now.identity.target
    assert target is not None
    for name, (camera, _, image) in zip(("left", "right"), _camera_sides(now), strict=True):
        pixel, _, depth = project(camera, ahead.position)
        half = _extent_in_pixels(target.extent, camera.camera, depth) / 2
        last = np.array(image.shape[1::-1]) - 1
        if depth <= 0 or (pixel - half < 0).any() or (pixel + half > last).any():
            return name
    return ""


def _search_predicted(now: TargetSearch, ahead: KalmanTrack) -> tuple[StereoObject, Windows] | None:
    """Search for the target where it is predicted."""
    target = now.identity.target
    assert target is not None
    blobs: list[camshift.Blob] = []
    windows: list[camshift.Box] = []
    for model, (camera, t, image) in zip(now.models, _camera_sides(now), strict=True):
        there = ahead.at(t)
        pixel, slope, depth = project(camera, there.position)
        sigma = np.sqrt(np.diag(slope @ there.position_covariance @ slope.T))
        extent = _extent_in_pixels(target.extent, camera.camera, depth)
        region = camshift.box_around(pixel, 0.6 * extent + WINDOW_SIGMA * sigma + WINDOW_MARGIN_PX)
        blob = camshift.camshift(
            image, camshift.box_around(pixel, 0.5 * extent + sigma), region, model, extent
        )
        if blob is None or blob.similarity < MIN_SIMILARITY or blob.cut or blob.truncated:
            return None
        blobs.append(blob)
        windows.append(region)
    thing = join_blobs(blobs[0], blobs[1], now.pair, now.rig, ahead)
    if thing is None or thing.area < MIN_VISIBLE_SHARE * target.area:
        return None
    # by areas at the measured distance: at a predicted one that lags, a whole patch looks too
    # large, counts for little, and lets it lag the more
    doubts = _centre_doubts(target, thing.areas, (blobs[0], blobs[1]))
    if max(doubts) > 0:
        thing = join_blobs(blobs[0], blobs[1], now.pair, now.rig, ahead, doubts) or thing
    # a finger may hide most of it from one camera alone; what is too large is not half hidden
    hidden = thing.areas.max() < association.COMPLETE_AREA_RANGE[1] * target.area
    if not is_plausible(
        thing, now.options, -math.log(MIN_VISIBLE_SHARE) if hidden else MAX_LOG_AREA_RATIO
    ):
        return None
    return thing, (windows[0], windows[1])


def _search_pictures(now: TargetSearch, target: StereoObject | None) -> list[StereoObject]:
    """Search for everything of the colour; the target itself may be found already."""
    pair = now.pair
    own = (None, None) if target is None else (target.left.box, target.right.box)
    found = []
    for image, model, but in zip((pair.left, pair.right), now.models, own, strict=True):
        blobs = camshift.find_blobs(image, model, but)
        found.append([b for b in blobs if b.similarity >= MIN_SIMILARITY and not b.cut])
    things = pair_blobs(found[0], found[1], pair, now.rig, now.options)
    things = [_remeasure(now, thing) for thing in things]
    return things if target is None else [target, *things]


def _remeasure(now: TargetSearch, thing: StereoObject) -> StereoObject:
    """Measure an object again by what is known of its velocity, and of the target's size."""
    pair, target = now.pair, now.identity.target
    motion = now.identity.nearest(pair.t_left, thing)
    if motion is None:
        motion = begin_track(pair.t_left, thing.place.point, thing.spread, now.options.speed)
    if target is None:
        return join_blobs(thing.left, thing.right, pair, now.rig, motion) or thing
    blobs = [
        _trim_to_target(blob, image, model, _extent_in_pixels(target.extent, camera, float(depth)))
        for blob, image, model, camera, depth in zip(
            (thing.left, thing.right),
            (pair.left, pair.right),
            now.models,
            (now.rig.left, now.rig.right),
            thing.place.depth,
            strict=True,
        )
    ]
    doubts = _centre_doubts(target, thing.areas, (blobs[0], blobs[1]))
    return join_blobs(blobs[0], blobs[1], pair, now.rig, motion, doubts) or thing


def _centre_doubts(
    target: association.ObjectTrack, areas: Array, blobs: tuple[camshift.Blob, camshift.Blob]
) -> tuple[float, float]:
    """By how much either patch's centre may miss the target's, standard, px; `areas` (2,), m².

    What a patch lacks, or has too much, is all at one side. One that is smaller than the other
    camera's lacks a part, whatever the distance.
    """
    larger, (least, most) = float(areas.max()), CERTAIN_AREA_RANGE
    left, right = (
        max(least - area / target.area, area / target.area - most,
            CERTAIN_AREA_AGREEMENT - area / larger, 0.0)
        * float(blob.extent.max())
        for area, blob in zip(areas.tolist(), blobs, strict=True)
    )  # fmt: skip
    return left, right


def _trim_to_target(
    blob: camshift.Blob, image: Image, model: ColourModel, expected: Array
) -> camshift.Blob:
    """Cut a patch that is larger than the target to the target's size."""
    if not (blob.extent > camshift.MAX_EXTENT_RATIO * expected).any():
        return blob
    return camshift.camshift(image, blob.box, blob.box, model, expected) or blob


def _camera_sides(now: TargetSearch) -> tuple[tuple[PannedCamera, float, Image], ...]:
    pair, (left, right) = now.pair, place_cameras(now.rig, now.pair)
    return (left, pair.t_left, pair.left), (right, pair.t_right, pair.right)


def _extent_in_pixels(extent: Array, camera: Camera, depth: float) -> Array:
    """Image of an extent (2,), m, at a depth, m: (2,) px, with the rim of mixed pixels."""
    return extent * np.diag(camera.matrix)[:2] / depth + 2 * RIM_WIDTH
