"""How a model carries over to rows that it has not seen."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from verify.arm_identification.fit import fit, residual
from verify.arm_identification.parameters import Parameter, State
from verify.arm_identification.poses import Poses, some
from verify.records import Array


@dataclass(frozen=True, slots=True)
class HeldOut:
    """What is left on rows held out, means over the splits; all of them count, outlying or not."""

    splits: int
    rows: int  # held out in each, about
    position: Array  # (3,), m: mean, rms, greatest
    orientation: Array  # (3,), rad; nan where only positions were measured
    by_split: Array  # (splits,), m: mean position residual


def split(poses: Poses, share: float, generator: np.random.Generator) -> NDArray[np.bool_]:
    """Hold out a share of the blocks of every base and tool; (n,), True where held out."""
    held = np.zeros(len(poses), dtype=bool)
    for base, tool in sorted(set(zip(poses.base.tolist(), poses.tool.tolist(), strict=True))):
        own = (poses.base == base) & (poses.tool == tool)
        blocks = np.unique(poses.block[own])
        some_blocks = generator.permutation(blocks)[: max(1, round(share * len(blocks)))]
        held |= own & np.isin(poses.block, some_blocks)
    return held


def statistics(left: Array) -> Array:
    """Mean, rms and greatest length of vectors (n, 3)."""
    length = np.linalg.norm(left, axis=1)
    return np.array([length.mean(), np.sqrt(np.mean(length**2)), length.max()])


def hold_out(
    state: State,
    poses: Poses,
    parameters: tuple[Parameter, ...],
    splits: int,
    share: float,
    seed: int,
) -> HeldOut | None:
    """Fit on the one part, judge on the other, several times; None where there are too few rows.

    Args:
        state: where each fit starts; it shortens the way and does not move the minimum.
        poses: n rows.
        parameters: what is free.
        splits: how often.
        share: of the rows held out.
        seed: of the splits.
    """
    generator = np.random.default_rng(seed)
    positions, turns, counts = [], [], []
    for _ in range(splits):
        held = split(poses, share, generator)
        training = some(poses, ~held)
        if int(training.dimensions.sum()) < 2 * len(parameters) or not held.any():
            return None
        found = fit(state, training, parameters)
        left = residual(found.state, some(poses, held))
        positions.append(statistics(left[:, :3]))
        turns.append(statistics(left[:, 3:]))
        counts.append(int(held.sum()))
    if not positions:
        return None
    blind = np.full(3, np.nan)
    return HeldOut(
        splits=splits,
        rows=round(float(np.mean(counts))),
        position=np.mean(positions, axis=0),
        orientation=blind if poses.position_only else np.mean(turns, axis=0),
        by_split=np.array(positions)[:, 0],
    )
