"""Residuals on poses held out, and the model that predicts them best.

Held-out poses count whether outlying or not. Models are compared by their squared distances in
units of the noise that the richest model leaves, each pose's capped at MAX_CHI2: an outlying one
weighs the same in every model. A larger model is taken where it predicts better by more than the
scatter of that difference from block to block.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.calibration.kinematics.fit import (
    FitState,
    KinematicFit,
    minimise,
    pose_residuals,
    tolerances,
)
from verify.calibration.kinematics.noise import NoiseScale
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.core.records import Array, take_rows

MAX_CHI2 = 25.0  # that a row may bring: noise brings a full pose's beyond it in 3 of 10,000
MIN_GAIN_SIGMA = 1.0  # standard deviations by which a larger model must predict better


@dataclass(frozen=True, slots=True)
class HoldOut:
    """How poses are held out."""

    splits: int = 10  # 0: none
    share: float = 0.3  # of the rows
    seed: int = 1


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Residuals on rows held out, means over the splits, outlying rows included."""

    splits: int
    rows: int  # held out in each, about
    position: Array  # (3,), m: mean, rms, greatest
    orientation: Array  # (3,), rad; nan where only positions were measured
    chi2: Array  # (n,), capped, a measured number; nan: never held out


def split(
    poses: IdentificationPoses, share: float, generator: np.random.Generator
) -> NDArray[np.bool_]:
    """Hold out a share of the blocks of every base; (n,), True where held out."""
    held = np.zeros(len(poses), dtype=bool)
    for base in np.unique(poses.base):
        own = poses.base == base
        blocks = np.unique(poses.block[own])
        some_blocks = generator.permutation(blocks)[: max(1, round(share * len(blocks)))]
        held |= own & np.isin(poses.block, some_blocks)
    return held


def statistics(left: Array) -> Array:
    """Mean, rms and greatest length of vectors (n, 3)."""
    length = np.linalg.norm(left, axis=1)
    return np.array([length.mean(), np.sqrt(np.mean(length**2)), length.max()])


def hold_out(
    fit: KinematicFit, poses: IdentificationPoses, noise: NoiseScale, options: HoldOut
) -> CrossValidation | None:
    """Fit on one part and evaluate on the other, several times; None: too few rows.

    Each fit starts at the one of all rows and leaves its outlying rows out; distances are measured
    by the noise.
    """
    generator = np.random.default_rng(options.seed)
    start = FitState(fit.state, fit.change / tolerances(fit.parameters))
    positions, turns, counts = [], [], []
    total, times = np.zeros(len(poses)), np.zeros(len(poses))
    for _ in range(options.splits):
        held = split(poses, options.share, generator)
        training = take_rows(poses, ~held & fit.used)
        if int(training.dimensions.sum()) < len(fit.parameters) or not held.any():
            return None
        judged = take_rows(poses, held)
        left = pose_residuals(minimise(start, training, fit.parameters, fit.scale)[0].state, judged)
        positions.append(statistics(left[:, :3]))
        turns.append(statistics(left[:, 3:]))
        counts.append(int(held.sum()))
        chi2 = np.minimum(np.sum(noise.whiten(judged, left) ** 2, axis=1), MAX_CHI2)
        total[held] += chi2 / np.maximum(judged.dimensions, 1)
        times[held] += 1
    if not positions:
        return None
    blind = np.full(3, np.nan)
    return CrossValidation(
        splits=options.splits,
        rows=round(float(np.mean(counts))),
        position=np.mean(positions, axis=0),
        orientation=blind if poses.position_only else np.mean(turns, axis=0),
        chi2=np.where(times > 0, total / np.maximum(times, 1), np.nan),
    )


def best_model(found: Sequence[CrossValidation | None], block: NDArray[np.int64]) -> int:
    """Choose the model that predicts best, the smaller where that makes no clear difference.

    The smallest model stands first; one without is not chosen. Rows of one block (n,) repeat each
    other.
    """
    best = 0
    for k, larger in enumerate(found[1:], start=1):
        smaller = found[best]
        if larger is None or smaller is None:
            continue
        gain = smaller.chi2 - larger.chi2
        known = np.isfinite(gain)
        labels, place = np.unique(block[known], return_inverse=True)
        by_block = np.bincount(place, gain[known]) / np.bincount(place)
        scatter = by_block.std(ddof=1) / np.sqrt(len(labels)) if len(labels) > 1 else np.inf
        if by_block.mean() > MIN_GAIN_SIGMA * scatter:
            best = k
    return best
