"""Tell the state machine every cycle of stale pictures or joints, a lost target, failed devices."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from verify.core.records import Array
from verify.grasping.cell import StillnessCriterion, WatchdogLimits
from verify.grasping.control.states import TIMED_STATES, GraspEvent, GraspState, StateMachine


@dataclass(frozen=True, slots=True)
class Observation:
    """Inputs of one cycle; times are on the machine's clock, s, None: never yet."""

    pictures_t: float | None  # when the newest pair was taken
    joints_t: float | None  # when the newest joint angles were read
    tracked_t: float | None  # when the target was last tracked
    position: Array | None = None  # (3,), m, of the target in that pair; None: not tracked in it
    unreachable: str = ""  # why the target cannot be reached; empty: it can, or is not known
    device_error: str = ""  # of a device that failed; empty: none
    hidden: bool = False  # the hand is so near the object that it may hide it


class StillWatch:
    """Whether the target stands still: all its recent places lie close together."""

    def __init__(self, wanted: StillnessCriterion) -> None:
        self._wanted = wanted
        self._places: deque[tuple[float, Array]] = deque()

    def see(self, t: float, position: Array | None) -> bool:
        """Take a place (3,), m, at t, s; None: not tracked, and the wait begins anew."""
        if position is None:
            self._places.clear()
            return False
        if not self._places or t > self._places[-1][0]:
            self._places.append((t, position))
        oldest = self._places[-1][0] - self._wanted.duration
        while len(self._places) > 1 and self._places[1][0] <= oldest:
            self._places.popleft()
        if self._places[0][0] > oldest:
            return False
        places = np.array([place for _, place in self._places])
        far = np.linalg.norm(places - places.mean(axis=0), axis=1).max()
        return bool(far <= self._wanted.speed * self._wanted.duration / 2)


class Watchdog:
    """Sends the machine its events of time and of missing inputs."""

    def __init__(
        self,
        machine: StateMachine,
        limits: WatchdogLimits,
        still: StillnessCriterion,
        *,
        auto: bool = False,
    ) -> None:
        self._machine, self._limits, self._auto = machine, limits, auto
        self._still = StillWatch(still)

    def observe(self, now: float, inputs: Observation) -> GraspState:
        """Take one cycle's inputs: bad events first, good ones only if there is no bad one."""
        machine = self._machine
        taken = now if inputs.pictures_t is None else inputs.pictures_t
        machine.still = self._still.see(taken, inputs.position)
        broken, lost = self._broken(now, inputs), self._lost(now, inputs)
        old = self.old(now, inputs.pictures_t, inputs.joints_t)
        for event, reason in (
            *broken,
            *((GraspEvent.STALE, reason) for reason in old),
            *((GraspEvent.LOST, reason) for reason in lost),
        ):
            machine.tell(event, reason)
        if inputs.unreachable:
            machine.tell(GraspEvent.UNREACHABLE, inputs.unreachable)
        if broken or old:
            return machine.state
        machine.tell(GraspEvent.FRESH)
        if lost or inputs.position is None:
            return machine.state
        machine.tell(GraspEvent.FOUND)
        if not inputs.unreachable:
            machine.tell(GraspEvent.REACHABLE)
            machine.tell(GraspEvent.FOLLOW)
            if self._auto:
                machine.tell(GraspEvent.GRAB)
        return machine.state

    def old(self, now: float, pictures_t: float | None, joints_t: float | None) -> list[str]:
        """Say which inputs have not come yet, or are too old at `now`; times in s."""
        limits = self._limits
        return [
            *_stale_reason("pictures", now, pictures_t, limits.stale),
            *_stale_reason("joint angles", now, joints_t, limits.joints),
        ]

    def _broken(self, now: float, inputs: Observation) -> list[tuple[GraspEvent, str]]:
        machine, longest = self._machine, self._limits.moving
        broken = []
        if inputs.device_error:
            broken.append((GraspEvent.DEVICE_ERROR, inputs.device_error))
        if machine.state in TIMED_STATES and now - machine.since > longest:
            broken.append((GraspEvent.TIME_OUT, f"{machine.state} took over {longest:g} s"))
        return broken

    def _lost(self, now: float, inputs: Observation) -> list[str]:
        if inputs.hidden and self._machine.state is GraspState.APPROACHING:
            return []
        return _stale_reason("sight of the target", now, inputs.tracked_t, self._limits.lost)


def _stale_reason(what: str, now: float, t: float | None, limit: float) -> list[str]:
    """Say that something is too old to be trusted; nothing where it is not."""
    if t is None:
        return [f"no {what} yet"]
    if now - t <= limit:  # NaN is too old
        return []
    return [f"{what}: {now - t:.1f} s old, allowed are {limit:g} s"]
