"""The length of an error vector, and how well it is known."""

import numpy as np

from verify.records import Array


def length(vectors: Array, covariance: Array) -> tuple[Array, Array]:
    """Length (n,) of vectors (n, 3) of covariance (n, 3, 3), and its standard uncertainty (n,).

    nan where a vector is. Along the vector; a vector that is shorter than its uncertainty has no
    direction to speak of, and gets that of the least known one.
    """
    size: Array = np.linalg.norm(vectors, axis=1)
    along = vectors / np.where(size > 0, size, 1.0)[:, None]
    variance = np.einsum("ni,nij,nj->n", along, covariance, along)
    largest = np.linalg.eigvalsh(np.nan_to_num(covariance))[:, -1]
    variance = np.where(size**2 > largest, variance, largest)
    uncertainty: Array = np.sqrt(np.where(np.isnan(size), np.nan, variance))
    return size, uncertainty
