"""Innovations of each pair: joint evidence less what the instrument's own uncertainties explain.

Everything stated of rig, base and LEDs is a constant error of the measured pose whose size is known
within its uncertainty. A Kalman filter estimates those errors, and the clock's, from the pairs as
they come. Its innovations are white noise of known size: a bias within its stated uncertainty is
learned and raises no alarm, while a change of a joint is new.

Source: Kailath's innovations; for faults, Basseville and Nikiforov, Detection of Abrupt Changes,
1993, ch. 7.2.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from verify.analysis.least_squares import MAX_CORRELATION, autocorrelation
from verify.core.records import Array
from verify.core.statistics import MAD_TO_SIGMA
from verify.live.joint_row import Evidence

SYSTEMATIC_TIME = 600.0  # s in which what is stated may wander: temperature, a base that creeps
CLOCK_TIME = 10.0  # s, likewise the clock's error: it is estimated anew every few seconds
# rad, standard: a joint that is known to be at fault may read so far off
U_FAULTY_JOINT = math.radians(5.0)
FAULT_RANDOM_WALK = math.radians(0.02)  # rad a root second: a joint's fault need not be constant
ALIGNMENT_TIME = 0.5  # s for which an arm keeps accelerating one way, give or take
# m, rad, standard: what lens model, DH table and spot shape leave beside all that is stated, as the
# arm moves; a change far below it, 0.003°, say, is found in any model by whoever looks long enough
U_MODEL = (5e-5, 1e-4)
N_SPREAD = 1800  # innovations, a minute at 30 a second, that tell their real size and correlation
RENEWAL_PERIOD = 30  # pairs from one look at that to the next
MIN_INNOVATIONS = 60  # pairs; with fewer the largest possible correlation is assumed
MAX_REPEATED = 90  # pairs that can be gone through again once a fault is known to have begun there
MAX_SIGMA = 3.0  # standard deviations: a fault must not hide itself by widening its own measure


POSE_DIRECTIONS = np.eye(6)
INITIAL_INFLATION: Array = np.full(6, (1 + MAX_CORRELATION) / (1 - MAX_CORRELATION))
MODEL_COVARIANCE = np.diag(np.repeat(np.square(U_MODEL), 3))


@dataclass(frozen=True, slots=True)
class _FilterStep:
    """A pair, and what was believed before it."""

    t: float
    evidence: Evidence
    clock: object
    x: Array
    p: Array
    before: tuple[float | None, object]  # time and clock of the pair before


@dataclass(frozen=True, slots=True)
class Innovation:
    """What one pair brought, whitened: d directions of unit variance and no memory."""

    residual: Array  # (d,)
    joints: Array  # (d, j), of an offset of each joint, a rad

    @property
    def along_joints(self) -> Array:
        """How far the residual goes along each joint's column, (j,); 0 where that is zero."""
        length = np.sqrt(np.sum(self.joints**2, axis=0))
        along: Array = np.zeros_like(length)
        np.divide(self.residual @ self.joints, length, out=along, where=length > 0)
        return along


@dataclass(frozen=True, slots=True)
class Supposition:
    """How well pairs fit where a joint's reading is supposed to have changed by a constant."""

    cost: float  # -2 log likelihood of the pairs, but for a constant
    size: float  # rad, of the change
    standard_uncertainty: float  # rad, if it is constant
    misfit: float  # chi² a direction of the pairs from the change on; 1 where it explains them
    own_share: float  # of that chi²: what another size in each pair would explain


class InnovationFilter:
    """Filters evidence pair by pair.

    The state is the prior's coefficients (unit variance each), the clock's error, the errors of
    joints that an alarm has named (those are no news any more), and what alignment and the model
    leave.
    """

    def __init__(self, joints: int) -> None:
        self._joints = joints
        self._t: float | None = None
        self._x = np.zeros(0)
        self._p = np.zeros((0, 0))
        self._clock: object = None
        self._prior_width = 0
        self._open: set[int] = set()
        self._recent: deque[Array] = deque(maxlen=N_SPREAD)
        self._past: deque[_FilterStep] = deque(maxlen=MAX_REPEATED)
        self._count = 0
        # by how much pairs that repeat each other widen a mean's variance
        self.factors = INITIAL_INFLATION

    def take(self, t: float, evidence: Evidence, clock: object) -> Innovation | None:
        """Take a pair's evidence at t, s, cameras' clock.

        Another clock than before has an error of its own. Returns what was not foreseen; None for
        the first pair, and where the LEDs leave much open.
        """
        if evidence.determined.shape[1] < 6 or not np.all(np.isfinite(evidence.xi)):
            return None  # directions that the readings fill say nothing about the readings
        if self._prior_width != evidence.prior.shape[1] or self._t is None:
            self._begin(evidence)
        before = (self._t, self._clock)
        self._past.append(_FilterStep(t, evidence, clock, self._x, self._p.copy(), before))
        innovation, by_noise, _ = self._update(t, evidence, clock)
        self._recent.append(by_noise)
        self._count += 1
        if self._count % RENEWAL_PERIOD == 0:
            self._renew_spread()
        return innovation

    def suppose(self, joint: int, pairs: int, late: int) -> Supposition:
        """Suppose that a joint's reading changed some pairs ago, and see how well that explains.

        The joint is counted from 0; `pairs` are gone through again, the first `late` of them came
        before the change.
        """
        kept = (self._x, self._p, self._t, self._clock)
        moments = list(self._past)[-pairs:]
        cost, news = self._again((joint,), moments, late)
        place = self._prior_width + 1 + joint
        before = moments[0].x[place]  # of a joint that was known to be off already
        size, spread = float(self._x[place] - before), float(self._p[place, place])
        self._x, self._p, self._t, self._clock = kept
        chi2 = sum(float(one.residual @ one.residual) for one in news)
        own = sum(float(one.along_joints[joint]) ** 2 for one in news)
        directions = max(sum(len(one.residual) for one in news), 1)  # none: another prior since
        share = own / chi2 if chi2 > 0 else 1.0
        return Supposition(cost, size, math.sqrt(spread), chi2 / directions, share)

    def accept(self, joints: tuple[int, ...], pairs: int) -> None:
        """Take joints for known to be at fault from now on: their errors are learned.

        They are counted from 0. The pairs since the fault began are gone through again, lest rig
        and base take its blame.
        """
        self._open.update(joints)
        self._again(joints, list(self._past)[-pairs:])
        self._past.clear()
        for _ in range(min(pairs, len(self._recent))):
            self._recent.pop()  # a fault's pairs say nothing of the noise
        self._renew_spread()

    def _again(
        self, joints: tuple[int, ...], moments: list[_FilterStep], late: int = 0
    ) -> tuple[float, list[Innovation]]:
        """Go through pairs again with some joints' errors open from one of them on.

        Returns -2 log likelihood (but for a constant), and what those pairs brought from then on.
        """
        self._x, self._p = moments[0].x, moments[0].p.copy()
        self._t, self._clock = moments[0].before
        opened = [self._prior_width + 1 + joint for joint in joints]
        cost, news = 0.0, []
        for number, moment in enumerate(moments):
            if number == late:
                self._p[opened, opened] += U_FAULTY_JOINT**2
            innovation, _, size = self._update(moment.t, moment.evidence, moment.clock)
            cost += float(innovation.residual @ innovation.residual) + size
            if number >= late:
                news.append(innovation)
        return cost, news

    def _update(
        self, t: float, evidence: Evidence, clock: object
    ) -> tuple[Innovation, Array, float]:
        """Predict, compare, learn.

        Returns the news, the same by the noise alone, and the logarithm of its covariance's
        determinant.
        """
        self._advance(t, evidence, clock)
        design = np.concatenate(
            [evidence.prior, evidence.clock[:, None], evidence.jacobian, POSE_DIRECTIONS], axis=1
        )
        lower = np.linalg.cholesky(evidence.noise)
        noise = (lower * self.factors) @ lower.T
        cross = design @ self._p
        new = evidence.xi - design @ self._x
        white = np.linalg.cholesky(cross @ design.T + noise)
        whiten = np.linalg.inv(white)
        residual: Array = whiten @ new
        learned = whiten @ cross
        self._x = self._x + residual @ learned
        self._p = self._p - learned.T @ learned
        by_noise = np.asarray(np.linalg.solve(lower, new), dtype=np.float64)
        size = 2 * float(np.sum(np.log(np.diagonal(white))))
        return Innovation(residual, whiten @ evidence.jacobian), by_noise, size

    def reset(self) -> None:
        """Forget what was learned: the robot's clock or place is another one now."""
        self._t = None
        self._recent.clear()
        self._past.clear()
        self.factors = INITIAL_INFLATION

    def _begin(self, evidence: Evidence) -> None:
        self._prior_width = evidence.prior.shape[1]
        size = self._prior_width + 1 + self._joints + 6
        self._x = np.zeros(size)
        self._p = np.zeros((size, size))
        self._p[range(self._prior_width), range(self._prior_width)] = 1.0
        self._open.clear()
        self._past.clear()
        self._clock, self._t = None, None

    def _advance(self, t: float, evidence: Evidence, clock: object) -> None:
        """Let time pass: what is stated wanders within its uncertainty, likewise the clock."""
        width = self._prior_width
        elapsed = 0.0 if self._t is None else max(t - self._t, 0.0)
        keep, fading = (math.exp(-elapsed / time) for time in (SYSTEMATIC_TIME, ALIGNMENT_TIME))
        kept_clock = math.exp(-elapsed / CLOCK_TIME) if clock == self._clock else 0.0
        self._t, self._clock = t, clock
        factor = np.repeat([keep, kept_clock, 1.0, fading], [width, 1, self._joints, 6])
        self._x = factor * self._x
        self._p = np.multiply.outer(factor, factor) * self._p
        diagonal = np.einsum("ii->i", self._p)
        diagonal[:width] += 1.0 - keep**2
        self._p[-6:, -6:] += (1.0 - fading**2) * (evidence.alignment + MODEL_COVARIANCE)
        diagonal[width] += (1.0 - kept_clock**2) * evidence.clock_uncertainty**2
        for joint in self._open:
            diagonal[width + 1 + joint] += FAULT_RANDOM_WALK**2 * elapsed

    def _renew_spread(self) -> None:
        """Measure how far the innovations exceed and repeat each other."""
        if len(self._recent) < MIN_INNOVATIONS:
            return
        rows = np.array(self._recent)
        most = MAX_SIGMA * MAD_TO_SIGMA * np.median(np.abs(rows), axis=0)
        rows = np.clip(rows, -most, most)
        measured = autocorrelation(rows) * np.maximum(np.mean(rows**2, axis=0), 1.0)
        self.factors = np.maximum(measured, 1.0)
