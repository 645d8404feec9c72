"""Register a robot from its own motion: its base in the rig, and its LEDs on the flange.

DH table and rig are held; base, LEDs, clock offset and the cameras' skew are adjusted together to
the pixels. What that hides of the robot's own joint errors is computed too (see `uncertainty`).
"""

from dataclasses import replace

import numpy as np

import robots
from verify.analysis.clock.estimate import MAX_UNCERTAINTY, MIN_SIGNAL_TO_NOISE
from verify.analysis.measured import refuse_time_unit
from verify.calibration.registration import refusals
from verify.calibration.registration.adjustment import AdjustedRegistration, AdjustmentSetup, adjust
from verify.calibration.registration.body_poses import BodyPose, body_poses
from verify.calibration.registration.led_tracks import (
    PairSpots,
    drop_still_spots,
    find_leds,
    find_spots,
)
from verify.calibration.registration.model import (
    RegistrationParameters,
    SpotStack,
    reading_variance,
    stack_spots,
)
from verify.calibration.registration.outcome import (
    FixedParameters,
    refuse_misplaced_led,
    registration_outcome,
)
from verify.calibration.registration.records import MotionRegistration, order_like_marker
from verify.calibration.registration.start import RegistrationStart, start_registration
from verify.core.fiducials import Marker
from verify.core.readings import RATE_SPAN, Readings
from verify.core.records import Array, Flags, Progress, no_progress
from verify.errors import InputError
from verify.io.session.session import Recording
from verify.measurement.triangulation import fit_rigid

MIN_PAIRS = 6  # three poses determine base and LEDs, as many check them
TYPICAL_DIAMETER = 5e-3  # m, of an LED, before its image is measured
# times the session's own misfit: a pair whose readings belong to another moment
MAX_MISFIT_RATIO = 30.0
POSE_ROWS = 6


def register_motion(
    recording: Recording,
    *,
    leds: int | None = None,
    marker: Marker | None = None,
    keep_base: bool = False,
    keep_leds: bool = False,
    progress: Progress = no_progress,
) -> MotionRegistration:
    """Register a robot from its own motion; the rig's robot base and the marker are not needed.

    `leds` says how many there are; None: as many as move together. The marker gives them names and
    colours; its positions count only if kept. `keep_base`: the rig's base stands as it is (from a
    fixture), the LEDs alone are fitted; `keep_leds`: the base alone. `progress` is called with
    pairs done and pairs in all.

    Rig and marker of the registration carry its id and, in the rig's covariance, all that is known
    of their uncertainty.

    Raises:
        InputError: no LEDs, no readings, or a motion that leaves something undetermined: says what,
            and which movement to add.
    """
    place = str(recording.folder)
    if leds is not None and marker is not None and leds != len(marker):
        given = f"is {leds}, and the known marker has {len(marker)} LEDs"
        raise InputError("--leds", given, "", "Leave it out.")
    held = _check_held(recording, marker, keep_base, keep_leds)
    pairs = find_spots(recording, progress)
    moving = drop_still_spots(pairs)
    body = find_leds(moving, recording.rig, leds if marker is None else len(marker), place)
    if marker is not None:
        body = order_like_marker(marker, body, place)
    body, poses = body_poses(moving, recording.rig, body, TYPICAL_DIAMETER)
    setup = _setup(recording)
    restart = _starter(recording, poses)
    start, at = _start_values(recording, poses, body, setup, held)
    left_out = _left_out(pairs, poses, start, setup.readings)
    poses = [pose for pose, good in zip(poses, start.good, strict=True) if good]
    free = np.ones(at.size, dtype=bool)
    free[:6], free[6:-2] = not held.base, held.leds is None
    free[-2] = setup.clock is not None or recording.clock is None
    adjusted = _adjust_observable(stack_spots(poses, recording.rig), setup, at, free)
    adjusted, wild = _reject_pairs(adjusted, setup)
    refusals.refuse_misfit(adjusted, recording.folder, start, setup.readings, restart)
    if held.leds is not None:
        refuse_misplaced_led(adjusted, held.leds)
    left_out |= dict.fromkeys(wild, "the readings contradict it")
    diameter = round(float(np.median([pose.diameter for pose in poses])), 4)
    outcome = registration_outcome(recording, held, adjusted, setup, start, diameter)
    return replace(outcome, left_out=dict(sorted(left_out.items())))


def _check_held(
    recording: Recording, marker: Marker | None, keep_base: bool, keep_leds: bool
) -> FixedParameters:
    if keep_base and keep_leds:
        raise InputError("--keep-base, --keep-leds", "nothing is left to register", "one of them")
    if keep_base and not recording.rig.registered:
        raise InputError(
            "--keep-base", "the rig has no [robot_base]", "",
            "Register the base by a fixture first, or fit it as well.",
        )  # fmt: skip
    if keep_leds and marker is None:
        raise InputError(
            "--keep-leds", "no marker.toml is given", "", "Give it with --known-marker."
        )
    return FixedParameters(marker, keep_base, marker if keep_leds else None)


def _setup(recording: Recording) -> AdjustmentSetup:
    readings, clock = Readings.of_log(recording.encoders.t, recording.encoders.q), recording.clock
    stated = None
    if clock is not None and clock.standard_uncertainty:
        stated = (clock.encoder_offset, clock.standard_uncertainty)
    return AdjustmentSetup(
        rig=recording.rig,
        arm=recording.arm,
        readings=readings,
        variance=reading_variance(readings, recording.encoder_resolution),
        time_variance=(recording.encoder_time_standard_uncertainty or 0.0) ** 2,
        clock=stated,
    )


def _start_values(
    recording: Recording,
    poses: list[BodyPose],
    body: Array,
    setup: AdjustmentSetup,
    held: FixedParameters,
) -> tuple[RegistrationStart, RegistrationParameters]:
    """Find start values by the pairs that have both pose and reading."""
    place, readings = str(recording.folder), setup.readings
    if len(poses) < MIN_PAIRS:
        found = f"{len(poses)} pairs show three LEDs or more in both images"
        raise InputError(place, found, f"{MIN_PAIRS} at least", "Record more of them.")
    t = np.array([one.spots.t[0] for one in poses])
    known = {
        "x": None if held.leds is None else fit_rigid(body, held.leds.leds),  # body_T_flange
        "y": recording.rig.rig_T_base if held.base else None,
    }
    refuse_time_unit(recording.folder, t, readings.t)
    try:
        start = _starter(recording, poses, **known)(readings)
    except ValueError as error:
        raise InputError(
            recording.folder / "encoders.csv",
            f"too few of the {len(poses)} pairs with LEDs have a reading",
            f"{MIN_PAIRS} at least",
            "Check that clock and recording belong together.",
        ) from error
    if not held.base and held.leds is None:
        refusals.refuse_other_robot(
            start, recording.folder, recording.robot, readings, _starter(recording, poses)
        )
        q = readings.at(t[start.good] - start.clock)
        refusals.refuse_undetermined(recording.arm, q, _noise(poses, q, setup), place)
    flange_T_body = np.linalg.inv(start.solved.x)
    leds = body @ flange_T_body[:3, :3].T + flange_T_body[:3, 3]
    if held.leds is not None:
        leds = held.leds.leds
    return start, RegistrationParameters(start.solved.y, leds, start.clock, 0.0)


def _starter(
    recording: Recording, poses: list[BodyPose], **known: Array | None
) -> refusals.Restart:
    """Give the start values with any readings; `known` as start_registration has them."""
    t = np.array([one.spots.t[0] for one in poses])
    measured = np.array([one.pose.rig_T_flange for one in poses])
    given = None if recording.clock is None else recording.clock.encoder_offset
    return lambda q: start_registration(t, measured, recording.arm, q, given, **known)


def _left_out(
    pairs: list[PairSpots], poses: list[BodyPose], start: RegistrationStart, readings: Readings
) -> dict[int, str]:
    """Why pairs do not count, by frame."""
    frames = {one.spots.frame for one in poses}
    reasons = {p.frame: "too few LEDs identified" for p in pairs if p.frame not in frames}
    for one, good in zip(poses, start.good, strict=True):
        if not good:
            read = readings.available(np.array([one.spots.t[0] - start.clock]))[0]
            reasons[one.spots.frame] = "its pose is wrong" if read else "no reading"
    return reasons


def _noise(poses: list[BodyPose], q: Array, setup: AdjustmentSetup) -> tuple[float, float]:
    """Standard uncertainty of a pair's pose from pixels and readings: m, rad."""
    pixels = np.median([np.diag(one.pose.covariance) for one in poses], axis=0)
    jacobian = robots.jacobian(setup.arm, q)
    moved = np.median(np.einsum("nij,j->ni", jacobian**2, setup.variance), axis=0)
    total = pixels + moved
    return float(np.sqrt(total[:3].mean())), float(np.sqrt(total[3:].mean()))


def _adjust_observable(
    spotted: SpotStack, setup: AdjustmentSetup, at: RegistrationParameters, free: Flags
) -> AdjustedRegistration:
    """Adjust with clock and skew free, then hold those that the motion does not determine."""
    adjusted = adjust(spotted, setup, at, free)
    still = free.copy()
    rate = setup.variance / (2 * RATE_SPAN**2)  # what the readings' noise does to speeds
    by_noise = float(np.sum(adjusted.rows.joints**2, axis=0) @ rate)
    for which, share in ((-2, 1.0), (-1, 0.5)):  # half of the spots are the right camera's
        variance = adjusted.inverse[which, which]
        stated = which == -2 and setup.clock is not None
        shown = variance * MIN_SIGNAL_TO_NOISE * share * by_noise < 1 if variance > 0 else False
        known = 0 < adjusted.covariance[which, which] < MAX_UNCERTAINTY**2
        still[which] &= stated or bool(shown and known)
    if (still == free).all():
        return adjusted
    back = replace(
        adjusted.at,
        clock=adjusted.at.clock if still[-2] else at.clock,
        skew=adjusted.at.skew if still[-1] else 0.0,
    )
    return adjust(adjusted.spotted, setup, back, still)


def _reject_pairs(
    adjusted: AdjustedRegistration, setup: AdjustmentSetup
) -> tuple[AdjustedRegistration, list[int]]:
    """Leave out pairs whose pose is farther from the readings' than noise explains.

    Adjusts again without them until no pair is: the first fit bends towards what is wrong.
    """
    rejected: list[int] = []
    while True:
        rows, spotted = adjusted.rows, adjusted.spotted
        size = np.zeros(len(spotted))
        np.add.at(size, rows.pair[rows.pose], rows.residual[rows.pose] ** 2)
        used = np.unique(spotted.pair[spotted.used])
        wild = size > MAX_MISFIT_RATIO * max(float(np.median(size[used])), POSE_ROWS)
        if not wild.any():
            return adjusted, rejected
        rejected += spotted.frame[wild].tolist()
        spotted = replace(spotted, used=spotted.used & ~wild[spotted.pair])
        adjusted = adjust(spotted, setup, adjusted.at, adjusted.free)
