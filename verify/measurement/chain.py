"""Measure the flange's pose in a stream of stereo pairs: one measurement a pair.

Every mode of the program runs this chain: detection, correspondence, alignment, pose fit. Where the
pose is predicted from the pair before, spots are searched in windows round the predicted LEDs.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from verify.core.fiducials import Marker
from verify.core.records import Array, Image, Measurement, Pose, Spots, StereoPair
from verify.core.rig import Camera, Rig
from verify.measurement.alignment import (
    MAX_GAP,
    AlignedSightings,
    RawSightings,
    align,
    raw_sightings,
)
from verify.measurement.appearance import MAX_VAGUE_PX, Appearance, likely_spots
from verify.measurement.correspondence.assign import (
    Correspondence,
    PosePrediction,
    assign_leds,
    track_leds,
)
from verify.measurement.detection.detect import detect
from verify.measurement.kernels.entries import ACCELERATION_PER_SPEED, MIN_ACCELERATION, led_boxes
from verify.measurement.pose import SightingStack, camera_rows, fit_stack, perturb
from verify.measurement.systematics import (
    Systematics,
    disparity_uncertainty,
    spot_columns,
    stated_systematics,
)

MARGIN_PX = 8.0  # about an LED in its window: for blur and halo, beside its diameter as stated
MIN_MOTION_PX = 0.3  # what clocks and lenses leave between two pictures of one instant
UNKNOWN_SPEED_PX = 500.0  # px/s: half a metre a second at a metre
# A hundred times the usual: the motion between the instants is so large that the pose is a guess,
# whatever uncertainty the acceleration's prior lends it.
MAX_REPROJECTION_PX = 2.0
MIN_DEPTH = 0.1  # m: nearer than any camera of this kind can focus
Detector = Callable[[StereoPair, Array | None, Array | None], tuple[Spots, Spots]]


def led_windows(
    marker: Marker, camera: Camera, pan: float, prediction: PosePrediction, image: Image
) -> Array:
    """Windows round the predicted LEDs, (n, 4) px: x0, y0, x1, y1, overlapping ones merged.

    `pan`, rad, is the reading of the camera's base; the prediction, of the flange's pose in the
    rig; `image`, the picture to be searched.
    """
    off = prediction.position_uncertainty, prediction.rotation_uncertainty
    return led_boxes(
        camera.camera_T_rig(pan) @ prediction.rig_T_flange,
        marker.leds,
        (camera.matrix, camera.distortion),
        (MARGIN_PX, marker.led_diameter, *off),
        (image.shape[1], image.shape[0]),
    )


def detect_in_turn(
    pair: StereoPair, left_windows: Array | None, right_windows: Array | None
) -> tuple[Spots, Spots]:
    """Find the spots of both pictures of a pair; windows (m, 4) px, None for the whole frame."""
    left = detect(pair.left, left_windows, lossy=pair.lossy[0])
    return left, detect(pair.right, right_windows, lossy=pair.lossy[1])


def warm_up(detector: Detector = detect_in_turn) -> None:
    """Load what measuring takes, in another process too, by a black picture."""
    black = np.zeros((64, 64), dtype=np.uint8)
    detector(StereoPair(0, 0.0, 0.0, 0.0, 0.0, black, black), None, None)


def no_expected_poses(_t: float) -> Sequence[Array]:
    """Candidate poses where there are no encoders: none."""
    return ()


@dataclass(frozen=True)
class Setup:
    """Constants of a measurement: rig, marker, and two functions that a mode may replace."""

    rig: Rig
    marker: Marker
    # candidates for rig_T_flange at a time (s), from the encoders: settles which LED is which
    # where nothing else does; a choice, never a value
    expected: Callable[[float], Sequence[Array]] = field(default=no_expected_poses)
    # finds the spots of both pictures; a faster replacement must find the same
    detect: Detector = field(default=detect_in_turn)

    @cached_property
    def parameters(self) -> Systematics:
        """What rig and marker state of their own uncertainty, pan angles included."""
        return stated_systematics(self.rig, self.marker, turning=True)

    @cached_property
    def reach(self) -> float:
        """How far the farthest LED is from the flange, m."""
        return float(np.max(np.linalg.norm(self.marker.leds, axis=1)))

    def __repr__(self) -> str:
        width, height = self.rig.image_size
        return f"<Setup: {width} x {height} px, {len(self.marker.leds)} LEDs>"


@dataclass(frozen=True, slots=True)
class _AssignedPair:
    """A pair after identification, each spot still at its own instant."""

    pair_t: float
    frame: int
    correspondence: Correspondence
    raw: RawSightings
    whole_frame: bool
    prediction: PosePrediction | None  # of all six degrees of freedom


# the pairs before and after, and the one before the former
Neighbours = tuple[_AssignedPair | None, _AssignedPair | None, _AssignedPair | None]


@dataclass(frozen=True, slots=True)
class _Memory:
    """What a pair is predicted from."""

    measurement: Measurement  # of the pair before
    pose: Pose
    appearance: Appearance


@dataclass(frozen=True, slots=True)
class _CausalPair:
    """A pair measured by the one before it; the next one's prediction and motion rest on it."""

    assigned: _AssignedPair
    kept: _AssignedPair  # without the spots that its pose rejects
    around: Neighbours
    measurement: Measurement
    memory: _Memory | None  # what the next pair is predicted from; None: nothing good


def measure(
    pairs: Iterable[StereoPair], setup: Setup, *, causal: bool = False
) -> Iterator[Measurement]:
    """Measure the flange's pose in each stereo pair: a settled measurement a pair, in order.

    Pairs are streamed in time order; two are held at most. `causal`: give each pair by those before
    it too, at once (`settled` is False). One is settled once its successor is there: both
    neighbours show its motion. A pair that cannot be measured has a status with the reason. The
    first pair, also after a gap, borrows the motion of its successor.
    """
    held: _AssignedPair | None = None  # the first pair of a burst, until its successor is there
    now: _CausalPair | None = None
    for pair in pairs:
        found = _find_leds(pair, setup, now.memory if now is not None else None)
        if held is not None:
            now, held = _measure_causally(held, (None, found, None), setup, None), None
            if causal:
                yield now.measurement
        then = now
        if then is None or _beyond_gap(found, then.kept):
            now, held = None, found
        else:
            now = _measure_causally(found, (then.kept, None, then.around[0]), setup, then.memory)
            if causal:
                yield now.measurement
        if then is not None:
            yield _settle(then, now, setup)
    if held is not None:
        now = _measure_causally(held, (None, None, None), setup, None)
        if causal:
            yield now.measurement
    if now is not None:
        yield _settle(now, None, setup)


def _beyond_gap(one: _AssignedPair, other: _AssignedPair) -> bool:
    return abs(one.pair_t - other.pair_t) > MAX_GAP


def _find_leds(pair: StereoPair, setup: Setup, memory: _Memory | None) -> _AssignedPair:
    """Find the spots and assign them to LEDs; in the whole frame where prediction fails."""
    prediction, least = _predict(memory, pair.t_left), np.zeros(2)
    if prediction is not None and memory is not None:
        least = memory.appearance.least_peaks
        rig, marker = setup.rig, setup.marker
        left = led_windows(marker, rig.left, pair.pan_left, prediction, pair.left)
        right = led_windows(marker, rig.right, pair.pan_right, prediction, pair.right)
        spots = setup.detect(pair, left, right)
        if (tracked := _track(pair, spots, setup, memory, prediction, least)) is not None:
            return tracked
        spots = _likely(spots, least)
        assigned = _assign(pair, spots, setup, memory, prediction, whole_frame=False)
        if _shows_all_leds(assigned, setup):
            return assigned
    spots = _likely(setup.detect(pair, None, None), least)
    # with an LED missing the prediction may follow a reflection: pictures that show the whole
    # marker elsewhere overrule it
    fresh = _assign(pair, spots, setup, memory, None, whole_frame=True)
    if prediction is None or _shows_all_leds(fresh, setup):
        return fresh
    return _assign(pair, spots, setup, memory, prediction, whole_frame=True)


def _likely(spots: tuple[Spots, Spots], least: Array) -> tuple[Spots, Spots]:
    """Keep the spots of both pictures that may be LEDs.

    `least` (2,), DN, peak of an LED in either picture, nan where it is not known.
    """
    return likely_spots(spots[0], least[0]), likely_spots(spots[1], least[1])


def _shows_all_leds(assigned: _AssignedPair, setup: Setup) -> bool:
    """Both pictures show the whole marker."""
    leds = assigned.correspondence.left_led, assigned.correspondence.right_led
    measured = assigned.correspondence.status == "measured"
    return measured and min(map(len, leds)) == len(setup.marker)


def _track(
    pair: StereoPair,
    spots: tuple[Spots, Spots],
    setup: Setup,
    memory: _Memory,
    prediction: PosePrediction,
    least: Array,
) -> _AssignedPair | None:
    """Identify LEDs by the prediction alone; None where that does not suffice."""
    tracked = track_leds(
        pair,
        spots,
        setup.rig,
        setup.marker,
        prediction,
        likely=(MAX_VAGUE_PX, least),
        motion_tolerance_px=_motion_px(pair, setup, memory),
    )
    if tracked is None:
        return None
    found, n = tracked.correspondence, len(setup.marker)
    raw = RawSightings(
        led=np.concatenate([found.left_led, found.right_led]),
        centre=tracked.centre,
        covariance=tracked.covariance,
        peak=tracked.peak,
        taken=tracked.taken,
        depth=tracked.depth,
        width=tracked.width,
        merged=np.zeros(2 * n, np.bool_),
        left=n,
        instants=(pair.t_left, pair.t_right),
        pans=(pair.pan_left, pair.pan_right),
    )
    raw, known = memory.appearance.widen_hidden(raw), _turn_known(memory, prediction)
    return _AssignedPair(pair.t_left, pair.frame, found, raw, False, known)


def _assign(
    pair: StereoPair,
    spots: tuple[Spots, Spots],
    setup: Setup,
    memory: _Memory | None,
    prediction: PosePrediction | None,
    *,
    whole_frame: bool,
) -> _AssignedPair:
    correspondence = assign_leds(
        spots,
        setup.rig,
        (pair.pan_left, pair.pan_right),
        setup.marker,
        prediction=prediction,
        expected=partial(setup.expected, pair.t_left),
        motion_tolerance_px=_motion_px(pair, setup, memory),
    )
    raw = _raw_sightings(pair, spots, setup, correspondence)
    if memory is not None:
        raw = memory.appearance.widen_hidden(raw)
    expected = _turn_known(memory, prediction)
    return _AssignedPair(pair.t_left, pair.frame, correspondence, raw, whole_frame, expected)


def _turn_known(memory: _Memory | None, prediction: PosePrediction | None) -> PosePrediction | None:
    """Give a prediction whose turn rests on spots; else it is a guess."""
    return prediction if memory is not None and memory.pose.known_dof == 6 else None


def _motion_px(pair: StereoPair, setup: Setup, memory: _Memory | None) -> float:
    """How far the LEDs may move between the two exposures of a pair."""
    skew = abs(pair.t_right - pair.t_left)
    if memory is None or pair.t_left - memory.measurement.t > MAX_GAP:
        return MIN_MOTION_PX + skew * UNKNOWN_SPEED_PX
    twist, pose = memory.pose.twist, memory.pose.rig_T_flange
    speed = _norm(twist[:3]) + setup.reach * _norm(twist[3:])
    focal = setup.rig.left.matrix.item(0, 0)
    depth = max(_norm(pose[:3, 3]), MIN_DEPTH)
    # twice the last speed: between two pairs an arm may as much as double it
    return MIN_MOTION_PX + 2 * skew * focal * speed / depth


def _raw_sightings(
    pair: StereoPair, spots: tuple[Spots, Spots], setup: Setup, correspondence: Correspondence
) -> RawSightings:
    """Both cameras' assigned spots, each at its own instant."""
    pans, rig, depths = (pair.pan_left, pair.pan_right), setup.rig, []
    for camera, pan, (led, _) in zip(
        (rig.left, rig.right), pans, correspondence.sides, strict=True
    ):
        if correspondence.rig_T_flange is None:
            depths.append(np.empty(0))
            continue
        ahead = camera.camera_T_rig(pan)[2] @ correspondence.rig_T_flange  # the optical axis
        depths.append(setup.marker.leds[led] @ ahead[:3] + ahead[3])
    taken = (pair.t_left, pair.t_right), pans, pair.left.shape[0]
    return raw_sightings(spots, correspondence.sides, rig, taken, (depths[0], depths[1]))


def _measure_causally(
    assigned: _AssignedPair, around: Neighbours, setup: Setup, memory: _Memory | None
) -> _CausalPair:
    """Measure a pair by the one before; the first of a burst by the one after."""
    measurement = _fit(assigned, (*around[:2], None), setup, settled=False)
    pose = measurement.pose
    kept = assigned
    if pose is not None and np.count_nonzero(pose.rejected):  # the next pair must not rest on them
        kept = replace(assigned, raw=assigned.raw.take(~pose.rejected))
    if pose is None or not pose.consistent:
        return _CausalPair(assigned, kept, around, measurement, None)
    before = Appearance.unknown(len(setup.marker)) if memory is None else memory.appearance
    now = _Memory(measurement, pose, before.after(kept.raw))
    return _CausalPair(assigned, kept, around, measurement, now)


def _settle(now: _CausalPair, after: _CausalPair | None, setup: Setup) -> Measurement:
    """Measure a pair by both its neighbours, and the pair before those."""
    causal = now.measurement
    moved = any(s is None or np.count_nonzero(s.lever) for s in (causal.left, causal.right))
    before, _, earlier = now.around
    if not moved or (after is None and earlier is None):
        return replace(causal, settled=True)
    return _fit(now.assigned, (before, after.kept if after else None, earlier), setup)


def _fit(
    assigned: _AssignedPair, around: Neighbours, setup: Setup, *, settled: bool = True
) -> Measurement:
    """Align a pair by its neighbours and fit the pose."""
    found = assigned.correspondence
    leds = len({*found.left_led.tolist(), *found.right_led.tolist()})
    result = partial(
        Measurement, assigned.frame, assigned.pair_t, leds_seen=leds, choice=found.choice,
        whole_frame=assigned.whole_frame, settled=settled,
    )  # fmt: skip
    if found.status != "measured" or found.rig_T_flange is None:
        return result(found.status)
    near = [p if p and not _beyond_gap(assigned, p) else None for p in around]
    seen = [p.raw if p else None for p in near]
    aligned = align(assigned.raw, seen, assigned.pair_t, setup.rig, alone=not any(near[:2]))
    if aligned is None:
        return result("unaligned")
    left, right = aligned.sides
    columns = partial(spot_columns, setup.parameters, setup.rig, setup.marker, left, right)
    where = assigned.prediction
    expected = None if where is None else (where.rig_T_flange, where.rotation_uncertainty)
    try:
        pose = fit_stack(
            _stack(aligned, setup), setup.rig, setup.marker, found.rig_T_flange, columns,
            expected=expected,
        )  # fmt: skip
    except np.linalg.LinAlgError:  # spots that contradict each other so much that no step is finite
        return result("outlier")
    bound = max(MAX_REPROJECTION_PX, 2 * disparity_uncertainty(setup.rig))
    good = pose.consistent and not pose.reprojection_rms_px > bound
    status = "measured" if good else "outlier"
    return result(status, pose=pose, left=left, right=right)


def _stack(aligned: AlignedSightings, setup: Setup) -> SightingStack:
    """Both cameras' sightings as the pose fit takes them."""
    raw, rig = aligned.raw, setup.rig
    return SightingStack(
        raw.led, setup.marker.leds[raw.led], aligned.centre, aligned.covariance, aligned.velocity,
        aligned.lever, camera_rows(rig.left, rig.right, *raw.pans), raw.left,
    )  # fmt: skip


def _predict(memory: _Memory | None, t: float) -> PosePrediction | None:
    """Predict the flange's pose from the last pose and its twist; None after a gap."""
    if memory is None:
        return None
    interval, pose = t - memory.measurement.t, memory.pose
    if interval > MAX_GAP:
        return None
    linear, angular = (
        ACCELERATION_PER_SPEED * _norm(part) + rough
        for part, rough in zip((pose.twist[:3], pose.twist[3:]), MIN_ACCELERATION, strict=True)
    )
    # the twist is that of half a pair ago, so the error is acceleration over interval², not half;
    # 1 mm and 0.01 rad for pairs taken while starting to move; two deviations of the pose itself
    variance = pose.covariance.diagonal().tolist()
    return PosePrediction(
        rig_T_flange=perturb(pose.rig_T_flange, pose.twist * interval),
        position_uncertainty=linear * interval**2 + 1e-3 + 2 * math.sqrt(sum(variance[:3])),
        rotation_uncertainty=angular * interval**2 + 0.01 + 2 * math.sqrt(sum(variance[3:])),
        choice=memory.measurement.choice,
    )


def _norm(vector: Array) -> float:
    """Length of three numbers; numpy's own way would let other threads in, for a wait."""
    return math.hypot(*vector.tolist())
