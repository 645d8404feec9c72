"""Passages of one path: where they cross the planes normal to it, and how far off that is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from verify.analysis.performance import indices, poses
from verify.core.records import Array

N_STATIONS = 50
MIN_LENGTH = 0.02  # m: a shorter path has no direction to speak of
N_SHUFFLES = 500


@dataclass(frozen=True, slots=True)
class PathRun:
    """One run along a path, k instants close enough for straight lines between them."""

    t: Array  # (k,), s
    attained: Array  # (k, 3), m
    read: Array  # (k, 3), m
    turn: Array  # (k, 3), rad, attained orientation from the read one
    read_turn: Array  # (k, 3, 3)


@dataclass(frozen=True, slots=True)
class Crossings:
    """Where n passages cross the planes of m stations."""

    commanded: Array  # (m, 3), m, the mean of what the passages read
    tangent: Array  # (m, 3), unit
    along: Array  # (m,), m, way from the first station
    attained: Array  # (m, n, 3), m
    own: Array  # (m, n, 3), m, attained less read there, across the path
    turns: Array  # (m, n, 3), rad, about the base's axes, from the mean orientation read
    t: Array  # (m, n), s


@dataclass(frozen=True, slots=True)
class PathIndices:
    """A path, judged."""

    name: str
    crossings: Crossings
    passages: int
    length: float  # m
    speed: float  # m/s, mean
    accuracy: poses.PoseAccuracy  # at the station where AT stands
    accuracy_at: float  # m along the path
    accuracy_noise: float  # m: AT of the same scatter about the path itself, 95 %
    repeatability: poses.Repeatability  # at the station where RT stands
    repeatability_at: float
    turn_accuracy: Array | None  # (3,), rad, signed, of the largest size of any station
    turn_repeatability: Array | None  # (3,), rad


def crossings(passages: Sequence[PathRun]) -> Crossings | None:
    """Where passages cross the planes normal to their mean path; None of one shorter than 20 mm."""
    ways = [_path_length(p.read) for p in passages]
    if min(way[-1] for way in ways) < MIN_LENGTH:
        return None
    share = (np.arange(N_STATIONS) + 0.5) / N_STATIONS
    at = [np.interp(share * way[-1], way, p.t) for way, p in zip(ways, passages, strict=True)]
    read = np.array([_interpolate(p.t, p.read, t) for p, t in zip(passages, at, strict=True)])
    commanded = read.mean(axis=0)
    tangent = np.gradient(commanded, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    t = np.array(
        [_crossing_times(p, commanded, tangent, near) for p, near in zip(passages, at, strict=True)]
    )
    attained = np.array(
        [_interpolate(p.t, p.attained, one) for p, one in zip(passages, t, strict=True)]
    )
    crossed = np.array([_interpolate(p.t, p.read, one) for p, one in zip(passages, t, strict=True)])
    return Crossings(
        commanded,
        tangent,
        _path_length(commanded),
        attained.swapaxes(0, 1),
        _normal_part((attained - crossed).swapaxes(0, 1), tangent[:, None]),
        _orientation_deviations(passages, t),
        t.T,
    )


def _path_length(points: Array) -> Array:
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _interpolate(t: Array, values: Array, when: Array) -> Array:
    return np.stack([np.interp(when, t, column) for column in values.T], axis=-1)


def _crossing_times(passage: PathRun, commanded: Array, tangent: Array, near: Array) -> Array:
    """Instants (m,) at which the attained path crosses each plane, the one nearest to `near`."""
    side = passage.attained @ tangent.T - np.sum(commanded * tangent, axis=1)  # (k, m)
    early, late = side[:-1], side[1:]
    through = (early <= 0) & (late > 0)
    share = np.divide(-early, late - early, out=np.zeros_like(early), where=through)
    crossed = passage.t[:-1, None] + share * np.diff(passage.t)[:, None]
    off = np.where(through, np.abs(crossed - near), np.inf)
    stations = np.arange(len(near))
    found = crossed[np.argmin(off, axis=0), stations]
    # a passage that stops short of a plane: where it comes nearest is all that there is
    nearest = passage.t[np.argmin(np.abs(side), axis=0)]
    return np.asarray(np.where(through.any(axis=0), found, nearest), dtype=float)


def _orientation_deviations(passages: Sequence[PathRun], t: Array) -> Array:
    """Turns (m, n, 3) of the attained orientations from the mean of those read at a station."""
    rows = [np.clip(np.searchsorted(p.t, one), 0, len(p.t) - 1)
            for p, one in zip(passages, t, strict=True)]  # fmt: skip
    read = np.array([p.read_turn[r] for p, r in zip(passages, rows, strict=True)])
    own = np.array([_interpolate(p.t, p.turn, one) for p, one in zip(passages, t, strict=True)])
    means = (Rotation.from_matrix(station).mean().as_matrix() for station in read.swapaxes(0, 1))
    off = [indices.orientation_deviations(read[:, i], mean) for i, mean in enumerate(means)]
    return np.asarray(np.array(off) + own.swapaxes(0, 1), dtype=float)


def assess_path(
    name: str, found: Crossings, floor: float, systematic: Array, *, oriented: bool
) -> PathIndices:
    """Judge the crossings of a path by five passages or more.

    `floor`, m: repeatability that the instrument's noise alone would show; `systematic` (m, 3, p),
    m: what does not average out at each station; `oriented`: the orientation was measured.
    """
    off = found.attained - found.commanded[:, None]
    # as of AP: what arm and readings do alike is no doubt of the mean
    own = off.mean(axis=1, keepdims=True) + found.own - found.own.mean(axis=1, keepdims=True)
    doubt = _normal_part(systematic.swapaxes(1, 2), found.tangent[:, None]).swapaxes(1, 2)
    _, worst = indices.path_accuracy(found.attained, found.commanded)
    _, widest = indices.path_repeatability(found.attained)
    turn_accuracy = turn_repeatability = None
    if oriented:
        means = found.turns.mean(axis=1)
        turn_accuracy = means[np.argmax(np.abs(means), axis=0), np.arange(3)]
        turn_repeatability = 3 * found.turns.std(axis=1, ddof=1).max(axis=0)
    duration = float(np.mean(found.t[-1] - found.t[0]))
    return PathIndices(
        name=name,
        crossings=found,
        passages=found.attained.shape[1],
        length=float(found.along[-1]),
        speed=float(found.along[-1]) / duration if duration > 0 else np.nan,
        accuracy=poses.mean_deviation(own[worst], doubt[worst]),
        accuracy_at=float(found.along[worst]),
        accuracy_noise=_noise_path_accuracy(found.own),
        repeatability=poses.subtract_noise(indices.repeatability_interval(off[widest]), floor),
        repeatability_at=float(found.along[widest]),
        turn_accuracy=turn_accuracy,
        turn_repeatability=turn_repeatability,
    )


def _normal_part(vectors: Array, tangent: Array) -> Array:
    """What of vectors (..., 3) lies in the plane normal to the path: the rest is timing."""
    return np.asarray(vectors - np.sum(vectors * tangent, axis=-1, keepdims=True) * tangent)


def _noise_path_accuracy(off: Array) -> float:
    """AT (m) that the passages' scatter about their mean gives on its own in 95 % of cases.

    Whole passages change sign at random, which keeps their likeness from station to station; the
    largest of m stations is more than any one shows.
    """
    n = off.shape[1]
    scatter = (off - off.mean(axis=1, keepdims=True)) * np.sqrt(n / (n - 1))
    signs = np.random.default_rng(indices.SEED).choice([-1.0, 1.0], (N_SHUFFLES, n))
    means = np.einsum("sn,mni->smi", signs, scatter) / n
    return float(np.quantile(np.linalg.norm(means, axis=2).max(axis=1), 1 - 2 * indices.P_TAIL))
