"""Measured poses with readings as arrays."""

from dataclasses import dataclass

import numpy as np

from verify.core.records import Array, Index, rigid_transform

SAME_POSTURE = np.deg2rad(0.5)  # joints that differ by less are in one posture


@dataclass(frozen=True, slots=True)
class IdentificationPoses:
    """n rows; j joints. Twists are (translation, rotation vector) at the target, world axes."""

    q: Array  # (n, j), rad, as read
    world_T_target: Array  # (n, 4, 4), m; where only positions were measured, no turn
    whitener: Array  # (n, 6, 6): times a twist, unit variance; zero rows where nothing is known
    stated: bool  # the covariances were stated; else only their proportions count
    base: Index  # (n,), from 0: which placing of the robot in the world
    tool: Index  # (n,), from 0: which mounting of the target
    recording: Index  # (n,), which of several the row is from
    block: Index  # (n,): rows of one block are held out together, as they repeat each other
    nuisance: Array  # (n, 6, p), of unit variance: what does not average out
    position_only: bool
    votes: Array  # (n, 6), how many independent numbers each whitened one counts for, at most 1

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.q)

    @property
    def dimensions(self) -> Index:
        """How many numbers each row determines, (n,)."""
        return np.asarray(np.any(self.whitener != 0, axis=2).sum(axis=1))

    @property
    def posture(self) -> Index:
        """Which rows share posture, base and tool, (n,) from 0: they show noise, no more."""
        key = np.column_stack([np.round(self.q / SAME_POSTURE), self.base, self.tool])
        return np.asarray(np.unique(key, axis=0, return_inverse=True)[1])

    @property
    def first_visits(self) -> Index:
        """The first row of each posture."""
        return np.asarray(np.unique(self.posture, return_index=True)[1])

    @property
    def numbers(self) -> float:
        """How many independent numbers were measured."""
        return float(np.sum(self.votes * np.any(self.whitener != 0, axis=2)))


def build_poses(
    q: Array,
    measured: Array,
    covariance: Array | None = None,
    *,
    nuisance: Array | None = None,
    determined: tuple[Array, ...] | None = None,
) -> IdentificationPoses:
    """Gather poses or positions of one point with the readings q (n, j), rad, at their instants.

    `measured` is (n, 4, 4) or (n, 3), m, in any fixed frame, its covariance (n, 6, 6) or (n, 3, 3),
    m and rad; None: not known, and estimated from what is left, one variance for positions and one
    for turns. `nuisance` (n, 6, p) holds effects of unit variance that all rows share, `determined`
    n functionals (6, d) of a pose that were measured, all where not given. Placing of the robot,
    mounting of the target and recording are one, and each row is a block by itself.

    Raises:
        ValueError: shapes that do not fit together.
    """
    n = len(q)
    position_only = measured.ndim == 2
    size = 3 if position_only else 6
    if len(measured) != n or (covariance is not None and covariance.shape != (n, size, size)):
        raise ValueError(f"{n} readings, measured {measured.shape}, covariance of another shape")
    targets = rigid_transform(np.eye(3), measured) if position_only else measured
    none = np.zeros(n, dtype=np.int64)
    return IdentificationPoses(
        q=np.asarray(q, dtype=float),
        world_T_target=np.asarray(targets, dtype=float),
        whitener=_whitener(n, size, covariance, determined),
        stated=covariance is not None,
        base=none,
        tool=none,
        recording=none,
        block=np.arange(n),
        nuisance=np.zeros((n, 6, 0)) if nuisance is None else nuisance,
        position_only=position_only,
        votes=np.ones((n, 6)),
    )


def _whitener(
    n: int, size: int, covariance: Array | None, determined: tuple[Array, ...] | None
) -> Array:
    whitener = np.zeros((n, 6, 6))
    if covariance is None:
        whitener[:, range(size), range(size)] = 1.0
    elif determined is None:
        whitener[:, :size, :size] = np.linalg.inv(np.linalg.cholesky(covariance))
    else:
        for i, known in enumerate(determined):
            own = np.linalg.cholesky(known.T @ covariance[i] @ known)
            whitener[i, : known.shape[1]] = np.linalg.solve(own, known.T)
    return whitener
