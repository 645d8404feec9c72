"""Sessions at spot level for the diagnosis: pictures are measured once, then faults are put in.

True LEDs are projected by OpenCV (in verify.simulation) into a true rig drawn about the stated
one, and given noise. A fault of a joint or of the clock changes the readings; one of the arm, the
base or the LED body changes what the poses show; one of the cameras is measured anew.
"""

from dataclasses import dataclass, replace

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

import robots
from robots.transforms import invert
from tests.support.leds.truth import led_images, true_spots
from tests.support.random_scenarios import random_scenario
from tests.support.simulated import InMemory, in_memory, measured_at_spots
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.comparison import compare, solve_joints
from verify.analysis.diagnosis.diagnose import Diagnosis
from verify.analysis.joint_errors import ResolvedErrors
from verify.analysis.model import JointErrorModel, SessionComparison, add_pan_noise
from verify.analysis.session import session_model
from verify.core.readings import Readings
from verify.core.records import Array, Measurement
from verify.errors import InputError
from verify.measurement.systematics import Systematics, sensitivities, stated_systematics
from verify.measurement.track import Track, collect_track
from verify.simulation.scenario import (
    MultiJoint,
    ScenarioFault,
    ScenarioRecording,
    ScenarioUncertainty,
)
from verify.simulation.session.simulate import reading_error
from verify.simulation.world.bench import rigid

ARMS = ("iust_6r", "rv_3sd_melfa")
PAIRS = 60
WIDE = 2.0  # times the swings of a plain session
ATTEMPTS = 50
STATED = ScenarioUncertainty(
    focal_px=0.2, principal_point_px=0.2, camera_rotation_deg=0.005, base_position_mm=0.1,
    base_rotation_deg=0.01, led_body_mm=0.03, led_body_deg=0.02, led_mm=0.02,
)  # fmt: skip


@dataclass(frozen=True)
class Injected:
    """One fault, in SI units, as the diagnosis would tell it."""

    kind: str
    joint: int | None
    size: float
    parameter: str | None = None
    per_turn: int = 1
    phase: float = 0.0
    begin: float = 0.0  # s, cameras' clock, of a step


@dataclass(frozen=True)
class Watched:
    """A session whose poses are measured, and what its user knows."""

    session: InMemory
    measurements: tuple[Measurement, ...]
    systematics: Systematics
    clock: ClockEstimate
    noise: int  # seed of the spots' noise


def watched(seed: int) -> Watched:
    """Draw a session: one of the arms, swings plain or wide, registered by itself or by fixture."""
    rng = np.random.default_rng(seed)
    arm, wide = ARMS[int(rng.integers(2))], rng.random() < 0.5
    for _ in range(ATTEMPTS):
        scenario = random_scenario(rng, arm, leds=int(rng.integers(3, 6)), pairs=PAIRS)
        motion, rig = scenario.motion, scenario.rig
        assert isinstance(motion, MultiJoint)
        if wide:
            swings = [WIDE * a for a in motion.amplitude_deg]
            motion = msgspec.structs.replace(motion, amplitude_deg=swings)
            rig = msgspec.structs.replace(rig, bases="follow")
        recording = ScenarioRecording(pairs=PAIRS, rate_hz=float(rng.choice([5.0, 10.0])))
        scenario = msgspec.structs.replace(
            scenario, motion=motion, rig=rig, uncertainty=STATED, recording=recording
        )
        try:
            session = in_memory(scenario)
        except InputError:  # outside the limits, or nowhere to look from
            continue
        if any(np.isnan(true_spots(session.simulated, side)).any() for side in (0, 1)):
            continue
        break
    else:
        raise RuntimeError(f"{ATTEMPTS} sessions of {arm} drawn, none of them in view")
    if rng.random() < 0.3:
        rig = replace(session.rig, base_source="motion")
        session = replace(session, rig=rig, marker=replace(session.marker, source="motion"))
    output = session.simulated.scenario.encoders.clock_offset_s
    given = rng.random() < 0.5
    clock = ClockEstimate(
        output, None if given else 1e-4, "given" if given else "estimated", np.zeros((0, 2))
    )
    systematics = stated_systematics(session.rig, session.marker, turning=False)
    noise = int(rng.integers(2**31))
    return Watched(session, measured(session, systematics, noise), systematics, clock, noise)


def measured(
    session: InMemory, systematics: Systematics, noise: int, skew: float = 0.0, turned: float = 0.0
) -> tuple[Measurement, ...]:
    """Poses from true spots with white noise; the right camera is late by `skew`, and turned."""
    rng, played = np.random.default_rng(noise), session.simulated
    late = replace(
        played,
        t=played.t + np.array([0.0, skew]),
        true_pan=played.true_pan + np.array([0.0, turned]),
    )
    spots = [true_spots(late, side) for side in (0, 1)]
    return tuple(measured_at_spots(session, systematics, rng, spots=spots))


def camera_creeps(session: InMemory, side: int, way: str, angles: Array) -> list[Array]:
    """Images of the LEDs, a side each, of pairs at which one camera stands turned by `angles`, rad.

    About its pan axis (way `pan`), or about the x axis of its pictures (`tilt`).
    """
    played, seen = session.simulated, []
    bench = played.world.bench
    camera, spots = bench.cameras[side], [true_spots(played, each) for each in (0, 1)]
    instants = zip(played.t[:, side], played.true_pan[:, side], angles, strict=True)
    for t, pan, angle in instants:
        turn = rigid(np.array([angle * (way == "tilt"), 0.0, 0.0]), np.zeros(3))
        turned = replace(camera, turntable_T_camera=camera.turntable_T_camera @ turn)
        both = (bench.cameras[0], turned) if side else (turned, bench.cameras[1])
        world = replace(played.world, bench=replace(bench, cameras=both))
        seen.append(led_images(world, side, t, pan + angle * (way == "pan")))
    spots[side] = np.array(seen)
    return spots


def _tracked(watched: Watched, found: tuple[Measurement, ...]) -> Track:
    session = watched.session
    effects = [sensitivities(watched.systematics, m, session.rig, session.marker) for m in found]
    return collect_track(list(found), session.rig, effects)


def judged(
    watched: Watched, fault: Injected | None
) -> tuple[JointErrorModel, Diagnosis, ResolvedErrors]:
    """Judge a session with a fault in it, by the steps of a run."""
    session, clock = watched.session, watched.clock
    found, track = _seen(watched, fault)
    readings = _read(watched, fault)
    comparison = compare(track, session.arm, readings, clock.offset)
    comparison = add_pan_noise(comparison, track, watched.systematics)
    joints = solve_joints(comparison, session.arm)
    compared = SessionComparison(
        session, track, watched.systematics, clock, comparison, joints, found
    )
    return session_model(compared)


def _read(watched: Watched, fault: Injected | None) -> Readings:
    """The readings with a fault of a joint or of the clock."""
    encoders, played = watched.session.encoders, watched.session.simulated
    t, q = encoders.t, encoders.q
    if fault is None:
        return Readings(t, q)
    if fault.kind == "clock":
        return Readings(t - fault.size, q)
    start = played.t[0, 0]
    true_t = t + played.scenario.encoders.clock_offset_s
    if fault.kind == "clock_drift":
        return Readings(t - fault.size * (true_t - start), q)
    if fault.joint is None or fault.kind == "dh":
        return Readings(t, q)
    true = played.world.joints(true_t)
    return Readings(t, q + _reading_error(watched, fault, true, true_t, start))


def _reading_error(
    watched: Watched, fault: Injected, true: Array, true_t: Array, start: float
) -> Array:
    assert fault.joint is not None
    j, error = fault.joint - 1, np.zeros_like(true)
    if fault.kind == "compliance":
        error[:, j] = fault.size * robots.jacobian(watched.session.arm, true)[:, 2, j]
        return error
    if fault.kind == "latency":
        then = watched.session.simulated.world.joints(true_t - fault.size)
        error[:, j] = then[:, j] - true[:, j]
        return error
    if fault.kind == "drift":
        error[:, j] = fault.size * (true_t - start)
        return error
    degrees = float(np.degrees(fault.size))
    wrong = {
        "offset": ScenarioFault(joint=fault.joint, offset_deg=degrees),
        "gain": ScenarioFault(joint=fault.joint, gain=fault.size),
        "backlash": ScenarioFault(joint=fault.joint, backlash_deg=degrees),
        "eccentricity": ScenarioFault(
            joint=fault.joint,
            eccentricity_deg=abs(degrees),
            phase_deg=float(np.degrees(fault.phase)),
            per_turn=fault.per_turn,
        ),
        "step": ScenarioFault(joint=fault.joint, step_deg=degrees, step_t_s=fault.begin),
    }[fault.kind]
    direction = watched.session.simulated.world.motion.direction(true_t)
    return reading_error(true_t, true, direction, [wrong])


def _seen(watched: Watched, fault: Injected | None) -> tuple[tuple[Measurement, ...], Track]:
    """The pairs and their poses with a fault of the arm, its base, the LED body or a camera."""
    session, found = watched.session, watched.measurements
    changes = {"camera_skew": "skew", "camera_turned": "turned"}
    if fault is not None and fault.kind == "camera_drift":
        side, _, way = (fault.parameter or "right pan").partition(" ")
        t, rng = session.frames.t_left, np.random.default_rng(watched.noise)
        angles = fault.size * (t - t[0]) / (t[-1] - t[0])
        spots = camera_creeps(session, ("left", "right").index(side), way, angles)
        found = tuple(measured_at_spots(session, watched.systematics, rng, spots=spots))
    elif fault is not None and fault.kind in changes:
        change = {changes[fault.kind]: fault.size}
        found = measured(session, watched.systematics, watched.noise, **change)
    track = _tracked(watched, found)
    if fault is None:
        return found, track
    pose = track.base_T_flange
    if fault.kind == "dh":
        pose = (
            pose
            @ invert(robots.forward(session.arm, session.truth))
            @ robots.forward(_bent(session.arm, fault), session.truth)
        )
    elif fault.kind == "base_moved":
        pose = _displaced(fault) @ pose
    elif fault.kind == "base_drift":
        shares = (track.t - track.t[0]) / (track.t[-1] - track.t[0])
        moved = [_displaced(replace(fault, size=share * fault.size)) for share in shares.tolist()]
        pose = np.array(moved) @ pose
    elif fault.kind == "led_body_slipped":
        pose = pose @ _displaced(fault)
    return found, replace(track, base_T_flange=pose)


def _bent(arm: robots.Arm, fault: Injected) -> robots.Arm:
    assert isinstance(arm, robots.DhArm)
    assert fault.joint is not None
    key = fault.parameter.rstrip("123456")
    column = getattr(arm, key).copy()
    column[fault.joint - 1] += fault.size
    return replace(arm, **{key: column})


def _displaced(fault: Injected) -> Array:
    """A displacement along or about one axis, x to rz."""
    motion = np.eye(4)
    way = ("x", "y", "z", "rx", "ry", "rz").index(fault.parameter or "x")
    if way < 3:
        motion[way, 3] = fault.size
    else:
        motion[:3, :3] = Rotation.from_rotvec(fault.size * np.eye(3)[way - 3]).as_matrix()
    return motion
