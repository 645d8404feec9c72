"""How an emulated arm moves: joint angles as a function of time."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError
from verify.io.series import read_encoders

HOME_DEG = (0.0, 20.0, 70.0, 10.0, 40.0, 0.0)  # within the limits of every arm that comes along
SWEEP_AMPLITUDE = np.deg2rad(20.0)  # rad, to either side of home
SWEEP_SPEED = np.deg2rad(10.0)  # rad/s
MIN_FREQUENCY = 0.05  # Hz: sine of joint 1; each further joint is a seventh faster
NAMES = ("hold", "sweep", "sines")


class EmulatedTrajectory(Protocol):
    """A motion."""

    def at(self, t: float) -> Array:
        """Joint angles, (joints,), rad, at t seconds after the start."""


@dataclass(frozen=True)
class HoldTrajectory:
    """The arm stands still."""

    home: Array  # (joints,), rad

    def at(self, t: float) -> Array:  # noqa: ARG002  standing still knows no time
        """Give home."""
        return self.home


@dataclass(frozen=True)
class SweepTrajectory:
    """All joints go to and fro about home at constant speed."""

    home: Array  # (joints,), rad

    def at(self, t: float) -> Array:
        """Go up first."""
        phase = (t * SWEEP_SPEED / SWEEP_AMPLITUDE + 1.0) % 4.0
        swing: Array = self.home + SWEEP_AMPLITUDE * (1.0 - abs(phase - 2.0))
        return swing


@dataclass(frozen=True)
class SineTrajectory:
    """Each joint swings about home, no two alike."""

    home: Array  # (joints,), rad

    def at(self, t: float) -> Array:
        """Begin at home."""
        frequency = MIN_FREQUENCY * (1.0 + np.arange(len(self.home)) / 7.0)
        swing: Array = self.home + SWEEP_AMPLITUDE * np.sin(2 * np.pi * frequency * t)
        return swing


@dataclass(frozen=True)
class RecordedTrajectory:
    """A recorded motion, played to its end, back to its beginning, and so on."""

    readings: Readings

    def at(self, t: float) -> Array:
        """Begin with the first reading."""
        begin, end = self.readings.t[[0, -1]].tolist()
        length = end - begin
        place = length - abs(t % (2 * length) - length) if length else 0.0
        joints: Array = self.readings.at(np.array([begin + place]))[0]
        return joints


def load(motion: str, joints: int) -> EmulatedTrajectory:
    """Find a motion by name, or read it from a CSV like a session's encoders.csv.

    Raises:
        InputError: neither a name nor a file that can be used.
    """
    home = np.deg2rad(np.resize(HOME_DEG, joints))
    if motion == "hold":
        return HoldTrajectory(home)
    if motion == "sweep":
        return SweepTrajectory(home)
    if motion == "sines":
        return SineTrajectory(home)
    if not Path(motion).suffix:
        expected = f"known are {', '.join(NAMES)}, or the path of a CSV"
        raise InputError("--motion", f'is "{motion}"', expected, "Choose one of them.")
    encoders, _ = read_encoders(motion, joints)
    return RecordedTrajectory(Readings(encoders.t, encoders.q))
