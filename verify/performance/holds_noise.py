"""What the instrument alone scatters: measured positions while the arm stands still."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from verify.performance.holds import Rows
from verify.records import Array

FEWEST_FREEDOM = 20  # of the scatter within holds: fewer know it worse than what is stated


@dataclass(frozen=True, slots=True)
class Noise:
    """Scatter of one pair's position and turn at rest."""

    position: Array  # (3, 3), m²
    turn: Array  # (3, 3), rad²
    together: float  # >= 1, by which neighbouring pairs' likeness raises the variance of a mean
    source: str  # "holds": seen while the arm stood; "stated": the poses' own covariance
    freedom: int  # degrees of freedom, 0 where stated

    def of_means(self, counts: Array) -> tuple[Array, Array]:
        """Covariance (3, 3) that it gives visits of `counts` pairs each, mean over the visits."""
        factor = float(np.mean(np.minimum(self.together / counts, 1.0)))
        return self.position * factor, self.turn * factor


def static_noise(
    holds: Sequence[Rows], positions: Array, turns: Array, stated: tuple[Array, Array]
) -> Noise:
    """Pool the scatter within the holds.

    Args:
        holds: rows of each.
        positions: (n, 3), m, measured less read.
        turns: (n, 3), rad, likewise.
        stated: (3, 3) each, what the poses state, where too few holds have several pairs.
    """
    freedom = sum(len(rows) - 1 for rows in holds)
    if freedom < FEWEST_FREEDOM:
        return Noise(*stated, 1.0, "stated", 0)
    both = np.concatenate([positions, turns], axis=1)
    inside = [both[rows] - both[rows].mean(axis=0) for rows in holds if len(rows) > 1]
    square = sum(one.T @ one for one in inside) / freedom
    return Noise(square[:3, :3], square[3:, 3:], _together(inside), "holds", freedom)


def _together(inside: Sequence[Array]) -> float:
    """Factor (1 + r) / (1 - r) of a first-order process, r the neighbours' correlation.

    Taking a hold's own mean off lowers r by about one over its pairs; that is put back.
    """
    scale = np.sqrt(sum(np.sum(one**2, axis=0) for one in inside))
    scale = np.where(scale > 0, scale, 1.0)
    ahead = float(sum(np.sum(one[1:] * one[:-1] / scale**2) for one in inside)) / 6
    lengths = np.array([len(one) for one in inside])
    r = ahead + float(np.sum(lengths - 1) / np.sum(lengths)) / float(lengths.mean())
    r = min(max(r, 0.0), 0.95)
    return (1 + r) / (1 - r)
