"""How the right camera stands to the left one, as most pairs agree."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from verify.board import Board
from verify.calibration.gauge import FIXED
from verify.records import Array

SAME_TURN = np.deg2rad(10.0)  # two relations that agree, bases fixed: poses of one view err by 1°
SAME_TURN_TURNED = np.deg2rad(20.0)  # bases turned: mounts and axes are still taken as ideal


@dataclass(frozen=True, slots=True)
class Relation:
    """How the right camera stands to the left one, both bases turned back to zero."""

    left_T_right: Array  # (4, 4)
    axes: Array  # (2, 3), left and right: ±y, the sense in which the readings grow
    half_turned: tuple[int, ...]  # pairs that agree once one view is numbered from the far end
    strangers: tuple[int, ...]  # pairs that agree neither way
    quarter_turned: tuple[int, ...]  # of these, those that agree once one view is turned by 90°
    scatter: float  # rad, median angle between the pairs' relations and this one


def relate(
    left: dict[int, Array], right: dict[int, Array], board: Board, pan: Array, bases: Sequence[str]
) -> Relation:
    """Find the relation of the cameras on which most pairs agree.

    A pattern that looks the same after half a turn may have been numbered from its other end in
    one camera. Such a pair's relation is half a turn off, about an axis that changes with the
    board; each pair may speak for a relation either way, and the relation is taken from those
    that do, fewest half turns first.

    Args:
        left: camera_T_board by pair, (4, 4).
        right: likewise.
        board: the pattern.
        pan: (b, 2), rad, readings.
        bases: left and right; one that never turned counts as standing at zero.
    """
    both = sorted(set(left) & set(right))
    lefts = np.array([left[i] for i in both])
    rights = np.asarray(np.linalg.inv([right[i] for i in both]), dtype=np.float64)
    senses = [(1.0,) if base == FIXED else (1.0, -1.0) for base in bases]
    tolerance = SAME_TURN if all(b == FIXED for b in bases) else SAME_TURN_TURNED
    found = []
    for sense in itertools.product(*senses):
        axes = np.array([0.0, 1.0, 0.0]) * np.array(sense)[:, None]
        back = [
            _turns(axis * (base != FIXED), angle)
            for axis, base, angle in zip(axes, bases, pan[both].T, strict=True)
        ]
        straight, halved = (
            back[0] @ lefts @ relabelled @ rights @ back[1].transpose(0, 2, 1)
            for relabelled in (np.eye(4), _half_turn(board))
        )
        relation, price = _consensus(straight, halved, both, axes, tolerance)
        if board.four_fold:
            quarters = [back[0] @ lefts @ turn @ rights @ back[1].transpose(0, 2, 1)
                        for turn in _quarter_turns(board)]  # fmt: skip
            relation = _with_quarters(relation, quarters, both, tolerance)
        found.append((relation, price))
    return min(found, key=lambda f: f[1])[0]


def _half_turn(board: Board) -> Array:
    """Number the corners from the far end: index i becomes n - 1 - i."""
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    turn[:3, 3] = board.points[-1]
    return turn


def _quarter_turns(board: Board) -> tuple[Array, Array]:
    """Number the corners of a square board from the next corner, either way round."""
    edge = board.points[-1, 0]
    one = np.eye(4)
    one[:3] = [[0.0, -1.0, 0.0, edge], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    return one, np.asarray(np.linalg.inv(one), dtype=np.float64)


def _with_quarters(
    relation: Relation, quarters: Sequence[Array], both: Sequence[int], tolerance: float
) -> Relation:
    """Say which strangers agree once one view is numbered a quarter turn on."""
    gaps = np.min([_angles(relation.left_T_right[None], turned)[0] for turned in quarters], axis=0)
    agree = {i for i, gap in zip(both, gaps, strict=True) if gap < tolerance}
    return replace(relation, quarter_turned=tuple(i for i in relation.strangers if i in agree))


def _turns(axis: Array, angle: Array) -> Array:
    """Motions (b, 4, 4) that turn about an axis through the origin by angles (b,)."""
    turns = np.tile(np.eye(4), (len(angle), 1, 1))
    turns[:, :3, :3] = Rotation.from_rotvec(angle[:, None] * axis).as_matrix()
    return turns


def _consensus(
    straight: Array, halved: Array, both: list[int], axes: Array, tolerance: float
) -> tuple[Relation, float]:
    """The relation with the least sum of angles, each pair either way; and that sum."""
    candidates = np.concatenate([straight, halved])
    plain = _angles(candidates, straight)
    other = _angles(candidates, halved)
    nearest = np.minimum(np.minimum(plain, other), 2 * tolerance)  # one stranger outvotes nobody
    flipped = other + tolerance < plain
    # of relations that differ within the tolerance, the one that needs fewest half turns
    price = nearest.sum(axis=1) + 0.5 * tolerance * flipped.sum(axis=1)
    k = int(np.argmin(price))
    turned, gap = flipped[k], np.minimum(plain[k], other[k])
    agree = gap < tolerance
    if not agree.any():
        agree = gap <= gap.min()
    chosen = np.where(turned[:, None, None], halved, straight)[agree]
    left_T_right = np.eye(4)
    left_T_right[:3, :3] = Rotation.from_matrix(chosen[:, :3, :3]).mean().as_matrix()
    left_T_right[:3, 3] = np.median(chosen[:, :3, 3], axis=0)
    half = tuple(i for i, t, a in zip(both, turned, agree, strict=True) if t and a)
    strangers = tuple(i for i, a in zip(both, agree, strict=True) if not a)
    return Relation(left_T_right, axes, half, strangers, (), float(np.median(gap))), float(price[k])


def _angles(one: Array, other: Array) -> Array:
    """Angle between every rotation of one (a) and of the other (b), (a, b), rad."""
    trace = np.einsum("aij,bij->ab", one[:, :3, :3], other[:, :3, :3])
    angles: Array = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    return angles
