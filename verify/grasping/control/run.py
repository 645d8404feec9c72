"""Run the control loop from the start of a grasp to a named end."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from verify.core.records import StereoPair
from verify.grasping.actuators.protocols import FINAL_STATES
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.loop import GraspLoop
from verify.grasping.control.states import GraspEvent, GraspState, StateChange

END_STATES = frozenset(
    {GraspState.LIFTED, GraspState.MISSED, GraspState.FAULT, GraspState.RELEASED}
)
HOLDING_STATES = frozenset(s for s in GraspState if s.value.startswith("holding-"))
END_DELAY = 0.7  # s that are still watched after the end
RELEASE_TIMEOUT = 10.0  # s for coming to rest and giving the controls back


class PairSource(Protocol):
    """Where pictures come from, and when the next cycle is due."""

    def pair(self) -> StereoPair | None:
        """Give the newest pictures; None where there are no new ones."""

    def wait(self) -> None:
        """Let time pass until the next cycle."""


@dataclass(frozen=True, slots=True)
class StopConditions:
    """When a grab that has not ended by itself is over."""

    duration: float  # s
    patience: float  # s in one of the holding states
    planned: bool = True  # a plan ends it, where nothing may move


@dataclass(frozen=True, slots=True)
class GraspOutcome:
    """How a grab ended."""

    state: GraspState  # before the controls were given back
    reason: str
    released: bool  # and were they?
    passages: tuple[StateChange, ...]
    cycles: int
    stopped: bool  # the operator ended it


CycleCallback = Callable[[LoopCycle], None]


def run(
    loop: GraspLoop,
    source: PairSource,
    ends: StopConditions,
    on_cycle: CycleCallback,
    orders: Callable[[], Sequence[GraspEvent]] = tuple,
    say: Callable[[str], None] = lambda _: None,
    stop: Callable[[], bool] = lambda: False,
) -> GraspOutcome:
    """Run until it ends by itself, the time is over, or the operator stops it.

    `orders` returns what the operator has ordered since the last call, `say` gets the reason why an
    order does not count, `stop` says whether the operator wants it to end.
    """
    loop.start()
    machine = loop.machine
    began: float | None = None
    count, over_since, stopped = 0, None, False
    while True:
        cycle = loop.cycle(source.pair())
        count += 1
        began = cycle.t if began is None else began
        on_cycle(cycle)
        for event in orders():
            if refusal := loop.tell(event):
                say(refusal)
        stopped = stop()
        planned = ends.planned and not loop.may_move and loop.aim.planned is not None
        if machine.state not in END_STATES and not planned:
            over_since = None
        elif over_since is None:
            over_since = cycle.t
        lingered = over_since is not None and cycle.t - over_since >= END_DELAY
        held = machine.state in HOLDING_STATES and cycle.t - machine.since > ends.patience
        if lingered or stopped or held or cycle.t - began >= ends.duration:
            break
        source.wait()
    state = machine.state
    reason = loop.awaited if state is GraspState.IDLE else loop.reason
    count += _release(loop, source, on_cycle)
    released = machine.state is GraspState.RELEASED
    if loop.arm is not None and not loop.arm.given_back:
        released, why = False, loop.arm.reason or "the arm does not answer"
        say(f"the controls were NOT given back: {why}. Look whether it stands")
    return GraspOutcome(state, reason, released, tuple(machine.log), count, stopped)


def _release(loop: GraspLoop, source: PairSource, on_cycle: CycleCallback) -> int:
    """Come to rest and give the controls back; says in how many cycles."""
    machine, count = loop.machine, 0
    machine.tell(GraspEvent.INTERRUPT)
    began = now = machine.since
    while now - began < RELEASE_TIMEOUT:
        machine.tell(GraspEvent.INTERRUPT)  # again after a fault meanwhile
        ended = loop.arm is None or loop.arm.state in FINAL_STATES
        if ended and machine.state is GraspState.RELEASED:
            break
        source.wait()
        cycle = loop.cycle(source.pair())
        on_cycle(cycle)
        now, count = cycle.t, count + 1
    return count
