"""What faults would add beside a set of others, compiled: small matrices by the hundred."""

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled
from verify.records import Array
from verify.small_matrices import factor

Index = NDArray[np.int64]


@compiled
def whiten(gram: Array, moment: Array, at: Index, half: Array, led: Array) -> bool:
    """Carry columns and errors over the inverse root of a set's normal matrix.

    Args:
        gram: (p, p), products of all columns.
        moment: (p,), with the errors.
        at: (c,), the set's columns.
        half: (p, c), filled.
        led: (c,), filled.

    Returns:
        False where the set's columns cannot be told apart.
    """
    count = len(at)
    normal, root = np.empty((count, count)), np.empty((count, count))
    for a in range(count):
        for b in range(count):
            normal[a, b] = gram[at[a], at[b]]
    if not factor(normal, 0.0, root):
        return False
    for a in range(count):
        rest = moment[at[a]]
        for b in range(a):
            rest -= root[a, b] * led[b]
        led[a] = rest / root[a, a]
    for column in range(len(gram)):
        for a in range(count):
            rest = gram[at[a], column]
            for b in range(a):
                rest -= root[a, b] * half[column, b]
            half[column, a] = rest / root[a, a]
    return True


@compiled
def rest_beside(
    gram: Array, moment: Array, whitened: tuple[Array, Array], at: Index, block: Array, part: Array
) -> None:
    """Products of some faults' columns beside a set that is fitted, and with the errors.

    Args:
        gram: (p, p), as for `whiten`.
        moment: (p,), likewise.
        whitened: half and led, of `whiten`.
        at: (k, f), the faults' columns.
        block: (k, f, f), filled.
        part: (k, f), filled.
    """
    half, led = whitened
    for fault in range(at.shape[0]):
        for a in range(at.shape[1]):
            first = at[fault, a]
            told = moment[first]
            for c in range(len(led)):
                told -= half[first, c] * led[c]
            part[fault, a] = told
            for b in range(a + 1):
                second = at[fault, b]
                both = gram[first, second]
                for c in range(len(led)):
                    both -= half[first, c] * half[second, c]
                block[fault, a, b] = block[fault, b, a] = both
