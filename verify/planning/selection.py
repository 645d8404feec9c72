"""Choose how many poses, and how far apart, are visited in the given time, and time the motion.

Legs are jerk-limited, from rest to rest, each at its own share of the greatest speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robots import Arm
from robots.trajectory import JointLimits, Trajectory, joint_path, time_path
from verify.core.records import Array, Index
from verify.errors import InputError
from verify.planning import design
from verify.planning.constraints import PostureConstraints
from verify.planning.foresight import simulate_session
from verify.planning.request import SessionConditions
from verify.planning.roadmap import MotionStop, Roadmap, plan_tour

VISIT_INTERVAL = 5.0  # s between the visits that stand for candidates
MIN_POSES = 4  # poses: fewer show no slope
MAX_POSES = 60
NEAR_SHARES = (1.0, 0.5, 0.2)  # shares of the postures that are tried, those nearest to the others
# Shares of the greatest speed, leg after leg: what tells a clock's error from a backlash is speed
# that varies (corr(latency, backlash) is -0.15 to -0.73 at one speed).
PACES = (1.0, 0.5, 0.8, 0.4)
SPEED_UP_TIME = 0.4  # s to full speed, where the arm's file states no acceleration
ACCELERATION_TIME = 0.15  # s to full acceleration, where it states no jerk
PERIOD = 0.05  # s between the rows of plan.csv


@dataclass(frozen=True)
class TimedMotion:
    """A motion from rest to rest; k stops."""

    stops: tuple[MotionStop, ...]
    arrive: Array  # (k,), s; the first at 0
    leave: Array  # (k,), s
    legs: tuple[Trajectory, ...]  # (k - 1)
    pace: Array  # (k - 1,), share of the greatest speed

    @property
    def duration(self) -> float:
        """In s."""
        return float(self.leave[-1])

    def times(self, step: float) -> Array:
        """Instants from the beginning in even steps, and the end, (n,), s."""
        return np.append(np.arange(0.0, self.duration, step), self.duration)

    def q(self, t: Array) -> Array:
        """Joint angles (n, j), rad, at times (n,), s; at rest before and after."""
        leg = np.clip(np.searchsorted(self.leave, t, side="right") - 1, -1, len(self.legs) - 1)
        found = np.tile(self.stops[0].q, (len(t), 1))
        for i in np.unique(leg[leg >= 0]).tolist():
            own = leg == i
            part = self.legs[i]
            since = np.clip(t[own] - self.leave[i], 0.0, part.duration).tolist()
            found[own] = part.path.q(np.array([part.curve.at_time(s)[0][0] for s in since]))
        return found

    def resting(self, t: Array) -> list[int | None]:
        """Which pose the arm rests at, at times (n,)."""
        at = np.clip(np.searchsorted(self.arrive, t, side="right") - 1, 0, len(self.stops) - 1)
        rests = t <= self.leave[at]
        return [
            self.stops[k].pose if rest else None
            for k, rest in zip(at.tolist(), rests.tolist(), strict=True)
        ]


def joint_limits(arm: Arm, speed: float) -> JointLimits:
    """Limits of the joints: those of the arm's file, and no joint faster than requested."""
    most = np.full(arm.dof, speed)
    if arm.speed is not None:
        most = np.minimum(most, arm.speed)
    acceleration, jerk = most / SPEED_UP_TIME, most / SPEED_UP_TIME / ACCELERATION_TIME
    if arm.acceleration is not None:
        acceleration = np.minimum(acceleration, arm.acceleration)
    if arm.jerk is not None:
        jerk = np.minimum(jerk, arm.jerk)
    return JointLimits(arm.lower, arm.upper, most, acceleration, jerk)


def schedule(stops: Sequence[MotionStop], greatest: JointLimits, hold: float) -> TimedMotion:
    """Give each leg its speed and each pose `hold` s of rest; stops only passed have none."""
    now, arrive, leave, legs, paces = 0.0, [], [], [], []
    for k, stop in enumerate(stops):
        if k:
            pace = PACES[(k - 1) % len(PACES)]
            leg = time_path(
                joint_path(stops[k - 1].q, stop.q), replace(greatest, speed=pace * greatest.speed)
            )
            now += leg.duration
            legs.append(leg)
            paces.append(pace)
        arrive.append(now)
        now += hold if stop.pose is not None else 0.0
        leave.append(now)
    return TimedMotion(
        tuple(stops), np.array(arrive), np.array(leave), tuple(legs), np.array(paces)
    )


@dataclass(frozen=True)
class PoseSelection:
    """Candidate poses and the information of a visit to each."""

    constraints: PostureConstraints
    roadmap: Roadmap
    conditions: SessionConditions
    rows: design.DesignInformation
    node: Index  # of each candidate, its posture in the roadmap

    def motion(self) -> TimedMotion:
        """Choose poses and time them: the requested number, or as many as the duration allows.

        Raises:
            InputError: the duration is too short for any plan.
        """
        request = self.constraints.request
        every = np.arange(len(self.node), dtype=np.int64)
        if request.poses is not None:
            return self._made(every, min(request.poses, len(every)))[0]
        duration = request.duration or 0.0
        best, most, shortest = None, -np.inf, np.inf
        away = self.roadmap.time[np.ix_(self.node, self.node)]
        near = np.argsort(away[int(np.argmin(away.mean(axis=1)))], kind="stable")
        for share in NEAR_SHARES:  # about the one that is nearest to the others
            size = max(int(share * len(near)), min(MIN_POSES, len(near)))
            timed, tells = self._fullest(near[:size].astype(np.int64), duration)
            shortest = min(shortest, timed.duration)
            if timed.duration <= duration and tells > most:
                best, most = timed, tells
        if best is None:
            raise InputError(
                "--duration-s", f"{duration:g} s", f"{MIN_POSES} poses take {shortest:.0f} s",
                "Give more time, a higher --speed-deg-s or a shorter --hold-s.",
            )  # fmt: skip
        return best

    def _fullest(self, among: Index, duration: float) -> tuple[TimedMotion, float]:
        """As many poses as the duration allows, by halving; at least MIN_POSES."""
        best = self._made(among, MIN_POSES)
        low, high = MIN_POSES, min(MAX_POSES, len(among)) + 1
        while high - low > 1 and best[0].duration <= duration:
            middle = (low + high) // 2
            candidate = self._made(among, middle)
            if candidate[0].duration <= duration:
                low, best = middle, candidate
            else:
                high = middle
        return best

    def _made(self, among: Index, count: int) -> tuple[TimedMotion, float]:
        """The motion through the best poses, and how much it tells: ln det of the information."""
        setup, request = self.constraints.setup, self.constraints.request
        rows = self.rows
        chosen = among[design.choose_poses(replace(rows, rows=rows.rows[among]), count)]
        back = "backlash" in request.observe  # nothing but both sides of every pose shows it
        stops = plan_tour(self.constraints, self.roadmap, self.node[chosen].tolist(), back=back)
        timed = schedule(stops, joint_limits(setup.arm, request.speed), request.hold)
        # the pairs of the whole motion, shared out over its poses
        each = self.conditions.rate * timed.duration / len(chosen)
        times = each / _pairs(self.conditions, request.hold)
        return timed, design.log_information(rows, chosen.tolist(), times)


def predict_visits(
    constraints: PostureConstraints,
    roadmap: Roadmap,
    conditions: SessionConditions,
    rng: np.random.Generator,
) -> PoseSelection:
    """Predict a visit to every posture of a roadmap.

    Raises:
        InputError: the LEDs cannot be told apart in any.
    """
    setup, request = constraints.setup, constraints.request
    visits = VISIT_INTERVAL * np.arange(len(roadmap.q), dtype=np.float64)
    still = replace(conditions, skew=0.0, clock_uncertainty=0.0)  # at rest neither counts

    def posture(t: Array) -> Array:
        q: Array = roadmap.q[
            np.clip(np.round(t / VISIT_INTERVAL).astype(int), 0, len(roadmap.q) - 1)
        ]
        return q

    session = simulate_session(setup, posture, visits, still, request.view_angle, rng)
    if session is None:
        raise InputError(
            "plan", f"the LEDs cannot be identified in any of {len(visits)} postures",
            "an LED body without symmetry, or of several colours, can", "Change the marker.",
        )  # fmt: skip
    weight = _pairs(conditions, request.hold)
    rows = design.design_information(setup, session.model, request.observe, weight)
    node = session.track.frame[session.comparison.index].astype(np.int64)
    return PoseSelection(constraints, roadmap, conditions, rows, node)


def _pairs(conditions: SessionConditions, hold: float) -> float:
    """Pairs taken about a pose: at rest there, and about a second nearby."""
    return max(conditions.rate * (hold + 1.0), 1.0)
