"""Where an arm's links are at many postures at once, whatever describes the arm."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robots import Arm
from robots.coupling import LENGTH_SCALE
from verify.calibration.kinematics.chain import KinematicChain, chain_of, link_transforms
from verify.core.records import Array

SPACING = 0.06  # m between the points that stand for a link


@dataclass(frozen=True, eq=False)
class LinkChain:
    """A chain of revolute joints; j of them."""

    chain: KinematicChain

    @cached_property
    def links(self) -> Array:
        """What follows each joint's turn, (j, 4, 4)."""
        return link_transforms(self.chain)

    def frames(self, q: Array) -> Array:
        """The frame in which each joint turns, and the flange's: (m, j) to (m, j + 1, 4, 4)."""
        chain = self.chain
        theta = chain.sign * q + chain.offset
        frame = np.tile(chain.base_T_first, (len(q), 1, 1))
        frames = np.empty((len(q), chain.dof + 1, 4, 4))
        for j in range(chain.dof):
            frames[:, j] = frame
            frame = frame @ _turns(theta[:, j]) @ self.links[j]
        frames[:, -1] = frame @ chain.last_T_flange
        return frames

    def points(self, frames: Array) -> Array:
        """Points along the links, from the base to the flange: (m, p, 3), m."""
        corners = [np.zeros((len(frames), 3)), frames[:, 0, :3, 3]]
        for j in range(self.chain.dof):
            origin, axis = frames[:, j, :3, 3], frames[:, j, :3, 2]
            corners += [origin + self.chain.d[j] * axis, frames[:, j + 1, :3, 3]]
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
    def _lengths(self) -> Array:
        """Lengths of the straight pieces between the corners, (2 j + 1,), m."""
        frames = self.frames(np.zeros((1, self.chain.dof)))[0]
        lengths = [float(np.linalg.norm(frames[0, :3, 3]))]
        for j in range(self.chain.dof):
            after = frames[j + 1, :3, 3] - frames[j, :3, 3] - self.chain.d[j] * frames[j, :3, 2]
            lengths += [abs(float(self.chain.d[j])), float(np.linalg.norm(after))]
        return np.array(lengths)

    @cached_property
    def _shares(self) -> tuple[Array, Array]:
        """Of each point: its share of a piece's length, and which piece."""
        shares, pieces = [], []
        for piece, length in enumerate(self._lengths.tolist()):
            count = int(np.ceil(length / SPACING))
            shares += [(k + 1) / count for k in range(count)]
            pieces += [piece] * count
        return np.array(shares), np.array(pieces, dtype=np.int64)


def build_skeleton(arm: Arm) -> LinkChain:
    """Lay an arm out as a chain."""
    return LinkChain(chain_of(arm))


def dexterity(frames: Array) -> Array:
    """Least singular value of the Jacobian, lengths over 143 mm, (m,): 0 at a singularity."""
    axes, flange = frames[:, :-1, :3, 2], frames[:, -1, :3, 3]
    levers = flange[:, None] - frames[:, :-1, :3, 3]
    columns = np.concatenate([np.cross(axes, levers) / LENGTH_SCALE, axes], axis=2)
    return np.asarray(np.linalg.svd(columns, compute_uv=False)[:, -1])


def _turns(angle: Array) -> Array:
    """Turns about z, (m,) rad to (m, 4, 4)."""
    turns = np.zeros((len(angle), 4, 4))
    c, s = np.cos(angle), np.sin(angle)
    turns[:, 0, 0], turns[:, 0, 1], turns[:, 1, 0], turns[:, 1, 1] = c, -s, s, c
    turns[:, 2, 2] = turns[:, 3, 3] = 1.0
    return turns
