"""Does linear propagation hold? The whole chain drawn anew, closed-form inverse included.

A few pairs of the session, and the worst known of them, are measured again in a few hundred drawn
worlds: spots, cameras, bases, LEDs, clock and readings move by what is stated of them, the pose is
fitted without linearisation, and the arm's inverse takes it to joint angles (GUM Supplement 1).
Each draw is propagated linearly as well. The ratio of the two standard deviations over the same
draws is free of most of the chance that either holds: that is what is compared.
"""

from dataclasses import dataclass, replace

import numpy as np

import robots
from verify.analysis.comparison import Comparison, JointComparison, alignment_scale
from verify.analysis.model import SessionComparison, prior_columns
from verify.analysis.uncertainty.draws import WorldDraws
from verify.core.records import Array, Flags, Index

N_PAIRS = 20  # spread over the session, beside the worst known ones
N_DRAWS = 200
SEED = 20261122
MAX_RATIO_ERROR = 0.05  # of the standard deviation
P_CHANCE = 0.01  # of the ratio by so few draws: where it is said to hold, it does
MAX_SHIFT = 0.1  # of the standard deviation: a mean that moves by less changes no interval
N_JOINTS = 6


@dataclass(frozen=True, slots=True)
class MonteCarlo:
    """m pairs of a session, j joints; a joint's error less its linear propagation, over draws."""

    pairs: Index  # (m,), rows of the comparison
    draws: int
    linear: Array  # (m, j), standard uncertainty by linear propagation, rad
    drawn: Array  # (m, j), the same times the ratio below
    scatter: Array  # (m, j), standard deviation over the draws as they fell, rad
    ratio: Array  # (m, j), drawn over linear standard deviation of the same draws
    shift: Array  # (m, j), of the mean, in standard uncertainties
    coupled: Flags  # (m, j), a singularity near by couples this joint
    unreachable: Array  # (m,), share of draws in which the arm cannot stand in the pose
    mean_ratio: Array  # (j,), the same ratio of the mean over the pairs that tell a joint

    @property
    def holds(self) -> Flags:
        """Where linear propagation holds, (m, j)."""
        near = (np.abs(self.ratio - 1) <= MAX_RATIO_ERROR - P_CHANCE) & (
            np.abs(self.shift) <= MAX_SHIFT
        )
        return np.asarray(near & (self.unreachable == 0)[:, None])


def monte_carlo(
    compared: SessionComparison,
    *,
    pairs: int = N_PAIRS,
    draws: int = N_DRAWS,
    seed: int = SEED,
) -> MonteCarlo | None:
    """Draw the session's inputs and compare what comes out with linear propagation.

    `compared` is the session before pairs that repeat each other were counted for fewer, with one
    of the measurements a row of its track; `pairs` of them are spread over the session, each in so
    many drawn worlds. None for an arm of other than six joints, or without a wholly known pose.
    """
    session, track = compared.session, compared.track
    comparison, joints = compared.comparison, compared.joints
    if session.arm.dof != N_JOINTS:
        return None
    chosen = _select_pairs(comparison, joints, pairs)
    if not len(chosen):
        return None
    world = WorldDraws(np.random.default_rng(seed), draws, compared)
    scale = np.sqrt(alignment_scale(track))
    poses = np.empty((len(chosen), draws, 4, 4))
    read, straight = (np.empty((len(chosen), draws, N_JOINTS)) for _ in range(2))
    for m, i in enumerate(chosen.tolist()):
        row = int(comparison.index[i])
        drawn, twist = world.poses(compared.measurements[row], track, row, float(scale[row]))
        left = comparison.alignment_error[i], comparison.tilt[i]
        poses[m], by_alignment = world.aligned(drawn, *left)
        late = world.readings(comparison.rate[i], comparison.local_noise[i])
        read[m] = comparison.q[i] + late
        by_reading = late @ comparison.jacobian[i].T
        straight[m] = (by_reading - twist + by_alignment) @ joints.inverse[i].T
    q, _ = robots.nearest(session.arm, poses, read)
    bent = read - q - joints.error[chosen, None]
    bent = np.arctan2(np.sin(bent), np.cos(bent))
    linear = _linear(compared)[chosen]
    return _compare_draws(chosen, bent, straight, linear, joints.coupled[chosen])


def _select_pairs(comparison: Comparison, joints: JointComparison, pairs: int) -> Index:
    """Pairs spread over the session, and of each joint the one that is known worst."""
    whole = np.array([d.shape[1] == N_JOINTS for d in comparison.determined], dtype=bool)
    usable = np.flatnonzero(whole & joints.reached & np.isfinite(joints.error).all(axis=1))
    if not len(usable):
        return usable
    even = usable[np.linspace(0, len(usable) - 1, min(pairs, len(usable))).round().astype(int)]
    variance = np.diagonal(joints.covariance[usable], axis1=1, axis2=2)
    return np.unique(np.concatenate([even, usable[np.argmax(variance, axis=0)]]))


def _linear(compared: SessionComparison) -> Array:
    """Standard uncertainty of every pair's joint errors by linear propagation, (n, j), rad."""
    comparison, joints = compared.comparison, compared.joints
    # a clock that was estimated moves the readings as a given one does
    given = replace(compared.clock, source="given")
    moved = joints.inverse @ prior_columns(comparison, compared.track, given, compared.systematics)
    own = joints.inverse @ comparison.covariance @ np.swapaxes(joints.inverse, 1, 2)
    return np.asarray(np.sqrt(np.diagonal(own, axis1=1, axis2=2) + np.sum(moved**2, axis=2)))


def _compare_draws(
    chosen: Index, bent: Array, straight: Array, linear: Array, coupled: Flags
) -> MonteCarlo:
    """Set draws (m, d, j) of the whole chain against those of linear propagation."""
    lost = np.any(np.isnan(bent), axis=2)
    straight = np.where(lost[:, :, None], np.nan, straight)
    ratio, shift = np.full(linear.shape, np.nan), np.full(linear.shape, np.nan)
    told = (~lost).sum(axis=1) > bent.shape[1] // 2  # else there is nothing to compare
    scatter = np.full(linear.shape, np.nan)
    scatter[told] = np.nanstd(bent[told], axis=1)
    ratio[told] = _ratio(scatter[told], np.nanstd(straight[told], axis=1))
    shift[told] = _ratio(np.nanmean(bent[told] - straight[told], axis=1), linear[told])
    mean_ratio = np.full(linear.shape[1], np.nan)
    for j in range(linear.shape[1]):
        mine = ~coupled[:, j] & ~lost.any(axis=1)
        if mine.any():
            drawn, told_linearly = (x[mine, :, j].mean(axis=0).std() for x in (bent, straight))
            mean_ratio[j] = drawn / told_linearly if told_linearly > 0 else np.nan
    return MonteCarlo(
        pairs=chosen,
        draws=bent.shape[1],
        linear=linear,
        drawn=linear * ratio,
        scatter=scatter,
        ratio=ratio,
        shift=shift,
        coupled=coupled,
        unreachable=lost.mean(axis=1),
        mean_ratio=mean_ratio,
    )


def _ratio(part: Array, whole: Array) -> Array:
    """A quotient; nan where nothing varies."""
    nothing = np.full(whole.shape, np.nan)
    return np.asarray(np.divide(part, whole, out=nothing, where=whole > 0))
