"""Readings that are left out of a log: those that no arm reaches, and those that only repeat.

Who asks a controller more often than it renews its readings logs each value several times, with new
times: steps instead of a motion, late by up to the period of renewal. Only the first of such rows
is a reading. A read-out of few digits repeats itself as well where an arm moves slowly, but then by
one digit at a time; an arm at rest, for far longer than a period.
"""

from collections.abc import Iterator

import numpy as np

from verify.core.readings import MAX_GAP
from verify.core.records import Array, Flags

MAX_SPIKE = 2  # readings in a row
MAX_SPEED = 20.0  # rad/s; wrists of small arms turn at up to 13
MAX_ACCELERATION = 150.0  # rad/s², of the same
MIN_SPIKE = np.deg2rad(2.0)
MIN_SPIKE_RATIO = 8.0  # of the typical step: random postures jump by up to four times theirs
MAX_BEYOND = np.deg2rad(45.0)  # an encoder may be off, and its arm at the end of its travel
MAX_NAMED = 5  # spikes
BESIDE_LEAP = 5  # rows either side of a leap, whose motion goes on across it
MIN_REPEATED = 0.2  # of the rows of a motion
MIN_CHANGES = 10
MIN_DIGITS = 3.0  # by which readings change, typically: slower ones wait for their last digit
REST_PERIODS = 3.0  # of renewal: a value that stays for longer is rest
KEPT_PERIODS = 1.5  # after which a value that stays was renewed


def _is_too_fast(t: Array, q: Array, lag: int) -> Flags:
    """Whether q (m, j), rad, changes faster over `lag` readings than an arm turns, (m - lag, j)."""
    fastest = np.maximum(MAX_SPEED * (t[lag:] - t[:-lag])[:, None], MIN_SPIKE)
    typical = np.median(np.abs(np.diff(q, axis=0)), axis=0)
    return np.abs(q[lag:] - q[:-lag]) > np.maximum(fastest, MIN_SPIKE_RATIO * typical)


def _is_too_bent(t: Array, q: Array, length: int) -> Flags:
    """Whether `length` readings are off the line through those beside, (m - length - 1, j).

    All alike, by more than an arm's acceleration puts them, and than any as near are.
    """
    before, after, span = q[: -length - 1], q[length + 1 :], t[length + 1 :] - t[: -length - 1]
    inner = np.arange(1, length + 1)[:, None] + np.arange(len(span))
    share = (t[inner] - t[: -length - 1]) / span
    off = q[inner] - before - share[:, :, None] * (after - before)
    bend = np.abs(off).min(axis=0)
    limit = np.maximum(MAX_ACCELERATION * span[:, None] ** 2 / 8, MIN_SPIKE)
    limit = np.maximum(limit, MIN_SPIKE_RATIO * np.median(bend, axis=0))
    bend *= np.ptp(off, axis=0) <= bend / 2
    beside = np.pad(bend, ((1, 1), (0, 0)), mode="edge")
    return np.asarray(bend > np.maximum(limit, 1.5 * np.maximum(beside[2:], beside[:-2])))


def find_spikes(t: Array, q: Array) -> Flags:
    """Readings (m, j) that jump away and come back, while those beside them agree."""
    spikes = np.zeros(q.shape, dtype=bool)
    for length in range(1, min(MAX_SPIKE, len(t) - 2) + 1):
        step = _is_too_fast(t, q, 1)
        apart = _is_too_fast(t, q, length + 1)
        away = step[:-length] & step[length:] & ~apart  # between readings i and i + length + 1
        away |= _is_too_bent(t, q, length)
        for place in range(1, length + 1):
            spikes[place : place + len(away)] |= away
    return spikes


def find_stray(t: Array, q: Array, limits: tuple[Array, Array] | None) -> Flags:
    """Readings (m, j) far outside the limits that no motion leads to; none where most are."""
    if limits is None:
        return np.zeros(q.shape, dtype=bool)
    outside = (q < limits[0] - MAX_BEYOND) | (q > limits[1] + MAX_BEYOND)
    if len(t) > 1:  # a stretch that motion leads to is an encoder's error
        alone = _is_too_fast(t, q, 1) | (np.diff(t) > MAX_GAP)[:, None]
        for joint in np.flatnonzero(outside.any(axis=0)):
            parts = np.concatenate([[0], np.cumsum(alone[:, joint])])
            inside = np.bincount(parts, ~outside[:, joint]) > 0
            outside[:, joint] &= ~inside[parts]
    return np.asarray(outside & (outside.mean(axis=0) <= 0.5))


def without_turns(t: Array, q: Array) -> Array:
    """Readings (m, j), rad, at t (m,), s, without leaps by a full turn that no arm makes.

    A counter of angles begins again at ±180° or ±360°: the pose is the same, the motion goes on.
    """
    leap, fastest = np.diff(q, axis=0), np.maximum(MAX_SPEED * np.diff(t), MIN_SPIKE)[:, None]
    turn = _is_too_fast(t, q, 1) & (np.abs(np.abs(leap) - 2 * np.pi) <= fastest)
    return q - 2 * np.pi * np.pad(np.cumsum(np.sign(leap) * turn, axis=0), ((1, 0), (0, 0)))


def find_leap(t: Array, q: Array) -> tuple[float, float] | None:
    """When times t (m,), s, leap and by how much, if readings q (m, j), rad, go on all the same."""
    usual, n = float(np.median(np.diff(t))) if len(t) > 1 else np.inf, BESIDE_LEAP
    for k in np.flatnonzero(np.diff(t) > max(MAX_GAP, n * usual)).tolist():
        if n <= k < len(t) - n - 1:
            pace = (q[k] - q[k - n] + q[k + n + 1] - q[k + 1]) / (2 * n)  # from row to row
            beside = np.delete(np.diff(t[k - n : k + n + 2]), n)  # long ones: logged on change
            goes_on = np.abs(q[k + 1] - q[k] - pace).max() < np.abs(pace).max() / 3
            if goes_on and beside.max() < 2 * usual:
                return float(t[k + 1]), float(t[k + 1] - t[k] - usual)
    return None


def warn_of_spikes(spike: Flags) -> Iterator[str]:
    """Name the readings (m, j) that are left out, where there are any."""
    rows, joints = np.nonzero(spike)
    if len(rows):
        places = [f"line {i + 2} (q{j + 1}_deg)" for i, j in zip(rows, joints, strict=True)]
        more = ", …" if len(places) > MAX_NAMED else ""
        yield (
            f"{np.unique(rows).size} of {len(spike)} readings were left out, the "
            f"arm cannot reach them: {', '.join(places[:MAX_NAMED])}{more}."
        )


def find_repeats(t: Array, q: Array) -> tuple[Flags, float]:
    """Rows of t (m,), s, and q (m, j) that repeat the one before (m,), and the period, s.

    None, and 0, where the log does not have them regularly.
    """
    none = np.zeros(len(t), dtype=bool), 0.0
    change = np.abs(np.diff(q, axis=0))
    first = np.concatenate([[0], np.flatnonzero(change.any(axis=1)) + 1])
    lasts = np.diff(t[first])
    if np.count_nonzero(lasts <= MAX_GAP) < MIN_CHANGES or len(first) == len(t):
        return none
    period = float(np.median(lasts[lasts <= MAX_GAP]))
    rows = np.diff(first)[lasts <= REST_PERIODS * period]
    digit = np.min(change, axis=0, where=change > 0, initial=np.inf)
    digits = np.median((change[first[1:] - 1] / digit).max(axis=1))
    if 1 - len(rows) / max(rows.sum(), 1) < MIN_REPEATED or digits < MIN_DIGITS:
        return none
    run = np.searchsorted(first, np.arange(len(t)), side="right") - 1
    since = t - t[first[run]]
    until = np.append(t[first], np.inf)[run + 1] - t
    stale = (since > 0) & ((since < KEPT_PERIODS * period) | (until < period))
    return stale, period


def warn_of_repeats(repeats: Flags, period: float) -> Iterator[str]:
    """Tell how many rows repeat (m,), where any do, and how often readings are renewed, s."""
    if repeats.any():
        yield (
            f"{np.count_nonzero(repeats)} of {len(repeats)} readings repeat the one before and "
            f"were left out: the controller renews them every {1e3 * period:.3g} ms. When, is "
            "known to a row; that is taken into account."
        )
