"""Small vectors and matrices for compiled loops: products, Cholesky's factor, medians, motions.

With A = L L', `factor` fills in L, `solve` A⁻¹ b and `invert` A⁻¹. All is filled in place, by plain
loops: numba compiles assignments of whole arrays ten times as long, and for so few numbers its
library calls are no quicker.
"""

import math

import numpy as np
from numpy.typing import NDArray

from verify.core.jit import compiled
from verify.core.records import Array

SMALL_ANGLE = 1e-9  # rad: below, sine and angle are the same


@compiled
def dot(a: Array, b: Array) -> float:
    """Scalar product of two vectors (3,)."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def distance(a: Array, b: Array) -> float:
    """Distance of two points (3,)."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return math.sqrt(x * x + y * y + z * z)


@compiled
def cross(a: Array, b: Array, product: Array) -> None:
    """Fill in the cross product of two vectors (3,)."""
    product[0] = a[1] * b[2] - a[2] * b[1]
    product[1] = a[2] * b[0] - a[0] * b[2]
    product[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def scale_to_one(vector: Array) -> None:
    """Give a vector (3,) the length one."""
    length = math.sqrt(dot(vector, vector))
    for i in range(3):
        vector[i] /= length


@compiled
def rotate(axes: Array, vector: Array) -> None:
    """Rotate the first three columns of (3 or 4, 3 or 4) in place by a rotation vector (3,)."""
    x, y, z = vector[0], vector[1], vector[2]
    angle = math.sqrt(x * x + y * y + z * z)
    half = 0.5 * angle
    sine = math.sin(angle) / angle if angle > SMALL_ANGLE else 1.0
    versine = 0.5 * (math.sin(half) / half) ** 2 if angle > SMALL_ANGLE else 0.5
    for j in range(3):
        a, b, c = axes[0, j], axes[1, j], axes[2, j]
        # Rodrigues: v + sine (w x v) + versine (w x (w x v))
        d, e, f = y * c - z * b, z * a - x * c, x * b - y * a
        axes[0, j] = a + sine * d + versine * (y * f - z * e)
        axes[1, j] = b + sine * e + versine * (z * d - x * f)
        axes[2, j] = c + sine * f + versine * (x * e - y * d)


@compiled
def factor(matrix: Array, less: float, root: Array) -> bool:
    """Fill in the lower Cholesky factor of a matrix (n, n) with `less` taken off its diagonal.

    False where that is not positive definite; the factor has NaN then.
    """
    definite = True
    for i in range(len(matrix)):
        for j in range(i + 1):
            rest = matrix[i, j] - (less if i == j else 0.0)
            for k in range(j):
                rest -= root[i, k] * root[j, k]
            if i > j:
                root[i, j] = rest / root[j, j]
            else:
                definite = definite and rest > 0.0
                root[i, i] = math.sqrt(rest) if rest > 0.0 else math.nan
    return definite


@compiled
def solve(root: Array, right: Array) -> None:
    """Solve in place for a vector (n,), by the lower Cholesky factor (n, n)."""
    for i in range(len(right)):
        for k in range(i):
            right[i] -= root[i, k] * right[k]
        right[i] /= root[i, i]
    for i in range(len(right) - 1, -1, -1):
        for k in range(i + 1, len(right)):
            right[i] -= root[k, i] * right[k]
        right[i] /= root[i, i]


@compiled
def solve_each(root: Array, right: Array) -> None:
    """Solve in place for the columns of (n, m) at once, by the lower Cholesky factor (n, n)."""
    for i in range(len(right)):
        for k in range(i):
            for column in range(right.shape[1]):
                right[i, column] -= root[i, k] * right[k, column]
        for column in range(right.shape[1]):
            right[i, column] /= root[i, i]
    for i in range(len(right) - 1, -1, -1):
        for k in range(i + 1, len(right)):
            for column in range(right.shape[1]):
                right[i, column] -= root[k, i] * right[k, column]
        for column in range(right.shape[1]):
            right[i, column] /= root[i, i]


@compiled
def invert(root: Array, inverse: Array) -> None:
    """Fill in the inverse (n, n) of the matrix that a lower Cholesky factor (n, n) belongs to."""
    for i in range(len(root)):
        for j in range(len(root)):
            inverse[i, j] = 1.0 if i == j else 0.0
    solve_each(root, inverse)


@compiled
def rotation_vectors(turns: Array, vectors: Array) -> None:
    """Fill in rotation vectors (n, 3), rad, of turns (n, 3, 3), by quaternion (Shepperd, 1978)."""
    q = [0.0, 0.0, 0.0, 0.0]  # x, y, z, w
    for n in range(len(turns)):
        m = turns[n]
        trace = m[0, 0] + m[1, 1] + m[2, 2]
        i = 3
        for j in range(3):
            if m[j, j] > (trace if i == 3 else m[i, i]):
                i = j
        if i == 3:
            q[0], q[1], q[2] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
            q[3] = 1.0 + trace
        else:
            j, k = (i + 1) % 3, (i + 2) % 3
            q[i] = 1.0 + m[i, i] - m[j, j] - m[k, k]
            q[j], q[k] = m[j, i] + m[i, j], m[k, i] + m[i, k]
            q[3] = m[k, j] - m[j, k]
        size = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
        sign = -1.0 if q[3] < 0.0 else 1.0  # the shorter way round
        factor = sign * (2.0 * math.atan2(size, sign * q[3]) / size if size > 0.0 else 0.0)
        for i in range(3):
            vectors[n, i] = factor * q[i]


@compiled
def copy_to(target: NDArray[np.floating], source: NDArray[np.floating]) -> None:
    """Copy (n,) entry by entry: numba compiles slice assignment ten times as long."""
    for k in range(len(target)):
        target[k] = source[k]


@compiled
def select(values: Array, rank: int) -> float:
    """Find the entry of a rank, from 0, by Hoare's quickselect on a copy; (n,) in any order."""
    rest = np.empty(len(values))
    copy_to(rest, values)
    low, high = 0, len(values) - 1
    while low < high:
        pivot, i, j = rest[(low + high) // 2], low, high
        while i <= j:
            while rest[i] < pivot:
                i += 1
            while pivot < rest[j]:
                j -= 1
            if i <= j:
                rest[i], rest[j] = rest[j], rest[i]
                i += 1
                j -= 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return float(rest[rank])


@compiled
def median(values: Array) -> float:
    """Median of (n,), as numpy's."""
    half = len(values) // 2
    if len(values) % 2:
        return select(values, half)
    return (select(values, half - 1) + select(values, half)) / 2.0


@compiled
def motion_misfits(
    ends: NDArray[np.int64],
    known: NDArray[np.bool_],
    poses: Array,
    measured: tuple[Array, Array],
    most: float,
    cost: Array,
) -> None:
    """Fill in `cost` (o,): mean squared misfit of the motions read to those measured, at o offsets.

    `ends` (o, 2, n): which of the flange's poses read (g, 4, 4) begins and ends each of n motions;
    `known` (o, n): those with readings. `measured`: the motions' angle and distance, and the
    variance of each, (n, 2) both. A squared misfit counts for `most` at most: a wild pair has one
    vote. An analysis compares hundreds of motions at hundreds of offsets.
    """
    figures, variance = measured
    for o in range(len(ends)):
        total, count = 0.0, 0
        for n in range(len(figures)):
            if not known[o, n]:
                continue
            count += 2
            angle, distance = motion_between(poses[ends[o, 0, n]], poses[ends[o, 1, n]])
            total += min((angle - figures[n, 0]) ** 2 / variance[n, 0], most)
            total += min((distance - figures[n, 1]) ** 2 / variance[n, 1], most)
        cost[o] = total / count


@compiled
def motion_between(one: Array, other: Array) -> tuple[float, float]:
    """Give angle (rad) and distance (m) of the motion between two poses (4, 4)."""
    turn = away = 0.0
    for i in range(3):
        for j in range(3):
            turn += (one[i, j] - other[i, j]) ** 2
        away += (one[i, 3] - other[i, 3]) ** 2
    # the Frobenius norm of two rotations' difference is sqrt(8) times the sine of half the angle
    return 2.0 * math.asin(min(math.sqrt(turn / 8.0), 1.0)), math.sqrt(away)


@compiled
def motion_sizes(one: Array, other: Array, figures: Array) -> None:
    """Fill in the same of n pairs of poses (n, 4, 4): (n, 2)."""
    for n in range(len(figures)):
        figures[n, 0], figures[n, 1] = motion_between(one[n], other[n])
