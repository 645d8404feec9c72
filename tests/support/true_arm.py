"""An arm with known errors, built of pinocchio's motions and of nothing under test."""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio

import robots
from verify.calibration.kinematics.poses import IdentificationPoses, build_poses
from verify.core.records import Array

POSITION, ORIENTATION = 1e-4, np.radians(0.05)  # m, rad: noise of each measured pose


@dataclass(frozen=True)
class TrueArm:
    """What the file does not say: corrections of the readings, and of every link."""

    arm: robots.DhArm
    correction: Array  # (6,), rad
    d: Array  # (6,), m, errors, as a, alpha and beta
    a: Array
    alpha: Array
    beta: Array
    world_T_base: Array
    flange_T_target: Array

    def pose(self, q: Array) -> Array:
        """World_T_target, (n, 4, 4)."""
        return np.array([self._one(row) for row in q])

    def _one(self, q: Array) -> Array:
        theta = self.arm.sign * (q + self.correction) + self.arm.offset
        place = pinocchio.SE3(self.world_T_base)
        for j in range(6):
            place = place * _turn("z", theta[j]) * _shift(2, self.arm.d[j] + self.d[j])
            place = place * _shift(0, self.arm.a[j] + self.a[j])
            place = place * _turn("x", self.arm.alpha[j] + self.alpha[j]) * _turn("y", self.beta[j])
        return (place * pinocchio.SE3(self.flange_T_target)).homogeneous


def true_arm(name: str, seed: int, *, geometry: float = 1.0, offsets: float = 1.0) -> TrueArm:
    """Errors of about 0.3 mm and 0.3°, scaled; base and tool anywhere."""
    draw = np.random.default_rng(seed)
    arm = robots.load(name)
    assert isinstance(arm, robots.DhArm)
    angle = np.radians(0.3)
    return TrueArm(
        arm=arm,
        correction=offsets * draw.normal(0, angle, 6),
        d=geometry * draw.normal(0, 3e-4, 6),
        a=geometry * draw.normal(0, 3e-4, 6),
        alpha=geometry * draw.normal(0, angle, 6),
        beta=geometry * draw.normal(0, angle, 6) * (np.arange(6) == 1),
        world_T_base=_place(draw, 1.0),
        flange_T_target=_place(draw, 0.1),
    )


def faulty_arm(name: str, seed: int) -> TrueArm:
    """Offsets to 2°, lengths to 2 mm, twists to 0.5°, alike likely; base and tool anywhere."""
    draw = np.random.default_rng(seed)
    scale = {"correction": np.radians(2.0), "d": 2e-3, "a": 2e-3}
    begun = true_arm(name, seed)
    errors = {
        key: scale.get(key, np.radians(0.5)) * draw.uniform(-1, 1, 6)
        for key in ("correction", "d", "a", "alpha", "beta")
    }
    parallel = np.abs(np.sin(begun.arm.alpha)) < 0.1  # axes that DH's d cannot lean
    return replace(begun, **{**errors, "beta": errors["beta"] * parallel * (np.arange(6) < 5)})


def readings(arm: robots.Arm, count: int, seed: int) -> Array:
    """Postures all over the joints' ranges."""
    draw = np.random.default_rng(seed)
    return draw.uniform(np.maximum(arm.lower, -2.5), np.minimum(arm.upper, 2.5), (count, arm.dof))


def measured(truth: TrueArm, q: Array, seed: int) -> tuple[Array, Array]:
    """Noisy poses (n, 4, 4) and their covariances (n, 6, 6)."""
    draw = np.random.default_rng(seed)
    poses = truth.pose(q)
    for pose in poses:
        pose[:3, 3] += draw.normal(0, POSITION, 3)
        pose[:3, :3] = pinocchio.exp3(draw.normal(0, ORIENTATION, 3)) @ pose[:3, :3]
    variance = np.diag([POSITION**2] * 3 + [ORIENTATION**2] * 3)
    return poses, np.tile(variance, (len(q), 1, 1))


def recorded(
    truth: TrueArm, kind: str, count: int, noise: float, seed: int, *, stated: bool
) -> IdentificationPoses:
    """What an instrument with noise (m) gives: "poses", "positions", or three "points" a pose."""
    draw = np.random.default_rng(seed)
    q = readings(truth.arm, count, seed)
    poses = truth.pose(q)
    targets = draw.uniform(-0.1, 0.1, (3, 3)) if kind == "points" else np.zeros((1, 3))
    each = len(targets)
    places = np.einsum("nij,kj->nki", poses[:, :3, :3], targets) + poses[:, None, :3, 3]
    places = places.reshape(-1, 3) + draw.normal(0, noise, (each * count, 3))
    variance, seen = noise**2 * np.eye(3), places
    if kind == "poses":
        turn = noise / 0.2  # rad, of points 0.2 m apart
        variance, seen = np.diag([noise**2] * 3 + [turn**2] * 3), poses
        seen[:, :3, 3] = places
        for pose, by in zip(seen, draw.normal(0, turn, (count, 3)), strict=True):
            pose[:3, :3] = pinocchio.exp3(by) @ pose[:3, :3]
    covariance = np.tile(variance, (len(places), 1, 1)) if stated else None
    return replace(
        build_poses(np.repeat(q, each, axis=0), seen, covariance),
        tool=np.tile(np.arange(each), count),
        block=np.repeat(np.arange(count), each),
    )


def _place(draw: np.random.Generator, reach: float) -> Array:
    turn = pinocchio.exp3(draw.normal(0, 1.0, 3))
    return pinocchio.SE3(turn, draw.uniform(-reach, reach, 3)).homogeneous


def _turn(axis: str, angle: float) -> pinocchio.SE3:
    return pinocchio.SE3(pinocchio.utils.rotate(axis, float(angle)), np.zeros(3))


def _shift(axis: int, by: float) -> pinocchio.SE3:
    return pinocchio.SE3(np.eye(3), float(by) * np.eye(3)[axis])
