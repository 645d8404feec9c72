"""The indices of ISO 9283 as functions of arrays: positions in m, angles in rad.

Attained poses are n visits of one commanded pose; m stations of a path have n visits each.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from verify.records import Array

SPREADS = 3.0  # standard deviations that repeatability counts


def accuracy(attained: Array, commanded: Array) -> float:
    """AP (m): distance of the attained positions' barycentre (n, 3) from the commanded one (3,)."""
    return float(np.linalg.norm(attained.mean(axis=0) - commanded))


def distances(attained: Array) -> Array:
    """Distance l_j (m) of each attained position from the barycentre: (..., n, 3) to (..., n)."""
    lengths: Array = np.linalg.norm(attained - attained.mean(axis=-2, keepdims=True), axis=-1)
    return lengths


def repeatability(attained: Array) -> Array:
    """RP (m): mean distance from the barycentre and three standard deviations of the distances.

    Args:
        attained: (..., n, 3), n of two or more.

    Returns:
        One radius (...) a set of n.
    """
    length = distances(attained)
    radius: Array = length.mean(axis=-1) + SPREADS * length.std(axis=-1, ddof=1)
    return radius


def turns(attained: Array, commanded: Array) -> Array:
    """Small turns (n, 3), rad, about the axes of the frame, from the commanded orientation (3, 3).

    For turns as small as an arm's errors, three angles of any convention are these components of
    the rotation vector, to the second order; unlike theirs it has no singular orientation.
    """
    vectors: Array = Rotation.from_matrix(attained @ commanded.T).as_rotvec()
    return vectors


def angle_repeatability(angles: Array) -> Array:
    """RP_a, RP_b, RP_c (3,), rad: three standard deviations of each angle (n, 3) about its mean."""
    spread: Array = SPREADS * angles.std(axis=0, ddof=1)
    return spread


def mean_turn(attained: Array) -> Array:
    """The mean (3, 3) of orientations (n, 3, 3)."""
    mean: Array = Rotation.from_matrix(attained).mean().as_matrix()
    return mean


def furthest(barycentres: Array) -> tuple[float, tuple[int, int]]:
    """Largest distance between barycentres (h, .), in their unit (vAP), and of which two."""
    apart = np.linalg.norm(barycentres[:, None] - barycentres[None], axis=2)
    one, other = np.unravel_index(int(np.argmax(apart)), apart.shape)
    return float(apart[one, other]), (int(one), int(other))


def path_accuracy(attained: Array, commanded: Array) -> tuple[float, int]:
    """AT (m): largest distance of a station's barycentre from the commanded path, and where.

    Args:
        attained: (m, n, 3), where each of n passages crosses the plane normal to the commanded
            path at each of m stations.
        commanded: (m, 3).
    """
    off = np.linalg.norm(attained.mean(axis=1) - commanded, axis=1)
    worst = int(np.argmax(off))
    return float(off[worst]), worst


def path_repeatability(attained: Array) -> tuple[float, int]:
    """RT (m): the largest repeatability of any station, and where; (m, n, 3)."""
    radius = repeatability(attained)
    worst = int(np.argmax(radius))
    return float(radius[worst]), worst


def drift(attained: Array, commanded: Array, starts: NDArray[np.int64]) -> Array:
    """Largest change of AP and of RP from the first block of visits to any other: dAP and dRP, m.

    Args:
        attained: (..., n, 3), in time's order.
        commanded: (3,).
        starts: (b,), the first visit of each block of two or more visits.

    Returns:
        (..., 2), m.
    """
    blocks = np.split(attained, starts[1:], axis=-2)
    found = np.array(
        [(np.linalg.norm(b.mean(axis=-2) - commanded, axis=-1), repeatability(b)) for b in blocks]
    )
    change: Array = np.moveaxis(np.abs(found - found[0]).max(axis=0), 0, -1)
    return change
