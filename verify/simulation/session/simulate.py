"""A simulated session: world, pictures, readings with encoder faults, stated rig and marker."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

import robots
from verify.core.fiducials import Marker
from verify.core.records import Array, Image
from verify.core.rig import Rig
from verify.errors import InputError
from verify.planning.proposal import stated_covariance
from verify.simulation.scenario import Scenario, ScenarioFault, ScenarioUncertainty
from verify.simulation.world import uncertainty
from verify.simulation.world.bench import build_bench, place_rig
from verify.simulation.world.led_render import Renderer, hidden_leds, visible_lights
from verify.simulation.world.motion import RandomStream, generator, plan_motion
from verify.simulation.world.world import SimulatedWorld


def reading_error(t: Array, q: Array, direction: Array, faults: Sequence[ScenarioFault]) -> Array:
    """Reading less true angle: offset + gain q + backlash/2 d + ecc cos(n (q - phase)) + step.

    In rad, (..., joints), at t (...,), s, cameras' clock, by the true angles q, rad, in the robot
    file's zero and the last direction of travel, +1 or -1, kept at rest; a joint may have several
    faults.
    """
    error = np.zeros_like(q)
    for fault in faults:
        k = fault.joint - 1
        turn = fault.per_turn * (q[..., k] - np.radians(fault.phase_deg))
        error[..., k] += (
            np.radians(fault.offset_deg)
            + fault.gain * q[..., k]
            + np.radians(fault.backlash_deg) / 2 * direction[..., k]
            + np.radians(fault.eccentricity_deg) * np.cos(turn)
            + np.radians(fault.step_deg) * (t >= fault.step_t_s)
        )
    return error


START_OFFSET = 1.0  # s, the first pair: the encoders' record begins before it
# s of encoder readings on either side of every pair; motions have no gaps by that
READING_MARGIN = 0.6
TIME_STEP = 1e-6  # s, the grain of written times; the world uses the written ones


@dataclass(frozen=True, slots=True)
class SimulatedSession:
    """One session with its truth; pictures are rendered when asked for, the same every time."""

    scenario: Scenario
    world: SimulatedWorld
    rig: Rig  # what the user believes
    marker: Marker
    t: Array  # (pairs, 2), s, cameras' clock: left, right
    pan: Array  # (pairs, 2), rad, as read
    true_pan: Array  # (pairs, 2), rad
    taken: Array  # (pairs,) int: the pair's number before any was dropped
    encoder_t: Array  # (readings,), s, the controller's clock
    encoder_q: Array  # (readings, joints), rad
    clock_offset: float | None  # s, as session.toml states it
    renderers: tuple[Renderer, Renderer]

    def __len__(self) -> int:
        """Count the pairs."""
        return len(self.t)

    @property
    def truth(self) -> Array:
        """True joint angles at each pair's left time, (pairs, joints), rad."""
        return self.world.joints(self.t[:, 0])

    def image(self, side: int, index: int) -> Image:
        """Render one picture of the left (0) or right (1) camera."""
        names = [led.name for led in self.scenario.marker.led]
        number = int(self.taken[index])
        t, pan = float(self.t[index, side]), float(self.true_pan[index, side])
        hidden = hidden_leds(self.scenario.occlusion, names, side, number)
        lights = visible_lights(self.world, side, t, pan, hidden)
        turned_px = pan * self.world.bench.cameras[side].matrix[0, 0]
        return self.renderers[side].render(lights, number, turned_px)


def simulate_session(scenario: Scenario) -> SimulatedSession:
    """Play a scenario.

    Raises:
        InputError: the scenario contradicts itself or its robot, or no placement shows the LEDs.
        robots.RobotError: the robot is not known or its file is at fault.
    """
    arm = robots.load(scenario.robot)
    _check(scenario, arm)
    scheduled = _exposure_times(scenario)
    motion = plan_motion(scenario, START_OFFSET, float(scheduled[-1, 0]))
    _check_limits(scenario, arm, motion.angles(scheduled[:, 0]))
    kept = np.setdiff1d(np.arange(len(scheduled)), scenario.recording.dropped)

    in_base = SimulatedWorld(
        arm,
        motion,
        build_bench(scenario, np.eye(4)),
        tuple(scenario.marker.led),
        scenario.marker.led_diameter_mm / 1000,
        tuple(scenario.mirror),
        tuple(scenario.distractor),
    )
    rig_T_base, pan = place_rig(
        scenario, in_base.led_points(scheduled[:, 0]), in_base.led_normals(scheduled[:, 0])
    )
    believed = build_bench(scenario, rig_T_base)

    stated = scenario.uncertainty or ScenarioUncertainty()
    drawn = stated if stated.draw else ScenarioUncertainty()
    rng = generator(scenario.seed, RandomStream.SYSTEMATIC)
    departure = uncertainty.draw_departure(drawn, len(believed.leds), rng)
    world: SimulatedWorld = replace(in_base, bench=uncertainty.apply_departure(believed, departure))
    true_pan = pan + departure.pan
    if scenario.rig.bases == "follow":  # each reading errs by itself, the same one always alike
        rng = generator(scenario.seed, RandomStream.PAN)
        error = np.radians(drawn.pan_deg) * rng.standard_normal(pan.shape)
        for side in range(2):
            _, first, again = np.unique(pan[:, side], return_index=True, return_inverse=True)
            error[:, side] = error[first, side][again]
        true_pan = pan + error

    encoder_t, encoder_q = _encoders(scenario, world, scheduled)
    size, seed = scenario.rig.image_size, scenario.seed
    return SimulatedSession(
        scenario=scenario,
        world=world,
        rig=Rig(
            size,
            *uncertainty.stated_cameras(believed.cameras, pan[0], stated.pan_deg),
            believed.rig_T_base,
            covariance=stated_covariance(msgspec.structs.asdict(stated)),
        ),
        marker=_stated_marker(scenario, stated, believed.leds),
        t=scheduled[kept],
        pan=pan[kept],
        true_pan=true_pan[kept],
        taken=kept,
        encoder_t=encoder_t,
        encoder_q=encoder_q,
        clock_offset=_stated_offset(scenario),
        renderers=(
            Renderer(scenario.image, size, seed, 0),
            Renderer(scenario.image, size, seed, 1),
        ),
    )


def _exposure_times(scenario: Scenario) -> Array:
    """When the cameras fire, (pairs, 2), s, in whole microseconds."""
    recording = scenario.recording
    rng = generator(scenario.seed, RandomStream.TIMES)
    left = START_OFFSET + np.arange(recording.pairs) / recording.rate_hz
    jitter = recording.skew_jitter_s * rng.standard_normal(recording.pairs)
    times: Array = (
        np.round(np.stack([left, left + recording.skew_s + jitter], 1) / TIME_STEP) * TIME_STEP
    )
    if np.any(np.diff(times, axis=0) <= 0):
        raise InputError(
            "recording.skew_jitter_s", "pairs overtake one another", "less than a frame's time"
        )
    return times


def _encoders(scenario: Scenario, world: SimulatedWorld, frames: Array) -> tuple[Array, Array]:
    """Read the joints at the controller's pace, around the pairs: (m,) s and (m, joints) rad.

    The controller's clock shows t - offset - drift · t at the cameras' time t.
    """
    table = scenario.encoders
    drift = 1 - table.clock_drift_ppm * 1e-6
    ticks: list[Array] = []
    for first, last in _reading_intervals(frames):
        shown = (np.array([first, last]) * drift - table.clock_offset_s) * table.rate_hz
        ticks.append(np.arange(np.ceil(shown[0]), np.floor(shown[1]) + 1))
    stamps = np.round(np.concatenate(ticks) / table.rate_hz / TIME_STEP) * TIME_STEP
    t = (stamps + table.clock_offset_s) / drift
    q = noisy_readings(scenario, world, t, generator(scenario.seed, RandomStream.ENCODERS))
    return stamps, quantised(q, table.resolution_deg)


def noisy_readings(
    scenario: Scenario, world: SimulatedWorld, t: Array, rng: np.random.Generator
) -> Array:
    """Read the encoders at the cameras' instants t (n,), faults and noise included.

    Returns (n, joints), rad, before any rounding to the encoders' resolution.
    """
    q = world.joints(t)
    q = q + reading_error(t, q, world.motion.direction(t), scenario.fault)
    q += np.radians(scenario.encoders.noise_deg) * rng.standard_normal(q.shape)
    return q


def quantised(q: Array, resolution_deg: float) -> Array:
    """Round angles, rad, to whole steps of the encoders; 0 leaves them as they are."""
    step = np.radians(resolution_deg)
    return np.round(q / step) * step if resolution_deg > 0 else q


def _reading_intervals(frames: Array) -> list[tuple[float, float]]:
    """Join the times around the pairs where they overlap: begin and end of each stretch, s."""
    begin, end = frames.min(axis=1) - READING_MARGIN, frames.max(axis=1) + READING_MARGIN
    gap = np.flatnonzero(begin[1:] > end[:-1])
    first = np.concatenate([[0], gap + 1])
    last = np.concatenate([gap, [len(frames) - 1]])
    return list(zip(begin[first].tolist(), end[last].tolist(), strict=True))


def _stated_offset(scenario: Scenario) -> float | None:
    if scenario.clock is None:
        return None
    u = scenario.clock.encoder_offset_standard_uncertainty_s
    rng = generator(scenario.seed, RandomStream.CLOCK)
    return float(scenario.encoders.clock_offset_s + u * rng.standard_normal())


def _stated_marker(scenario: Scenario, stated: ScenarioUncertainty, leds: Array) -> Marker:
    body = np.repeat([stated.led_body_mm / 1000, float(np.radians(stated.led_body_deg))], 3)
    return Marker(
        names=tuple(led.name for led in scenario.marker.led),
        leds=leds,
        colours=tuple(led.colour for led in scenario.marker.led),
        led_diameter=scenario.marker.led_diameter_mm / 1000,
        source="jig" if np.any(body) else None,
        body_standard_uncertainty=body if np.any(body) else None,
        led_standard_uncertainty=stated.led_mm / 1000 or None,
    )


def _check(scenario: Scenario, arm: robots.Arm) -> None:
    """Refuse what the file's form alone cannot: numbers that must fit one another."""
    joints = f"{arm} has {arm.dof} joints"
    for key in ("home_deg", "amplitude_deg", "speed_deg_s"):
        values = getattr(scenario.motion, key, None)
        if values is not None and len(values) != arm.dof:
            found = f"{len(values)} values"
            raise InputError(f"motion.{key}", found, joints, "Give one number a joint.")
    for index, fault in enumerate(scenario.fault):
        if fault.joint > arm.dof:
            raise InputError(f"fault[{index}].joint", f"is {fault.joint}", joints)
    names = [led.name for led in scenario.marker.led]
    if len(set(names)) < len(names):
        raise InputError("marker.led", "two LEDs have one name", "each needs its own")
    for index, occlusion in enumerate(scenario.occlusion):
        if occlusion.led not in names:
            raise InputError(
                f"occlusion[{index}].led", f'"{occlusion.led}"', f"the LEDs are {', '.join(names)}"
            )
    if not set(range(scenario.recording.pairs)) - set(scenario.recording.dropped):
        raise InputError("recording.dropped", "no pair is left", "one at least is needed")


def _check_limits(scenario: Scenario, arm: robots.Arm, q: Array) -> None:
    """Refuse a motion that the arm could not make."""
    outside = (q < arm.lower - 1e-9) | (q > arm.upper + 1e-9)  # 1e-9: rounding of the units
    if np.any(outside):
        pair, joint = np.argwhere(outside)[0]
        low, high = np.degrees([arm.lower[joint], arm.upper[joint]])
        raise InputError(
            "motion",
            f"takes joint {joint + 1} of {scenario.robot} to {np.degrees(q[pair, joint]):.1f}°",
            f"its limits are {low:g}° and {high:g}°",
            "Choose another home or a smaller motion.",
        )
