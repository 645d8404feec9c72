"""Where an arm's links are at many postures at once, whatever describes the arm."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

import robots
from robots.coupling import LENGTH_SCALE
from verify.core.records import Array

SPACING = 0.06  # m between the points that stand for a link
TOL_SHARE = 1e-9  # of SPACING: a piece of rounding alone gets no point


@dataclass(frozen=True, eq=False)
class LinkChain:
    """An arm of j joints as straight pieces from the base to the flange.

    Each link goes along its joint's axis, then across to the next joint, as d and a of a DH table.
    """

    arm: robots.Arm

    def points(self, frames: Array) -> Array:
        """Points along the links of `robots.link_frames` (m, j + 1, 4, 4): (m, p, 3), m."""
        corners = [np.zeros((len(frames), 3)), frames[:, 0, :3, 3]]
        for j, along in enumerate(self._along):
            origin, axis = frames[:, j, :3, 3], frames[:, j, :3, 2]
            corners += [origin + along * axis, frames[:, j + 1, :3, 3]]
        whole = np.stack(corners, axis=1)
        share, before = self._shares
        points: Array = whole[:, before] * (1 - share)[:, None]
        points += whole[:, before + 1] * share[:, None]
        return points

    @cached_property
    def way(self) -> Array:
        """How far along the links each point is from the base, (p,), m."""
        share, before = self._shares
        along = np.concatenate([[0.0], np.cumsum(self._lengths)])
        way: Array = along[before] + share * self._lengths[before]
        return way

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Which points some joint moves, (p,): not those on the first axis."""
        return np.asarray(self.way > self._lengths[:2].sum() + SPACING / 10)

    @cached_property
    def _rest(self) -> Array:
        """Frames at q = 0, (j + 1, 4, 4), m."""
        rest: Array = robots.link_frames(self.arm, np.zeros((1, self.arm.dof)))[0]
        return rest

    @cached_property
    def _along(self) -> Array:
        """How far each link goes along its joint's axis, (j,), m."""
        steps = np.diff(self._rest[:, :3, 3], axis=0)
        along: Array = np.sum(steps * self._rest[:-1, :3, 2], axis=1)
        return along

    @cached_property
    def _lengths(self) -> Array:
        """Lengths of the straight pieces between the corners, (2 j + 1,), m."""
        frames = self._rest
        lengths = [float(np.linalg.norm(frames[0, :3, 3]))]
        for j, along in enumerate(self._along.tolist()):
            across = frames[j + 1, :3, 3] - frames[j, :3, 3] - along * frames[j, :3, 2]
            lengths += [abs(along), float(np.linalg.norm(across))]
        return np.array(lengths)

    @cached_property
    def _shares(self) -> tuple[Array, Array]:
        """Of each point: its share of a piece's length, and which piece."""
        shares, pieces = [], []
        for piece, length in enumerate(self._lengths.tolist()):
            count = int(np.ceil(length / SPACING - TOL_SHARE))
            shares += [(k + 1) / count for k in range(count)]
            pieces += [piece] * count
        return np.array(shares), np.array(pieces, dtype=np.int64)


def dexterity(frames: Array) -> Array:
    """Least singular value of the Jacobian, lengths over 143 mm, (m,): 0 at a singularity."""
    axes, flange = frames[:, :-1, :3, 2], frames[:, -1, :3, 3]
    levers = flange[:, None] - frames[:, :-1, :3, 3]
    columns = np.concatenate([np.cross(axes, levers) / LENGTH_SCALE, axes], axis=2)
    return np.asarray(np.linalg.svd(columns, compute_uv=False)[:, -1])
