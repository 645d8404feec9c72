"""Entries of the compiled small linear algebra and reading interpolation."""

import numpy as np
from numpy.typing import NDArray

from verify.core.native import entry
from verify.core.records import Array, Flags, Index

_rotation_vectors = entry("rotation_vectors")
_motion_misfits = entry("motion_misfits")
_motion_sizes = entry("motion_sizes")
_interpolate = entry("interpolate")
_sample_motion = entry("sample_motion")
_interpolation_error = entry("interpolation_error")
_travel_directions = entry("travel_directions")


def rotation_vectors(turns: Array, vectors: Array) -> None:
    """Fill in rotation vectors (n, 3), rad, of turns (n, 3, 3)."""
    _rotation_vectors(len(vectors), turns, vectors)


def motion_misfits(
    ends: Index, known: Flags, poses: Array, measured: tuple[Array, Array], most: float, cost: Array
) -> None:
    """Fill in `cost` (o,): mean squared misfit of the motions read to those measured, at o offsets.

    `ends` (o, 2, n): which of the flange's poses read (g, 4, 4) begins and ends each of n motions;
    `known` (o, n): those with readings. `measured`: the motions' angle and distance, and the
    variance of each, (n, 2) both. A squared misfit counts for `most` at most.
    """
    figures, variance = measured
    _motion_misfits(len(ends), len(figures), ends, known, poses, figures, variance, most, cost)


def motion_sizes(one: Array, other: Array, figures: Array) -> None:
    """Fill in angle (rad) and distance (m) of the motions of n pairs of poses (n, 4, 4): (n, 2)."""
    _motion_sizes(len(figures), one, other, figures)


def interpolate(t: Array, q: Array, longest: float, instants: Array) -> Array:
    """Readings (n, j), rad, at instants (n,), s: cubic between four readings (Catmull-Rom).

    t (m,), s, increasing, two at least; q (m, j), rad. Across a gap longer than `longest`, s, the
    nearest reading is held.
    """
    values = np.empty((len(instants), q.shape[1]))
    _interpolate(*q.shape, t, q, longest, len(instants), instants, values)
    return values


def sample_motion(
    t: Array, q: Array, longest: float, without_gap: Flags, span: float, instants: Array
) -> tuple[Array, Array]:
    """Readings as by `interpolate`, and joint speeds over twice `span`, s: rad and rad/s, (n, j).

    `without_gap` (m + 1,): no gap before each reading, and after the last. In one the speed is 0.
    """
    values, speeds = np.empty((len(instants), q.shape[1])), np.empty((len(instants), q.shape[1]))
    count = len(instants)
    _sample_motion(*q.shape, t, q, longest, without_gap, span, count, instants, values, speeds)
    return values, speeds


def interpolation_error(t: Array, q: Array, longest: float, instants: Array) -> Array:
    """Error that `interpolate` may have at some instants, (n, j), rad; arguments are the same."""
    values = np.empty((len(instants), q.shape[1]))
    _interpolation_error(*q.shape, t, q, longest, len(instants), instants, values)
    return values


def travel_directions(q: Array, thresholds: Array) -> NDArray[np.int8]:
    """Joints' direction of travel (m, j) after each reading: +1, -1, or 0 before any.

    q (m, j), rad; beyond its threshold (j,), rad, from its extreme a joint has turned back.
    """
    directions = np.empty(q.shape, np.int8)
    _travel_directions(*q.shape, q, thresholds, directions)
    return directions
