"""Arms: joints with limits, and either a DH table or a URDF chain."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from robots.elementary import Number
from robots.transforms import Array, invert

if TYPE_CHECKING:
    import pinocchio  # 50 MB: loaded for a URDF, or to check an arm

QUARTER_TURN = np.pi / 2
Vector = tuple[Number, Number, Number]
Frame = tuple[Vector, Vector, Vector, Vector]  # x, y, z axes and origin, in the base frame


@dataclass(frozen=True, eq=False)
class Arm:
    """What every arm states; joint angles q are the robot file's own, in radians."""

    name: str
    description: str
    source: str  # where the numbers come from, and what could not be checked
    fingerprint: str  # sha256 of the definition file's bytes, hexadecimal
    lower: Array  # (n,), limits of q
    upper: Array  # (n,)
    # (n,), greatest rates of each joint; None where the arm's file states none
    speed: Array | None = field(default=None, kw_only=True)  # rad/s
    acceleration: Array | None = field(default=None, kw_only=True)  # rad/s²
    jerk: Array | None = field(default=None, kw_only=True)  # rad/s³
    # (n, n), whole numbers, ones on its diagonal and zeros above: axes turn by linkage @ q where a
    # joint's motor drives later links as well; None where each joint turns its own axis alone
    linkage: Array | None = field(default=None, kw_only=True)

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.lower)

    @cached_property
    def unlinked(self) -> Self:
        """The arm whose joint angles are `axis_angles`; its limits mean nothing."""
        return replace(self, linkage=None)

    def axis_angles(self, q: Array) -> Array:
        """By how much each axis itself turns at joint angles q (..., n), rad."""
        return q if self.linkage is None else q @ self.linkage.T

    def axis_formula(self, joint: int) -> str:
        """What a joint's axis turns by, in joints counted from 1: q3, or q3 - q2."""
        factors = np.eye(self.dof)[joint] if self.linkage is None else self.linkage[joint]
        terms = [f"{factors[k]:+g}·q{k + 1}" for k in range(joint - 1, -1, -1) if factors[k]]
        return " ".join([f"q{joint + 1}", *terms]).replace("+1·", "+ ").replace("-1·", "- ")

    def joint_angles_of(self, axis_angles: Array) -> Array:
        """Joint angles q (..., n) of `axis_angles`, rad."""
        if self.linkage is None:
            return axis_angles
        solved: Array = axis_angles @ np.rint(np.linalg.inv(self.linkage)).T
        return solved

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, eq=False)
class DhArm(Arm):
    """Six revolute joints in standard DH: RotZ(θ) TransZ(d) TransX(a) RotX(α).

    θ = sign · q + offset, joint by joint, of a linked arm with its `axis_angles` for q. The
    base is DH frame 0, the flange DH frame 6.
    """

    a: Array  # (6,), m
    d: Array  # (6,), m
    alpha: Array  # (6,), rad
    sign: Array  # (6,), +1 or -1
    offset: Array  # (6,), rad
    family: str  # which closed form solves it

    def theta(self, q: Array) -> Array:
        """DH angles of joint angles, (..., 6)."""
        return self.sign * self.axis_angles(q) + self.offset

    def joint_angles(self, theta: Array) -> Array:
        """Joint angles q of DH angles, (..., 6)."""
        return self.joint_angles_of(self.sign * (theta - self.offset))

    @cached_property
    def links(self) -> list[tuple[float, float, float, float]]:
        """The table as plain numbers a, d, cos α, sin α, for loops over joints."""
        cosines, sines = np.cos(self.alpha), np.sin(self.alpha)
        quarters = np.round(self.alpha / QUARTER_TURN)
        # right angles are exact: 6e-17 for cos 90° would cost products and bring no truth
        exact = np.abs(self.alpha - quarters * QUARTER_TURN) < 1e-12
        cosines[exact], sines[exact] = np.round(cosines[exact]), np.round(sines[exact])
        return list(zip(*(v.tolist() for v in (self.a, self.d, cosines, sines)), strict=True))


@dataclass(frozen=True, eq=False)
class TableForm:
    """Six axes of a URDF as a DH table with a closed form, between two fixed motions.

    The table's joint angles are those of the axes, and its limits mean nothing. Read from the
    base, it turns joints 1 to 6; in `reverse`, 6 to 1, from the flange's side. A seventh joint is
    given.
    """

    table: DhArm
    base_T_table: Array  # (4, 4), m: table frame 0 in the arm's base
    base_T_tip: Array  # (4, 4), m: table frame 6 in the arm's base, at angles 0
    reverse: bool
    exact: bool = False  # else the file's own chain is near the table's, and answers are refined

    @property
    def searched(self) -> bool:
        """Whether one equation is left, whose roots are searched."""
        return self.table.family == "offset_wrist"

    def __str__(self) -> str:
        return f"{self.table.family}{', from flange to base' if self.reverse else ''}"


@dataclass(frozen=True, eq=False)
class UrdfArm(Arm):
    """A chain of revolute joints out of a URDF; every other joint of the file is locked at 0."""

    model: "pinocchio.Model"  # holds the chain's joints only
    base: str
    tip: str
    base_frame: int
    tip_frame: int
    joint_names: tuple[str, ...]
    closed_form: TableForm | None = None  # of its first six axes

    @cached_property
    def rest_frames(self) -> Array:
        """Joint frames at q = 0 with z along the joint's axis, then the flange: (n + 1, 4, 4), m.

        In the base.
        """
        import pinocchio

        data = self.model.createData()
        pinocchio.framesForwardKinematics(self.model, data, pinocchio.neutral(self.model))
        base = data.oMf[self.base_frame]
        frames = np.tile(np.eye(4), (self.dof + 1, 1, 1))
        for frame, name in zip(frames, self.joint_names, strict=False):
            number = self.model.getJointId(name)
            placed = base.actInv(data.oMi[number])
            axis = placed.rotation @ np.ravel(data.joints[number].S)[3:]
            across = np.linalg.svd(axis[None])[2][1]
            frame[:3] = np.column_stack([across, np.cross(axis, across), axis, placed.translation])
        frames[-1] = base.actInv(data.oMf[self.tip_frame]).homogeneous
        return frames

    @cached_property
    def steps(self) -> list[Frame]:
        """Joint 1's frame at rest, then the fixed motion from each to the next, as plain numbers.

        The last one leads to the flange.
        """
        rest = self.rest_frames
        fixed = [rest[0], *(invert(rest[:-1]) @ rest[1:])]
        steps: list[Any] = [tuple(map(tuple, motion[:3].T.tolist())) for motion in fixed]
        return steps
