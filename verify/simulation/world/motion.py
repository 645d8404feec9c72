"""The simulated arm's motion: true joint angles and last direction of travel at any instant.

Random numbers depend on the seed and on their purpose, never on the order of calls.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np

from verify.core.records import Array, Index
from verify.simulation.scenario import (
    ConstantSpeed,
    MultiJoint,
    QuarterCircle,
    Scenario,
    SingleJoint,
)


class RandomStream(IntEnum):
    """What a stream of random numbers is for; the numbers are part of every seed's meaning."""

    MOTION = 0
    TIMES = 1
    ENCODERS = 2
    SYSTEMATIC = 3
    PAN = 4
    CLOCK = 5
    ROOM = 6
    PIXELS = 7


def generator(seed: int, stream: RandomStream, *key: int) -> np.random.Generator:
    """Make the generator of one stream, e.g. of the pixels of one camera's frame 12."""
    sequence = np.random.SeedSequence(seed, spawn_key=(int(stream), *key))
    return np.random.Generator(np.random.PCG64(sequence))


N_HARMONICS = 3  # sines a joint: enough that no two joints move alike, few enough to stay smooth


class MotionProfile(Protocol):
    """A motion as a function of the cameras' time, seconds; before it has moved, d is +1."""

    def angles(self, t: Array) -> Array:
        """True joint angles, rad: (...,) to (..., joints)."""

    def direction(self, t: Array) -> Array:
        """Last direction of travel, +1 or -1, kept at rest: (...,) to (..., joints)."""


@dataclass(frozen=True, slots=True)
class SumOfSines:
    """Every joint moves all the time."""

    home: Array  # (joints,), rad
    amplitude: Array  # (joints, sines), rad
    frequency: Array  # (joints, sines), rad/s
    phase: Array  # (joints, sines), rad

    def angles(self, t: Array) -> Array:
        """Sum the sines."""
        turn = np.asarray(t)[..., None, None] * self.frequency + self.phase
        return np.asarray(self.home + np.sum(self.amplitude * np.sin(turn), axis=-1))

    def direction(self, t: Array) -> Array:
        """Give the sign of the speed."""
        turn = np.asarray(t)[..., None, None] * self.frequency + self.phase
        return direction_sign(np.sum(self.amplitude * self.frequency * np.cos(turn), axis=-1))


@dataclass(frozen=True, slots=True)
class SequentialSwings:
    """Joint after joint swings up, down and back home, each in a slot of its own."""

    home: Array  # (joints,), rad
    amplitude: Array  # (joints,), rad
    begin: float  # s
    slot: float  # s

    def angles(self, t: Array) -> Array:
        """Swing by a sine whose phase runs from 0 to a full turn within the joint's slot."""
        return self.home + self.amplitude * np.sin(self._turn(t))

    def direction(self, t: Array) -> Array:
        """Down in the middle half of the swing, up before and after it (down, if it begins so)."""
        turn = self._turn(t)
        return np.where(turn > 0, direction_sign(self.amplitude * np.cos(turn)), 1.0)

    def _turn(self, t: Array) -> Array:
        starts = self.begin + self.slot * np.arange(len(self.home))
        return 2 * np.pi * minimum_jerk((np.asarray(t)[..., None] - starts) / self.slot)


@dataclass(frozen=True, slots=True)
class StationaryPoses:
    """Still poses; the arm leaves for each at `depart` and arrives `move` later."""

    poses: Array  # (stations, joints), rad
    depart: Array  # (stations,), s; the first is where the arm stands to begin with
    move: float  # s

    def angles(self, t: Array) -> Array:
        """Rest at a pose, or be on the way from the one before."""
        i = self._station(t)
        before = self.poses[np.maximum(i - 1, 0)]
        share = minimum_jerk((np.asarray(t) - self.depart[i]) / self.move)[..., None]
        return before + share * (self.poses[i] - before)

    def direction(self, t: Array) -> Array:
        """Give the sign of the last move that turned the joint."""
        last = np.ones_like(self.poses)
        for i in range(1, len(self.poses)):
            step = np.sign(self.poses[i] - self.poses[i - 1])
            last[i] = np.where(step == 0, last[i - 1], step)
        return last[self._station(t)]

    def _station(self, t: Array) -> Index:
        return np.maximum(np.searchsorted(self.depart, t, side="right") - 1, 0)


@dataclass(frozen=True, slots=True)
class ConstantVelocity:
    """Every joint at its own constant speed."""

    home: Array  # (joints,), rad, at `middle`
    speed: Array  # (joints,), rad/s
    middle: float  # s

    def angles(self, t: Array) -> Array:
        """Go on in proportion to time."""
        return self.home + self.speed * (np.asarray(t)[..., None] - self.middle)

    def direction(self, t: Array) -> Array:
        """Give the speed's sign, always."""
        return np.broadcast_to(direction_sign(self.speed), (*np.shape(t), len(self.home)))


def plan_motion(scenario: Scenario, begin: float, end: float) -> MotionProfile:
    """Make the scenario's motion, defined for every instant, fill the time between two pairs, s."""
    table = scenario.motion
    home = np.radians(np.asarray(table.home_deg, dtype=float))
    rng = generator(scenario.seed, RandomStream.MOTION)
    if isinstance(table, QuarterCircle):
        turned = home.copy()
        turned[0] += np.radians(table.sweep_deg)
        duration = max(end - begin - 2 * table.rest_s, 1e-3)  # 1 ms: a single pair has no span
        depart = np.array([-np.inf, begin + table.rest_s])
        return StationaryPoses(np.stack([home, turned]), depart, duration)
    if isinstance(table, ConstantSpeed):
        return ConstantVelocity(home, np.radians(np.asarray(table.speed_deg_s)), (begin + end) / 2)
    amplitude = np.radians(np.asarray(table.amplitude_deg, dtype=float))
    if isinstance(table, MultiJoint):
        return _sum_of_sines(home, amplitude, (table.slowest_hz, table.fastest_hz), rng)
    if isinstance(table, SingleJoint):
        return SequentialSwings(home, amplitude, begin, max(end - begin, 1e-3) / len(home))
    period = 1 / scenario.recording.rate_hz
    move = min(2.0, 0.4 * period)  # 2 s: unhurried; else most of the period is for standing still
    stations = scenario.recording.pairs
    poses: Array = home + amplitude * rng.uniform(-1, 1, (stations, len(home)))
    depart = begin + (np.arange(stations, dtype=float) - 0.5) * period
    return StationaryPoses(poses, depart, move)


def _sum_of_sines(
    home: Array, amplitude: Array, band_hz: tuple[float, float], rng: np.random.Generator
) -> SumOfSines:
    """Draw frequencies, one in each part of the band, and phases; slow sines swing widest."""
    edges = np.geomspace(*band_hz, N_HARMONICS + 1)
    shape = (len(home), N_HARMONICS)
    frequency = 2 * np.pi * rng.uniform(edges[:-1], edges[1:], shape)
    share = 1 / frequency  # equal speeds from each sine
    share /= share.sum(axis=1, keepdims=True)
    return SumOfSines(home, amplitude[:, None] * share, frequency, rng.uniform(0, 2 * np.pi, shape))


def minimum_jerk(share: Array) -> Array:
    """Go smoothly from 0 at 0 to 1 at 1, at rest outside: the minimum-jerk polynomial."""
    s = np.clip(share, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s)


def move_towards(start: Array, goal: Array, reach: float | Array) -> Array:
    """Go from start to goal, each number by `reach` at most; what has arrived is at the goal."""
    way = goal - start
    return np.where(np.abs(way) <= reach, goal, start + np.clip(way, -reach, reach))


def direction_sign(speed: Array) -> Array:
    """Give -1 where the speed is negative, else +1."""
    return np.where(speed < 0, -1.0, 1.0)
