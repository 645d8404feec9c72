"""How an emulated arm moves: joint angles as a function of time."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError
from verify.io.series import read_encoders

HOME_DEG = (0.0, 20.0, 70.0, 10.0, 40.0, 0.0)  # within the limits of every arm that comes along
SWEEP_AMPLITUDE = np.deg2rad(20.0)  # rad, to either side of home
SWEEP_SPEED = np.deg2rad(10.0)  # rad/s
MIN_FREQUENCY = 0.05  # Hz: sine of joint 1; each further joint is a seventh faster

EmulatedTrajectory = Callable[[float], Array]  # s after the start to joint angles, (joints,), rad


def load(motion: str, joints: int) -> EmulatedTrajectory:
    """Find a motion by name, or read it from a CSV like a session's encoders.csv.

    Raises:
        InputError: neither a name nor a file that can be used.
    """
    if motion in NAMES:
        return partial(NAMES[motion], np.deg2rad(np.resize(HOME_DEG, joints)))
    if not Path(motion).suffix:
        expected = f"known are {', '.join(NAMES)}, or the path of a CSV"
        raise InputError("--motion", f'is "{motion}"', expected, "Choose one of them.")
    encoders, _ = read_encoders(Path(motion), joints)
    return partial(_recorded, Readings(encoders.t, encoders.q))


def _sweep(home: Array, t: float) -> Array:
    """All joints go to and fro about home at constant speed, up first."""
    phase = (t * SWEEP_SPEED / SWEEP_AMPLITUDE + 1.0) % 4.0
    return np.asarray(home + SWEEP_AMPLITUDE * (1.0 - abs(phase - 2.0)))


def _sines(home: Array, t: float) -> Array:
    """Each joint swings about home, no two alike."""
    frequency = MIN_FREQUENCY * (1.0 + np.arange(len(home)) / 7.0)
    return np.asarray(home + SWEEP_AMPLITUDE * np.sin(2 * np.pi * frequency * t))


NAMES = {"hold": lambda home, _t: home, "sweep": _sweep, "sines": _sines}


def _recorded(readings: Readings, t: float) -> Array:
    """Play a recorded motion to its end, back to its beginning, and so on."""
    begin, end = readings.t[[0, -1]].tolist()
    length = end - begin
    place = length - abs(t % (2 * length) - length) if length else 0.0
    return np.asarray(readings.at(np.array([begin + place]))[0])
