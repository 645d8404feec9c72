"""By how much the hand is elsewhere than it was told to be: from LEDs seen while the arm stands.

Model: the arm errs by constant offsets of its joints, the registration of its base by a constant
shift: z = J(q) δ + b + noise, z being the measured flange pose less the told one. Both have priors
of zero mean (what `[accuracy]` claims of the arm, what rig.toml states of the base), so a
measurement counts for as much as it is better than the claim; where it contradicts the claim beyond
chance, the claim is widened by the root of χ² over its degrees of freedom (R. T. Birge, 1932).
Offsets of joints carry the error from where it was measured to where the object is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import robots
from robots import DhArm
from robots.transforms import difference
from verify.distributions import chi2_ppf
from verify.grab.cell_file import Cell
from verify.records import Array

LARGEST = 0.010  # m: an arm that is farther off needs a person, not a correction
FEWEST = 6  # pictures that agree
AGREE = float(chi2_ppf(1 - 1e-6, 6))  # squared Mahalanobis distance of a picture from the others
SHARE = 0.75  # of the measured pictures that must agree


@dataclass(frozen=True, slots=True)
class LedSight:
    """The flange by its LEDs in one pair of pictures."""

    t: float  # s
    status: str  # of `verify.records.Measurement`; or why the pair was not measured
    base_T_flange: Array | None  # (4, 4); None: not measured
    covariance: Array | None  # (6, 6), m and rad, base axes, of a perturbation on the left
    systematic: Array | None  # (6, 6), likewise: what rig and LEDs state of themselves


@dataclass(frozen=True, slots=True)
class HandOff:
    """What the LEDs say of the hand's place at the object."""

    off: Array  # (3,), m, base frame: where the grip point is less where it is told to be
    covariance: Array  # (3, 3), m²
    used: bool  # the end point is corrected for it; else the margin must have room for it


@dataclass(frozen=True, slots=True)
class HandSeen:
    """One look at the hand before a descent, whatever came of it."""

    reason: str  # what came of it, in words
    sights: tuple[LedSight, ...]
    told: Array  # base_T_flange (4, 4), as ordered
    read: Array | None  # likewise, by the encoders
    measured: Array | None  # likewise, by the LEDs; None: no agreed measurement
    hand: HandOff | None  # None: nothing is known beside the claim

    @property
    def used(self) -> bool:
        """Whether the end point is corrected."""
        return self.hand is not None and self.hand.used


@dataclass(frozen=True, slots=True)
class _Agreed:
    pose: Array  # base_T_flange (4, 4)
    off: Array  # (6,), m and rad: less the told pose
    covariance: Array  # (6, 6)
    count: int


def agreed(sights: Sequence[LedSight], told: Array) -> _Agreed | str:
    """Average the pictures that agree, weighed by their covariances; or say why they cannot be.

    A still scene errs alike in all its pictures (edges beside an LED, the pixels' raster): the mean
    keeps the uncertainty of one picture, and grows where the pictures scatter by more than that.

    Args:
        sights: of an arm that stands.
        told: base_T_flange (4, 4), as ordered.
    """
    good = [s for s in sights if s.base_T_flange is not None and s.covariance is not None]
    if len(good) < FEWEST:
        return f"its LEDs were measured in {len(good)} of {len(sights)} pictures"
    poses = np.array([s.base_T_flange for s in good])
    z = difference(poses, told)
    each = np.array([s.covariance for s in good])
    weights = np.linalg.inv(each)
    apart = z - np.median(z, axis=0)
    near = np.einsum("ki,kij,kj->k", apart, weights, apart) < AGREE
    if near.sum() < max(FEWEST, SHARE * len(good)):
        return "pictures of its LEDs contradict each other"
    z, weights, each = z[near], weights[near], each[near]
    mean = np.linalg.solve(weights.sum(axis=0), np.einsum("kij,kj->i", weights, z))
    scatter = np.einsum("ki,kij,kj->", z - mean, weights, z - mean) / (6 * (len(z) - 1))
    one = each.mean(axis=0) * max(1.0, float(scatter))
    stated = [s.systematic for s, kept in zip(good, near, strict=True) if kept]
    shared = next((s for s in stated if s is not None), np.zeros((6, 6)))
    middle = int(np.argmin(np.abs(z - mean) @ (1 / np.sqrt(np.diag(one)))))
    return _Agreed(poses[near][middle], mean, one + shared, len(z))


def hand_off(
    found: _Agreed, arm: DhArm, cell: Cell, base: Array, q_told: Array, q_end: Array
) -> HandOff:
    """Carry what was measured where the arm stands to where it will grip.

    Args:
        found: the LEDs' word.
        arm: that was told.
        cell: the gripper, and what is claimed of the arm.
        base: (3, 3), m², what is stated of the base's place, at the hand.
        q_told: (n,), rad, where it was told to stand.
        q_end: (n,), rad, where it will be told to grip.
    """
    grip = cell.gripper.flange_T_grip[:3, 3]
    moves, end = robots.jacobian(arm, q_told), _of_grip(arm, q_end, grip)
    # as likely for each joint, and so large that the grip point errs by what is claimed
    joint = 3 * cell.accuracy.robot**2 / float((_of_grip(arm, q_told, grip) ** 2).sum())
    prior = np.zeros((arm.dof + 3, arm.dof + 3))
    prior[: arm.dof, : arm.dof] = np.eye(arm.dof) * joint
    prior[arm.dof :, arm.dof :] = base
    shows = np.hstack([moves, np.vstack([np.eye(3), np.zeros((3, 3))])])
    expected = shows @ prior @ shows.T
    beyond = float(found.off @ np.linalg.solve(expected + found.covariance, found.off)) / 6
    prior, expected = prior * max(1.0, beyond), expected * max(1.0, beyond)
    gain = np.linalg.solve(expected + found.covariance, shows @ prior).T
    causes, left = gain @ found.off, prior - gain @ shows @ prior
    carried = np.hstack([end, np.eye(3)])
    off = carried @ causes
    within = float(np.linalg.norm(off)) <= LARGEST
    return HandOff(off, carried @ left @ carried.T, within)


def _of_grip(arm: DhArm, q: Array, grip: Array) -> Array:
    """How the grip point moves with each joint, (3, n), m/rad."""
    moves = robots.jacobian(arm, q)
    lever = robots.forward(arm, q)[:3, :3] @ grip
    found: Array = moves[:3] + np.cross(moves[3:].T, lever).T
    return found
