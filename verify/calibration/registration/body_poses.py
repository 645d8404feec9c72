"""Fit the LED body's pose in the rig, pair by pair, before anything is known of the robot."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robots.transforms import difference, rigid_columns
from verify.calibration.registration.led_tracks import PairSpots, max_motion_px
from verify.core.fiducials import Marker, unnamed_marker
from verify.core.records import Array, Pose, Sighting
from verify.core.rig import Rig
from verify.measurement.alignment import MAX_GAP, RawSightings, align, raw_sightings
from verify.measurement.correspondence.assign import Correspondence, PosePrediction, assign_leds
from verify.measurement.pose import fit_pose, perturb

# How far a prediction over an interval (s) may be off: an arm's acceleration, and a body that is
# known to a millimetre.
PRIOR_ACCELERATION = (1.0, 6.0)  # m/s², rad/s²
MIN_PREDICTION_SIGMA = (3e-3, 0.03)  # m, rad
MAX_ROUNDS = 4  # of pose and body in turn
TOL_BODY = 2e-5  # m: a tenth of what identification allows an LED
START_LED_SIGMA = 1e-3  # m, one deviation of an LED's place while the body is rough
REFINED_LED_SIGMA = 3e-4  # m, and once it is refined


@dataclass(frozen=True, slots=True)
class BodyPose:
    """One pair with its LEDs assigned."""

    spots: PairSpots
    raw: RawSightings
    aligned: tuple[Sighting, Sighting]  # at the left camera's instant
    pose: Pose  # of the body, "flange" meaning the body's own frame
    diameter: float  # m, of an LED, by the width of its image


def body_poses(
    pairs: Sequence[PairSpots], rig: Rig, leds: Array, diameter: float
) -> tuple[Array, list[BodyPose]]:
    """Assign spots to LEDs in every pair, and refine the LEDs' places in the body.

    LEDs (n, 3), m, are known to about a millimetre, their diameter in m. Returns the LEDs, refined,
    and the pairs in which three or more are assigned and give a pose.
    """
    rough = leds
    assigned = _assign_leds(pairs, rig, unnamed_marker(leds, diameter, START_LED_SIGMA))
    for _ in range(MAX_ROUNDS):
        poses = _fit_poses(assigned, rig, unnamed_marker(leds, diameter, REFINED_LED_SIGMA))
        better = _refine_leds(leds, poses)
        moved, leds = float(np.abs(better - leds).max()), better
        if moved < TOL_BODY:
            break
    marker = unnamed_marker(leds, diameter, REFINED_LED_SIGMA)
    if np.abs(leds - rough).max() > START_LED_SIGMA:  # LEDs may have been overlooked
        assigned = _assign_leds(pairs, rig, marker)
    return leds, _fit_poses(assigned, rig, marker)


AssignedPair = tuple[PairSpots, Correspondence, RawSightings]


def _assign_leds(pairs: Sequence[PairSpots], rig: Rig, marker: Marker) -> list[AssignedPair]:
    """Assign spots to LEDs in every pair, with the one before as a prediction."""
    found: list[AssignedPair] = []
    memory: tuple[float, Array, Array] | None = None  # t, pose, twist
    for now in pairs:
        prediction = None if memory is None else _predict(memory, now.t[0])
        identified = assign_leds(
            now.spots, rig, now.pan, marker,
            prediction=prediction, motion_tolerance_px=max_motion_px(now),
        )  # fmt: skip
        if identified.status != "measured" or identified.rig_T_flange is None:
            memory = None
            continue
        pose, twist = identified.rig_T_flange, np.zeros(6)
        if memory is not None and now.t[0] - memory[0] <= MAX_GAP:
            twist = difference(pose, memory[1]) / (now.t[0] - memory[0])
        memory = (now.t[0], pose, twist)
        found.append((now, identified, _raw(now, identified, rig)))
    return found


def _fit_poses(assigned: list[AssignedPair], rig: Rig, marker: Marker) -> list[BodyPose]:
    """Align every pair and fit its pose; pairs that leave one open stay out."""
    return [fit for i in range(len(assigned)) if (fit := _pose(i, assigned, rig, marker))]


def _predict(memory: tuple[float, Array, Array], t: float) -> PosePrediction | None:
    interval = t - memory[0]
    if interval > MAX_GAP:
        return None
    return PosePrediction(
        rig_T_flange=perturb(memory[1], memory[2] * interval),
        position_uncertainty=PRIOR_ACCELERATION[0] * interval**2 + MIN_PREDICTION_SIGMA[0],
        rotation_uncertainty=PRIOR_ACCELERATION[1] * interval**2 + MIN_PREDICTION_SIGMA[1],
    )


def _raw(now: PairSpots, found: Correspondence, rig: Rig) -> RawSightings:
    assert found.rig_T_flange is not None
    depths = []  # rough: for bases that turn between two pairs
    for camera, pan, (led, _) in zip((rig.left, rig.right), now.pan, found.sides, strict=True):
        camera_T_rig = camera.camera_T_rig(pan)
        ahead = camera_T_rig[2, :3] @ found.rig_T_flange[:3, 3] + camera_T_rig[2, 3]
        depths.append(np.full(len(led), ahead))
    taken = now.t, now.pan, now.height
    return raw_sightings(now.spots, found.sides, rig, taken, (depths[0], depths[1]))


def _pose(i: int, found: list[AssignedPair], rig: Rig, marker: Marker) -> BodyPose | None:
    """Bring a pair's right image to the left one's instant and fit the body's pose."""
    now, identified, raw = found[i]
    around = [
        found[k][2] if 0 <= k < len(found) and abs(found[k][0].t[0] - now.t[0]) <= MAX_GAP else None
        for k in (i - 1, i + 1, i - 2)
    ]
    aligned = align(raw, around, now.t[0], rig, alone=all(one is None for one in around))
    if aligned is None or identified.rig_T_flange is None:
        return None
    left, right = aligned.sides
    pose = fit_pose(left, right, rig, marker, identified.rig_T_flange)
    if pose.known_dof < 6 or not pose.consistent:
        return None
    width = np.median(now.spots[0].diameter[identified.left_spot])
    depth = float(np.median(raw.depth[: raw.left]))
    diameter = float(width) * depth / float(rig.left.matrix[0, 0])
    return BodyPose(now, raw, (left, right), pose, diameter)


def _refine_leds(leds: Array, poses: list[BodyPose]) -> Array:
    """Move the LEDs to their mean places over the pairs, by the pixels' own residuals."""
    n = len(leds)
    information, wanted = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    for pair in poses:
        led = np.concatenate([pair.aligned[0].led, pair.aligned[1].led])
        keep = ~pair.pose.rejected
        by_led = np.zeros((len(led), 2, 3 * n))
        turned = pair.pose.sensitivity @ pair.pose.rig_T_flange[:3, :3]
        for s, k in enumerate(led.tolist()):
            by_led[s, :, 3 * k : 3 * k + 3] = turned[s]
        rows, residual = by_led[keep].reshape(-1, 3 * n), pair.pose.residual[keep].reshape(-1)
        # a motion of the whole body does not change its shape
        offset = leds[led] @ pair.pose.rig_T_flange[:3, :3].T
        by_pose = (pair.pose.sensitivity @ rigid_columns(offset))[keep].reshape(-1, 6)
        basis = np.linalg.qr(by_pose)[0]
        rows = rows - basis @ (basis.T @ rows)
        information += rows.T @ rows
        wanted += rows.T @ residual
    values, vectors = np.linalg.eigh(information)
    known = values > 1e-9 * values[-1]  # the body's own frame is a gauge
    step = vectors[:, known] @ ((vectors[:, known].T @ wanted) / values[known])
    return np.asarray(leds + step.reshape(n, 3))
