"""The chain composed: stereo pairs in, one measurement a pair out. Every mode drives this.

Where to look for the LEDs of a marker whose pose is predicted.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from verify.core.fiducials import Marker
from verify.core.records import Array, Image, Measurement, Pose, Sighting, Spots, StereoPair
from verify.core.rig import Camera, Rig
from verify.measurement.alignment import MAX_GAP, RawSighting, align, spot_instants
from verify.measurement.correspondence.assign import Correspondence, PosePrediction, assign_leds
from verify.measurement.detection.detect import detect
from verify.measurement.kernels.alignment import led_boxes
from verify.measurement.pose import ACCELERATION_PER_SPEED, MIN_ACCELERATION, fit_pose, perturb
from verify.measurement.systematics import Systematics, spot_columns, stated_systematics

# A spot's surroundings: its own radius several times over, for the background that is fitted.
MARGIN_PX = 14.0


def led_windows(
    marker: Marker, camera: Camera, pan: float, prediction: PosePrediction, image: Image
) -> Array:
    """Where to look for each LED, (n, 4) px: x0, y0, x1, y1, overlapping ones merged.

    Args:
        marker: the LEDs.
        camera: who sees them.
        pan: rad, reading of its base.
        prediction: of the flange's pose in the rig.
        image: the picture that is to be searched.
    """
    doubt = 2 * prediction.position_uncertainty, 2 * prediction.rotation_uncertainty
    boxes = np.empty((len(marker), 4))
    count = led_boxes(
        camera.camera_T_rig(pan) @ prediction.rig_T_flange,
        np.ascontiguousarray(marker.leds),
        (camera.matrix, camera.distortion),
        (MARGIN_PX, marker.led_diameter, *doubt),
        (image.shape[1], image.shape[0]),
        boxes,
    )
    return boxes[:count]


NO_POSES: tuple[Array, ...] = ()
MIN_MOTION_PX = 0.3  # what clocks and lenses leave between two pictures of one instant
UNKNOWN_SPEED_PX = 500.0  # px/s: half a metre a second at a metre
MIN_DEPTH = 0.1  # m: nearer than any camera of this kind can focus


Detector = Callable[[Image, Image, Array | None, Array | None], tuple[Spots, Spots]]


def detect_in_turn(
    left: Image, right: Image, left_windows: Array | None, right_windows: Array | None
) -> tuple[Spots, Spots]:
    """Find the spots of both pictures of a pair; windows (m, 4) px, None for the whole frame."""
    return detect(left, left_windows), detect(right, right_windows)


def no_expected_poses(_t: float) -> Sequence[Array]:
    """Stand in for encoders where there are none: no candidate poses."""
    return NO_POSES


@dataclass(frozen=True)
class Setup:
    """What a measurement needs to know beside the pictures."""

    rig: Rig
    marker: Marker
    # candidates for rig_T_flange at a time (s), from the encoders: settles which LED is which
    # where nothing else does; a choice, never a value
    expected: Callable[[float], Sequence[Array]] = field(default=no_expected_poses)
    # who looks for spots: another one that is quicker must find the same
    detect: Detector = field(default=detect_in_turn)

    @cached_property
    def parameters(self) -> Systematics:
        """What rig and marker state of their own uncertainty, pan angles included."""
        return stated_systematics(self.rig, self.marker, turning=True)

    @cached_property
    def reach(self) -> float:
        """How far the farthest LED is from the flange, m."""
        return float(np.max(np.linalg.norm(self.marker.leds, axis=1)))


@dataclass(frozen=True, slots=True)
class _AssignedPair:
    """A pair after identification, each spot still at its own instant."""

    pair_t: float
    frame: int
    found: Correspondence
    left: RawSighting
    right: RawSighting
    whole_frame: bool


@dataclass(frozen=True, slots=True)
class _PreviousPair:
    """What is carried from one pair to the next: one pair, no more."""

    seen: _AssignedPair
    pose: Pose


@dataclass(slots=True)
class ChainState:
    """What the chain carries from one pair to the next: all that a later pair depends on."""

    memory: _PreviousPair | None = None
    previous: _AssignedPair | None = None
    held: _AssignedPair | None = None  # the first pair of a burst, until its successor is there


def measure(
    pairs: Iterable[StereoPair], setup: Setup, carried: ChainState | None = None
) -> Iterator[Measurement]:
    """Measure the flange's pose in each stereo pair.

    Args:
        pairs: stereo pairs in time order, streamed; two are held at most.
        setup: rig, marker, and what the encoders suggest.
        carried: to go on from, and kept up to date whenever the next pair is asked for; None
            begins anew.

    Yields:
        One measurement a pair, in order. A pair that cannot be measured has a status that says
        why. The first pair, also after a gap, is delivered with its successor, whose motion it
        borrows.
    """
    now = carried if carried is not None else ChainState()
    for pair in pairs:
        seen = _find_leds(pair, setup, now.memory if now.held is None else None)
        if now.held is not None:
            outcome, now.memory, now.previous = _finish(now.held, seen, setup)
            yield outcome
            now.held = None
        if now.previous is None or _beyond_gap(seen, now.previous):
            now.held = seen
            continue
        outcome, now.memory, now.previous = _finish(seen, now.previous, setup)
        yield outcome
    if now.held is not None:
        yield _finish(now.held, None, setup)[0]


def _beyond_gap(one: _AssignedPair, other: _AssignedPair) -> bool:
    return abs(one.pair_t - other.pair_t) > MAX_GAP


def _find_leds(pair: StereoPair, setup: Setup, memory: _PreviousPair | None) -> _AssignedPair:
    """Find the spots and say which LED each is; the whole frame where prediction fails."""
    prediction = _predict(memory, pair.t_left) if memory is not None else None
    if prediction is not None:
        looked_at = [
            led_windows(setup.marker, camera, pan, prediction, image)
            for camera, pan, image in (
                (setup.rig.left, pair.pan_left, pair.left),
                (setup.rig.right, pair.pan_right, pair.right),
            )
        ]
        spots = setup.detect(pair.left, pair.right, *looked_at)
        seen = _assign(pair, spots, setup, memory, prediction, whole_frame=False)
        if _shows_all_leds(seen, setup):
            return seen
    spots = setup.detect(pair.left, pair.right, None, None)
    # with an LED missing the prediction may follow a reflection: pictures that show the whole
    # marker elsewhere overrule it
    fresh = _assign(pair, spots, setup, memory, None, whole_frame=True)
    if prediction is None or _shows_all_leds(fresh, setup):
        return fresh
    return _assign(pair, spots, setup, memory, prediction, whole_frame=True)


def _shows_all_leds(seen: _AssignedPair, setup: Setup) -> bool:
    """Both pictures show the whole marker."""
    fewest = min(len(seen.found.left_led), len(seen.found.right_led))
    return seen.found.status == "measured" and fewest == len(setup.marker)


def _assign(
    pair: StereoPair,
    spots: tuple[Spots, Spots],
    setup: Setup,
    memory: _PreviousPair | None,
    prediction: PosePrediction | None,
    *,
    whole_frame: bool,
) -> _AssignedPair:
    found = assign_leds(
        *spots,
        setup.rig,
        pair.pan_left,
        pair.pan_right,
        setup.marker,
        prediction=prediction,
        expected=partial(setup.expected, pair.t_left),
        motion_tolerance_px=_motion_px(pair, setup, memory),
    )
    sides = []
    for camera, image_spots, led, spot, t, pan, image in (
        (setup.rig.left, spots[0], found.left_led, found.left_spot, pair.t_left, pair.pan_left,
         pair.left),
        (setup.rig.right, spots[1], found.right_led, found.right_spot, pair.t_right,
         pair.pan_right, pair.right),
    ):  # fmt: skip
        sides.append(_raw(image_spots, led, spot, t, pan, camera, setup, found, image))
    return _AssignedPair(pair.t_left, pair.frame, found, sides[0], sides[1], whole_frame)


def _motion_px(pair: StereoPair, setup: Setup, memory: _PreviousPair | None) -> float:
    """How far the LEDs may move between the two exposures of a pair."""
    skew = abs(pair.t_right - pair.t_left)
    if memory is None or pair.t_left - memory.seen.pair_t > MAX_GAP:
        return MIN_MOTION_PX + skew * UNKNOWN_SPEED_PX
    twist, pose = memory.pose.twist, memory.pose.rig_T_flange
    speed = _norm(twist[:3]) + setup.reach * _norm(twist[3:])
    focal = setup.rig.left.matrix.item(0, 0)
    depth = max(_norm(pose[:3, 3]), MIN_DEPTH)
    # twice the last speed: between two pairs an arm may as much as double it
    return MIN_MOTION_PX + 2 * skew * focal * speed / depth


def _raw(
    spots: Spots,
    led: NDArray[np.int64],
    spot: NDArray[np.int64],
    t: float,
    pan: float,
    camera: Camera,
    setup: Setup,
    found: Correspondence,
    image: Image,
) -> RawSighting:
    index = np.asarray(spot, dtype=np.int64)
    sighting = Sighting(
        led=np.asarray(led, dtype=np.int64),
        centre=spots.centre[index],
        covariance=spots.covariance[index],
        t=t,
        pan=pan,
        peak=spots.peak[index],
        velocity=np.zeros((len(index), 2)),
        acceleration_lever=np.zeros(len(index)),
    )
    depth = np.full(len(index), np.nan)
    if found.rig_T_flange is not None and len(index):
        ahead = camera.camera_T_rig(pan)[2] @ found.rig_T_flange  # the optical axis
        depth = setup.marker.leds[sighting.led] @ ahead[:3] + ahead[3]
    taken = spot_instants(t, sighting.centre, camera, image.shape[0])
    return RawSighting(sighting, taken, depth)


def _finish(
    seen: _AssignedPair, neighbour: _AssignedPair | None, setup: Setup
) -> tuple[Measurement, _PreviousPair | None, _AssignedPair]:
    """Align, fit the pose, and say what came of the pair and what the next may lean on."""
    found = seen.found
    leds = len(set(found.left_led.tolist()) | set(found.right_led.tolist()))
    outcome = Measurement(
        seen.frame, seen.pair_t, found.status, leds, choice=found.choice,
        whole_frame=seen.whole_frame,
    )  # fmt: skip
    if found.status != "measured" or found.rig_T_flange is None:
        return outcome, None, seen
    alone = neighbour is None or _beyond_gap(seen, neighbour)
    sides = []
    for camera, now, before in (
        (setup.rig.left, seen.left, neighbour.left if neighbour else None),
        (setup.rig.right, seen.right, neighbour.right if neighbour else None),
    ):
        useful = before if before is not None and len(before.sighting) else None
        aligned = align(now, useful, seen.pair_t, camera, alone=alone)
        sides.append(aligned if len(now.sighting) else now.sighting)
    left, right = sides
    if left is None or right is None:
        return replace(outcome, status="unaligned"), None, seen
    doubt = partial(_parameter_columns, setup, left, right)
    pose = fit_pose(left, right, setup.rig, setup.marker, found.rig_T_flange, doubt)
    status = "measured" if pose.consistent else "outlier"
    outcome = replace(outcome, status=status, pose=pose, left=left, right=right)
    kept = _without_rejected(seen, pose)
    return outcome, _PreviousPair(kept, pose) if pose.consistent else None, kept


def _parameter_columns(
    setup: Setup, left: Sighting, right: Sighting, rig_T_flange: Array, by_point: Array
) -> Array:
    """What rig and marker state of themselves, as the spots would show it."""
    known = setup.parameters
    return spot_columns(known, left, right, rig_T_flange, by_point, setup.rig, setup.marker)


def _without_rejected(seen: _AssignedPair, pose: Pose) -> _AssignedPair:
    """Leave out spots that the pose rejected: the next pair leans on the others."""
    good = ~pose.rejected
    m = len(seen.left.sighting)
    return replace(
        seen, left=_select_spots(seen.left, good[:m]), right=_select_spots(seen.right, good[m:])
    )


def _select_spots(raw: RawSighting, keep: NDArray[np.bool_]) -> RawSighting:
    if keep.all():
        return raw
    seen = raw.sighting
    some = replace(
        seen,
        led=seen.led[keep],
        centre=seen.centre[keep],
        covariance=seen.covariance[keep],
        peak=seen.peak[keep],
        velocity=seen.velocity[keep],
        acceleration_lever=seen.acceleration_lever[keep],
    )
    return RawSighting(some, raw.taken[keep], raw.depth[keep])


def _predict(memory: _PreviousPair, t: float) -> PosePrediction | None:
    """Where the flange should be now, from where it was and how it moved; None after a gap."""
    interval = t - memory.seen.pair_t
    if interval > MAX_GAP:
        return None
    pose = memory.pose
    linear, angular = (
        ACCELERATION_PER_SPEED * _norm(part) + rough
        for part, rough in zip((pose.twist[:3], pose.twist[3:]), MIN_ACCELERATION, strict=True)
    )
    # the twist is that of half a pair ago, so the error is an acceleration over interval², not half
    return PosePrediction(
        rig_T_flange=perturb(pose.rig_T_flange, pose.twist * interval),
        position_uncertainty=linear * interval**2 + 1e-3,  # m; pairs taken while starting to move
        rotation_uncertainty=angular * interval**2 + 0.01,  # rad, likewise
    )


def _norm(vector: Array) -> float:
    """Length of three numbers; numpy's own way would let other threads in, for a wait."""
    return math.hypot(*vector.tolist())
