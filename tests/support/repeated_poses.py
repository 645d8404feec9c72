"""An arm that visits poses again and again, with every true pose known."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from tests.support.motions import ARM, HOME, SIGMA, make_track
from verify.analysis.comparison import compare
from verify.analysis.performance.poses import PoseVisits
from verify.core.readings import Readings
from verify.core.records import Array

PLACES = HOME + np.deg2rad(
    [
        [0, 0, 0, 0, 0, 0],
        [20, 10, -12, 5, 8, 10],
        [-20, 12, 8, -6, 4, -12],
        [-18, -9, 10, 6, -8, 9],
        [19, -8, -6, -4, -6, -8],
    ]
)
CYCLE = (4, 3, 2, 1, 0)  # the standard's: P5, P4, P3, P2, P1
DWELL, MOVE = 1.2, 1.0  # s
SERVO = np.deg2rad(0.02)  # rad, scatter of where each joint stops
OFF = np.array([0.2e-3, -0.1e-3, 0.3e-3])  # m, measured less read, everywhere


@dataclass(frozen=True)
class Repeated:
    """A session's worth of visits; `stops` are where the joints stood."""

    order: tuple[int, ...]
    stops: Array  # (visits, 6), rad

    @property
    def end(self) -> float:
        return len(self.order) * (DWELL + MOVE) - MOVE

    def joints(self, t: Array) -> Array:
        """Stand for DWELL, move on for MOVE; (n, 6), rad."""
        visit = np.clip(t // (DWELL + MOVE), 0, len(self.order) - 1).astype(int)
        following = np.minimum(visit + 1, len(self.order) - 1)
        share = np.clip((t - visit * (DWELL + MOVE) - DWELL) / MOVE, 0, 1)
        smooth = share**3 * (10 - 15 * share + 6 * share**2)
        start, goal = self.stops[visit], self.stops[following]
        return start + smooth[:, None] * (goal - start)

    def places(self, pose: int) -> Array:
        """True positions (visits, 3) of the flange at one pose, m."""
        rows = [i for i, one in enumerate(self.order) if one == pose]
        return robots.forward(ARM, self.stops[rows])[:, :3, 3]


def repeated(cycles: int, *, servo: float = SERVO) -> Repeated:
    order = (0, *(CYCLE * cycles))
    scatter = np.random.default_rng(1).normal(0, servo, (len(order), 6))
    return Repeated(order, PLACES[list(order)] + scatter)


def readings_of(run: Repeated) -> Readings:
    t = np.arange(-0.5, run.end + 0.5, 0.02)
    q = np.deg2rad(np.round(np.rad2deg(run.joints(t)), 3))  # of a controller's three digits
    return Readings(t, q)


def measured_poses(run: Repeated, t: Array) -> Array:
    """base_T_flange (n, 4, 4) with white noise of SIGMA, OFF everywhere."""
    rng = np.random.default_rng(2)
    poses = robots.forward(ARM, run.joints(t))
    turn = Rotation.from_rotvec(rng.normal(0, SIGMA[1], (len(t), 3))).as_matrix()
    poses[:, :3, :3] = turn @ poses[:, :3, :3]
    poses[:, :3, 3] += OFF + rng.normal(0, SIGMA[0], (len(t), 3))
    return poses


def pose_visits(
    places: Array, came_from: tuple[int, ...] = (), *, read: float = 0.0, begin: float = 0.0
) -> PoseVisits:
    """Visits of a pose a minute apart, at places (n, 3), m, where the readings put it at x."""
    n = len(places)
    attained, there = np.tile(np.eye(4), (2, n, 1, 1))
    attained[:, :3, 3], there[:, 0, 3] = places, read
    t, ways = begin + 60.0 * np.arange(n), came_from or (0,) * n
    own, pairs = np.zeros((n, 6)), tuple(np.arange(n)[:, None])
    own[:, :3] = attained[:, :3, 3] - there[:, :3, 3]
    return PoseVisits("A", t, attained, there, own, pairs, ways, np.zeros((6, 1)))


def model_of(run: Repeated, t: Array, readings: Readings) -> Any:
    """What `performance` takes of a session's model: the pairs, and no systematic doubt."""
    track = make_track(t, run.joints(t), np.random.default_rng(3))
    track.base_T_flange[:] = measured_poses(run, t)
    comparison = compare(track, ARM, readings, 0.0)
    return SimpleNamespace(comparison=comparison, prior_columns=np.zeros((len(comparison), 6, 1)))
