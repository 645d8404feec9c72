"""A mover before an emulated controller."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial

import numpy as np

import robots
from tests.support.devices import bench
from tests.support.devices.bench import Emulated, same_angles
from verify.core.records import Array
from verify.devices.encoders.intake import AngleMap
from verify.grasping.actuators.melfa.mover import MelfaMover
from verify.grasping.actuators.melfa.orders import MOVE_COMMANDS, MotionSettings, MoveLimits
from verify.grasping.actuators.protocols import ExecutePermission, MoverState, MoverStatus
from verify.simulation.emulators import trajectory
from verify.simulation.emulators.arm import MelfaArm
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine
from verify.simulation.emulators.server import EmulatorFaults

RIGHT = ExecutePermission("--execute, in a test")
ARM = robots.load("rv_3sd_melfa")
LIMITS = np.column_stack([ARM.lower, ARM.upper])
FAST = 0.01  # s, pause: tests cannot wait


def controller(
    idle: bool = True, limits: Array = LIMITS, follows: str = "feedback", **options: object
) -> MelfaEngine:
    assert isinstance(ARM, robots.DhArm)
    arm = MelfaArm(trajectory.load("hold", 6), limits, follows, ARM, idle)
    return MelfaEngine(arm, ControllerOptions(**options))  # type: ignore[arg-type]


def limits(**changed: object) -> MoveLimits:
    chosen = {"hand_speed": 2.0, "override": 60} | changed  # tests cannot wait
    return MoveLimits(LIMITS, **chosen)  # type: ignore[arg-type]


@contextmanager
def mover(
    emulated: Emulated | str,
    moving: MoveLimits | None = None,
    angles: AngleMap | None = None,
    **settings: object,
) -> Iterator[MelfaMover]:
    address = emulated if isinstance(emulated, str) else emulated.address
    chosen = {"robot_type": "RV-3SD", "pause": FAST} | settings
    found = MelfaMover(
        MotionSettings(address, **chosen),  # type: ignore[arg-type]
        angles or same_angles(6),
        moving or limits(),
        RIGHT,
    )
    with closing(found):
        yield found


stepped = partial(bench.stepped, limit=15.0)  # a move takes longer
RESTS = {
    MoverState.READY, MoverState.ARRIVED, MoverState.HELD, MoverState.RELEASED, MoverState.FAILED,
}  # fmt: skip


def settled(arm: MelfaMover, state: MoverState) -> list[MoverStatus]:
    seen = stepped(arm, lambda status: status.state in RESTS)
    assert seen[-1].state is state, seen[-1]
    return seen


def ready(arm: MelfaMover) -> None:
    arm.take_controls()
    settled(arm, MoverState.READY)


@contextmanager
def moving(
    engine: MelfaEngine,
    where: str = "tcp:0",
    faults: EmulatorFaults | None = None,
    chosen: MoveLimits | None = None,
    **settings: object,
) -> Iterator[MelfaMover]:
    """A mover that has taken an emulated controller's controls; slow unless limits are given."""
    with (
        bench.running(engine, where, faults) as emulated,
        mover(emulated, chosen or limits(override=3), **settings) as arm,
    ):
        ready(arm)
        yield arm


def failure(arm: MelfaMover) -> str:
    """Step until it has failed; the reason."""
    stepped(arm, lambda status: status.state is MoverState.FAILED)
    return settled(arm, MoverState.FAILED)[-1].reason


def given_back(engine: MelfaEngine) -> bool:
    """Whether the controller has its controls back, without power and without motion."""
    return not (engine.arm.right or engine.arm.servo_on or engine.arm.moving)


def go_home(emulated: Emulated, home: Array) -> None:
    with mover(emulated, limits(override=50), pause=0.02) as arm:
        ready(arm)
        arm.move(home)
        settled(arm, MoverState.ARRIVED)


PORTS = ["tcp:0", "pty"]
HOME = np.deg2rad(trajectory.HOME_DEG)
NEXT = HOME + np.deg2rad([8.0, -5.0, 6.0, 10.0, -8.0, 12.0])


def under_way(arm: MelfaMover, q: Array) -> None:
    """Order a move, and come back in its middle."""
    begin = arm.step().q
    assert begin is not None
    arm.move(q)
    far = float(np.max(np.abs(q - begin)))
    low, high = 0.2 * far, 0.8 * far
    stepped(arm, lambda s: s.q is not None and low < np.max(np.abs(s.q - begin)) < high)


def names(engine: MelfaEngine) -> list[str]:
    """What the controller was told, without what only reads and without arguments."""
    output = [
        next((name for name in MOVE_COMMANDS if order.startswith(name)), "") for order in engine.log
    ]
    return [name for name in output if name]


def found_at(engine: MelfaEngine, override: int) -> MelfaEngine:
    """Set the override as somebody at the controller has left it."""
    engine.arm._override = override
    return engine
