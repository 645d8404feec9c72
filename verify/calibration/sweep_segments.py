"""Which joint was swept when: found in the encoders' readings alone."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from verify.readings import Readings
from verify.records import Array

# A joint counts as moving between two pairs from here on: five times what readings' noise makes of
# a difference, and never less than the last digits of a common read-out.
NOISE_FACTOR = 5.0 * np.sqrt(2)
SMALLEST_TRAVEL = np.deg2rad(0.03)
STILL = np.deg2rad(0.1)  # what the other joints may stray during a sweep: 0.2 mm at 100 mm
FEWEST_PAIRS = 6  # an axis has four unknowns and each pair one of its own


@dataclass(frozen=True, slots=True)
class Sweep:
    """Pairs in a row during which one joint alone moved."""

    joint: int  # counted from 0
    pairs: NDArray[np.int64]  # indices into the measured pairs
    q: Array  # (n, joints), rad, the encoders at those pairs

    @property
    def span(self) -> float:
        """From the joint's least to its largest reading, rad."""
        return float(np.ptp(self.q[:, self.joint]))


def find_sweeps(
    readings: Readings, t: Array, frame: NDArray[np.int64]
) -> tuple[list[Sweep], list[str]]:
    """Split pairs into sweeps.

    Args:
        readings: the encoders.
        t: (n,), s, the pairs' instants on the readings' clock.
        frame: (n,), the pairs' numbers, for the words.

    Returns:
        The sweeps in order of time, and what was left out and why, in sentences.
    """
    known = readings.known(t)
    q = readings.at(t)
    limit = np.maximum(NOISE_FACTOR * readings.noise, SMALLEST_TRAVEL)
    sweeps: list[Sweep] = []
    notes: list[str] = []
    for joints, chosen in _runs(q, known, limit):
        named = " and ".join(str(j + 1) for j in joints)
        when = f"pairs {frame[chosen[0]]} to {frame[chosen[-1]]}"
        if len(joints) > 1:
            notes.append(f"Left out: in {when} joints {named} move together.")
            continue
        others = np.delete(np.ptp(q[chosen], axis=0), joints[0])
        if np.any(others > np.maximum(STILL, NOISE_FACTOR * readings.noise.max())):
            notes.append(f"Left out: joint {named} in {when}; another joint strays meanwhile.")
        elif len(chosen) < FEWEST_PAIRS:
            notes.append(
                f"Left out: joint {named} in {when}; an axis needs {FEWEST_PAIRS} pairs or more."
            )
        else:
            sweeps.append(Sweep(joints[0], chosen, q[chosen]))
    return sweeps, notes


def _runs(
    q: Array, known: NDArray[np.bool_], limit: Array
) -> list[tuple[tuple[int, ...], NDArray[np.int64]]]:
    """Stretches of pairs with the joints that move in them, from the first motion to the last.

    Pairs at rest between two motions of one joint belong to its stretch; those before another
    joint's motion do not: it may have begun already, too slowly to tell.
    """
    runs: list[tuple[tuple[int, ...], int, int]] = []
    places = np.flatnonzero(known)
    for before, now in pairwise(places.tolist()):
        joints = tuple(np.flatnonzero(np.abs(q[now] - q[before]) > limit).tolist())
        if not joints:
            continue
        if runs and runs[-1][0] == joints:
            runs[-1] = (joints, runs[-1][1], now)
        else:
            runs.append((joints, before, now))
    return [(joints, places[(places >= first) & (places <= last)]) for joints, first, last in runs]
