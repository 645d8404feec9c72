"""What one cycle of the loop saw, ordered and read."""

from dataclasses import dataclass

from verify.grab.motion_port import GripperStatus
from verify.grab.plan_target import Thing
from verify.grab.states import State
from verify.grab.target import TargetSeen
from verify.records import Array, StereoPair


@dataclass(frozen=True, slots=True)
class Known:
    """The target in the robot's base."""

    thing: Thing
    velocity: Array  # (3,), m/s
    tracked: bool  # seen whole, now


@dataclass(frozen=True, slots=True)
class Cycle:
    """One turn of the loop; times on its clock, s."""

    t: float
    state: State
    reason: str  # why it is in that state
    pair: StereoPair | None  # None: no new pictures
    seen: TargetSeen | None
    known: Known | None
    q: Array | None  # (n,), rad, read
    q_ordered: Array | None  # (n,), rad
    gripper: GripperStatus | None
    took: float  # s that the cycle worked, by the computer's own clock
