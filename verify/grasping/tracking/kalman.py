"""Track position and velocity of a target by a Kalman filter with an Ornstein-Uhlenbeck velocity.

Model, each coordinate by itself, tau = VELOCITY_TIME_CONSTANT, w white noise:

    dx = v dt,   dv = -v / tau dt + sqrt(2 / tau) speed w dt;   measured: x + noise

Over a frame that is a constant velocity; over seconds out of sight the velocity is unknown, and its
size stays bounded.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.core.records import Array

VELOCITY_TIME_CONSTANT = 1.0  # s over which a velocity is forgotten, and its size is learned
MIN_SPEED_RATIO = 0.2  # of `fastest`: what stands still may be moved any time
P_STEADY, P_FREE, P_ABRUPT = 0.5, 0.49, 0.01  # probabilities of what a target does next
STEADY_SPEED_RATIO = 0.05  # of `fastest`: noise of a steady motion
ABRUPT_SPEED_RATIO = 2.0  # of `fastest`: pushed or snatched


@dataclass(frozen=True, slots=True)
class KalmanTrack:
    """Position and velocity at one instant, in d dimensions: m, m/s in the rig (d = 3)."""

    t: float  # s
    mean: Array  # (2 d,), position then velocity
    covariance: Array  # (2 d, 2 d)
    speed: float  # standard deviation of the velocity, a coordinate, learned of this target
    fastest: float  # standard deviation of the velocity, a coordinate, of any target

    @property
    def position(self) -> Array:
        """(d,)."""
        return self.mean[: len(self.mean) // 2]

    @property
    def velocity(self) -> Array:
        """(d,), a second."""
        return self.mean[len(self.mean) // 2 :]

    @property
    def position_covariance(self) -> Array:
        """(d, d)."""
        d = len(self.mean) // 2
        return self.covariance[:d, :d]

    @property
    def velocity_covariance(self) -> Array:
        """(d, d)."""
        d = len(self.mean) // 2
        return self.covariance[d:, d:]

    def at(self, t: float) -> "KalmanTrack":
        """Predict to an instant, s; one before the track's own changes nothing.

        Source: Gillespie, Phys. Rev. E 54, 1996, eqs. 2.12-2.14 (the process and its integral).
        """
        dt = t - self.t
        if dt <= 0:
            return self
        tau = VELOCITY_TIME_CONSTANT
        decay = math.exp(-dt / tau)
        power = 2 * self.speed**2 / tau  # of the driving noise
        xx = power * tau**2 * (dt - 2 * (1 - decay) * tau + (1 - decay**2) * tau / 2)
        xv = power * tau**2 / 2 * (1 - decay) ** 2
        vv = power * tau / 2 * (1 - decay**2)
        return self._stepped(t, [[1.0, tau * (1 - decay)], [0.0, decay]], [[xx, xv], [xv, vv]])

    def explanations(self, t: float) -> list["MotionHypothesis"]:
        """Predict it by three hypotheses: steady motion, free motion, or a push since the last."""
        dt = max(t - self.t, 0.0)
        power = 2 * (STEADY_SPEED_RATIO * self.fastest) ** 2 / VELOCITY_TIME_CONSTANT
        noise = [[power * dt**3 / 3, power * dt**2 / 2], [power * dt**2 / 2, power * dt]]
        steady = self._stepped(t, [[1.0, dt], [0.0, 1.0]], noise)
        free = self.at(t)
        push = (ABRUPT_SPEED_RATIO * self.fastest) ** 2
        pushed = _each_coordinate([[push * dt**2, push * dt], [push * dt, push]], len(self.mean))
        abrupt = replace(free, covariance=free.covariance + pushed)
        return [
            MotionHypothesis(steady, -2 * math.log(P_STEADY)),
            MotionHypothesis(free, -2 * math.log(P_FREE)),
            MotionHypothesis(abrupt, -2 * math.log(P_ABRUPT), abrupt=True),
        ]

    def updated(self, position: Array, covariance: Array) -> "KalmanTrack":
        """Take a measured position (d,) and its covariance (d, d), of the track's instant."""
        d = len(position)
        gain = np.linalg.solve(self.position_covariance + covariance, self.covariance[:d]).T
        mean = self.mean + gain @ (position - self.position)
        keep = np.eye(2 * d)
        keep[:, :d] -= gain
        joseph = keep @ self.covariance @ keep.T + gain @ covariance @ gain.T
        return KalmanTrack(self.t, mean, joseph, self.speed, self.fastest)

    def learned(self, since: float) -> "KalmanTrack":
        """Learn `speed` from the velocity; `since` is s from one update to the next."""
        share = 1 - math.exp(-since / VELOCITY_TIME_CONSTANT)
        square = self.speed**2 + share * (float(np.mean(self.velocity**2)) - self.speed**2)
        return replace(self, speed=max(math.sqrt(square), MIN_SPEED_RATIO * self.fastest))

    def _stepped(
        self, t: float, step: list[list[float]], noise: list[list[float]]
    ) -> "KalmanTrack":
        carry = _each_coordinate(step, len(self.mean))
        covariance = carry @ self.covariance @ carry.T + _each_coordinate(noise, len(self.mean))
        return replace(self, t=max(t, self.t), mean=carry @ self.mean, covariance=covariance)


@dataclass(frozen=True, slots=True)
class MotionHypothesis:
    """One way in which a track may go on."""

    track: KalmanTrack  # predicted
    cost: float  # minus twice the log of its probability; of a candidate, with place and size
    abrupt: bool = False  # only a push explains it


def distances(
    tracks: Sequence[KalmanTrack], position: Array, covariance: Array
) -> tuple[Array, Array]:
    """Squared Mahalanobis distances (n,) of a measured position (d,) from the predicted ones.

    With them ln det(2 pi S) of the innovations' covariances, (n,).
    """
    spread = np.array([track.position_covariance for track in tracks]) + covariance
    off = position - np.array([track.position for track in tracks])
    squared = (off * np.linalg.solve(spread, off[..., None])[..., 0]).sum(axis=1)
    return squared, np.linalg.slogdet(2 * np.pi * spread)[1]


def _each_coordinate(matrix: list[list[float]], size: int) -> Array:
    """Apply a (2, 2) of position and velocity to each coordinate by itself: (size, size)."""
    whole, each = np.zeros((2, size // 2, 2, size // 2)), np.arange(size // 2)
    whole[:, each, :, each] = matrix
    return whole.reshape(size, size)


def begin_track(t: float, position: Array, covariance: Array, speed: float) -> KalmanTrack:
    """Begin a track at a measured position (d,); nothing is known of its velocity but its size."""
    d = len(position)
    whole = np.zeros((2 * d, 2 * d))
    whole[:d, :d] = covariance
    whole[d:, d:] = np.eye(d) * speed**2
    return KalmanTrack(t, np.concatenate([position, np.zeros(d)]), whole, speed, speed)
