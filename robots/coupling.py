"""Near a singularity: which joints the flange's pose cannot tell apart.

The gates are set so that a joint's standard uncertainty is let grow to about five times its own at
the best posture, everywhere alike. At the wrist u(θ4) grows as 1 / |sin θ5|: the gate is 0.2. The
elbow's grows as 1 / |sin| of the angle between its links' lines: 0.2 as well. Joint 1's is
u(wrist) / ρ, with ρ the wrist's distance from axis 1. At the wrist's gate u(θ4) is
u(orientation) / 0.2, and a good stereo pose is known to 0.25 mm and 0.10°, whose ratio is
143 mm: the two are equal at ρ = 0.2 · 143 mm.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robots import spherical_wrist
from robots.arm import Arm, DhArm, UrdfArm
from robots.elementary import Number, cos, sin
from robots.kinematics import forward, jacobian
from robots.transforms import Array

WRIST_GATE = 0.2  # |sin θ5|
ELBOW_GATE = 0.2  # |sin| of the angle between the links' lines
LENGTH_SCALE = 0.143  # m a rad: what a stereo pose's 0.25 mm is to its 0.10°
SHOULDER_GATE = 0.2 * LENGTH_SCALE  # m, the wrist's distance from axis 1
# least singular value of J, lengths over LENGTH_SCALE; a 6R's is this at WRIST_GATE
URDF_GATE = 0.1
GATE_MARGIN = 1.001  # of a gate: above, rounding cannot bring a factor below it
MIN_SHARE = 0.1  # of the largest share: a joint below moves too little to be in doubt
TOL_ON_AXIS = 1e-9  # m: Newton has put the wrist on axis 1
MAX_SUM_JOINTS = 4  # joints: the 6R's straight wrist; among more signs one fits by chance
# a sum that the singular direction leaves alone, at the singular posture itself
TOL_ORTHOGONAL = 1e-6


@dataclass(frozen=True, eq=False)
class Coupling:
    """Joints that share a motion which leaves the flange (all but) still."""

    joints: tuple[int, ...]  # counted from 0
    # (n,) of 1, -1 and 0: this sum of q stays determined; None if no such
    combination: Array | None
    # what is near zero: wrist, elbow, shoulder, several joined by "+"; or singular value
    factor: str
    value: float  # of the first factor: |sin|, or m for the shoulder, or the singular value

    @property
    def label(self) -> str:
        """The joints counted from 1, as reports name them: 4+6."""
        return "+".join(str(joint + 1) for joint in self.joints)


def coupled(arm: Arm, q: Array, base_T_flange: Array | None = None) -> Coupling | None:
    """Say which joints cannot be told apart at q (n,), rad; None where all can.

    `base_T_flange` (4, 4), m: `forward` of q, where it is known.

    For a DH arm each factor of det J has its gate; the joints are those that the singular direction
    moves at the singular posture next to q, of all that are near. For a URDF the singular values of
    J, lengths divided by 143 mm, are looked at instead; more than six joints are always coupled.
    """
    q = np.asarray(q, dtype=float)
    if isinstance(arm, UrdfArm):
        return _by_singular_values(arm, q)
    assert isinstance(arm, DhArm)
    theta = arm.theta(q)
    pose = forward(arm, q) if base_T_flange is None else base_T_flange
    factors = _factors(arm, pose.tolist(), theta.tolist())
    near = [(name, value) for name, value, gate in factors if value < gate]
    if not near:
        return None
    names = [name for name, _ in near]
    stills = [_self_motions(arm, theta, name, names) for name in names]
    return _coupling(stills, TOL_ORTHOGONAL, "+".join(names), near[0][1])


def couplings(
    arm: Arm, q: Array, base_T_flange: Array | None = None
) -> tuple[Coupling | None, ...]:
    """Say the same of many postures (m, n), rad; those of a DH arm are looked at together.

    `base_T_flange` (m, 4, 4), m: `forward` of the postures, where it is known.
    """
    q = np.asarray(q, dtype=float)
    if not len(q) or not isinstance(arm, DhArm):
        return tuple(coupled(arm, one) for one in q)
    pose = forward(arm, q) if base_T_flange is None else base_T_flange
    if len(q) == 1:
        return (coupled(arm, q[0], pose[0]),)
    factors = _factors(arm, list(np.moveaxis(pose, 0, -1)), list(arm.theta(q).T))
    near = np.any([value < GATE_MARGIN * gate for _, value, gate in factors], 0)
    return tuple(coupled(arm, one) if close else None for one, close in zip(q, near, strict=True))


def _self_motions(arm: DhArm, theta: Array, name: str, near: list[str]) -> Array:
    """Joint motions (k, 6) that leave the flange still where one factor vanishes.

    Another factor that is small as well is opened to a quarter turn first, so that its own joints'
    share does not hide this one's.
    """
    theta = theta.copy()
    stretched = _stretched_elbow(arm)
    for other, joint, zero in (("wrist", 4, 0.0), ("elbow", 2, stretched)):
        if other in near:
            nearest = zero + np.pi * np.round((theta[joint] - zero) / np.pi)
            theta[joint] = nearest if other == name else nearest + np.pi / 2
    if name == "shoulder":
        _move_to_axis(arm.unlinked, theta)
    _, s, vt = np.linalg.svd(_scaled_jacobian(arm, arm.joint_angles(theta)))
    return np.asarray(vt[np.minimum(s, s[-1] + TOL_ORTHOGONAL) == s])


def _factors(
    arm: DhArm, pose: Sequence[Any], theta: Sequence[Number]
) -> list[tuple[str, Number, float]]:
    """What vanishes at singularities, numbers like the pose's and angles', and the gate of each."""
    return [
        ("wrist", abs(sin(theta[4])), WRIST_GATE),
        ("elbow", abs(sin(theta[2] - _stretched_elbow(arm))), ELBOW_GATE),
        ("shoulder", abs(_wrist_distance(arm, pose, theta)), SHOULDER_GATE),
    ]


def _stretched_elbow(arm: DhArm) -> float:
    """θ3 at which the elbow is stretched."""
    return spherical_wrist.forearm(arm)[1] if arm.family == "spherical_wrist" else 0.0


def _wrist_distance(arm: DhArm, pose: Sequence[Any], theta: Sequence[Number]) -> Number:
    """The wrist's signed distance from axis 1, m, in the plane that θ1 turns."""
    d6 = float(arm.d[5])
    (_, _, ax, px), (_, _, ay, py), *_ = pose
    return cos(theta[0]) * (px - d6 * ax) + sin(theta[0]) * (py - d6 * ay)


def _wrist_slopes(arm: DhArm, pose: Array, q: Array, theta: Array) -> Array:
    """How the wrist's distance from axis 1 changes with each joint, (6,), m/rad."""
    moves = jacobian(arm, q)
    outward = np.array([np.cos(theta[0]), np.sin(theta[0]), 0.0])
    slopes: Array = outward @ (moves[:3] - np.cross(moves[3:], arm.d[5] * pose[:3, 2], axis=0))
    slopes[0] = 0.0  # the arm's plane turns along
    return slopes


def _move_to_axis(arm: DhArm, theta: Array) -> None:
    """Move the wrist onto axis 1 by the shortest way, in place: Newton on its distance."""
    for _ in range(20):  # four or five bring rounding
        q = arm.joint_angles(theta)
        pose = forward(arm, q)
        distance = _wrist_distance(arm, pose.tolist(), theta.tolist())
        slopes = arm.sign * _wrist_slopes(arm, pose, q, theta)  # by θ
        if abs(distance) < TOL_ON_AXIS or not slopes.any():
            return
        theta -= distance * slopes / (slopes @ slopes)


def _by_singular_values(arm: UrdfArm, q: Array) -> Coupling | None:
    _, s, vt = np.linalg.svd(_scaled_jacobian(arm, q))
    values = np.zeros(arm.dof)
    values[: len(s)] = s
    near = values < URDF_GATE
    if not near.any():
        return None
    # a sum stays determined if this direction adds a fifth of the pose's own noise to it, or less
    least = float(values[near].max())
    name = "redundancy" if arm.dof > len(s) else "singular value"
    return _coupling([vt[near]], max(TOL_ORTHOGONAL, least / 5), name, float(values[-1]))


def _scaled_jacobian(arm: Arm, q: Array) -> Array:
    moves = jacobian(arm, q)
    moves[:3] /= LENGTH_SCALE
    return moves


def _coupling(stills: list[Array], tolerance: float, factor: str, value: float) -> Coupling:
    shares = np.array([np.linalg.norm(still, axis=0) for still in stills])
    shares /= shares.max(axis=1, keepdims=True)
    share = shares.max(axis=0)
    # a plain sum needs all its joints, however little one of them moves
    involved = tuple(int(i) for i in np.flatnonzero(share > tolerance))
    combination = _combination(np.concatenate(stills), involved, tolerance)
    if combination is None:
        involved = tuple(int(i) for i in np.flatnonzero(share > MIN_SHARE))
        combination = _combination(np.concatenate(stills), involved, tolerance)
    return Coupling(involved, combination, factor, value)


def _combination(still: Array, joints: tuple[int, ...], tolerance: float) -> Array | None:
    """Find the sum of the joints, each counted + or -, that no still direction changes."""
    if len(joints) > MAX_SUM_JOINTS:
        return None
    for signs in itertools.product((1.0, -1.0), repeat=len(joints) - 1):
        sums = np.zeros(still.shape[1])
        sums[list(joints)] = (1.0, *signs)
        if np.abs(still @ sums).max() < tolerance:
            return sums
    return None
