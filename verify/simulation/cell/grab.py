"""A grasp in the simulated cell: pictures, joints, devices and scene events around the loop."""

import time
from dataclasses import dataclass

from verify.core.records import StereoPair
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.control.aim import Aim
from verify.grasping.control.arm import DrivenArm, SteppedArm, StreamedArm
from verify.grasping.control.loop import Actuators, GraspLoop
from verify.grasping.control.run import PairSource
from verify.grasping.tool_offset.watch import FlangeWatch
from verify.grasping.tracking.target import ColourSelection, Target
from verify.grasping.tracking.track import TargetTracker
from verify.live.buffers import PanBuffer
from verify.simulation.cell.arm import SimMover
from verify.simulation.cell.cell import N_SUBSTEPS, RATE, CellWorld
from verify.simulation.cell.hand import SimGripper
from verify.simulation.cell.scene import CellScene
from verify.simulation.cell.setup import CellSetup

ALARM = "alarm 0930 (servo error)"


class CellSource:
    """Gives the loop what it asks for, and lets the world go on while it waits.

    Without `bases` the cameras' stand as the rig says; `paced` keeps to the computer's clock.
    """

    def __init__(
        self, world: CellWorld, bases: PanBuffer | None = None, *, paced: bool = False
    ) -> None:
        self._world, self._bases, self._paced = world, bases, paced
        self._began = time.monotonic()
        self._mover: SimMover | None = None

    def devices(self, permission: ExecutePermission) -> tuple[SimMover, SimGripper]:
        """Make arm and gripper, which the operator's permission allows to move."""
        world = self._world
        self._mover = SimMover(world.arm, world.setup.workspace, world.now, permission)
        return self._mover, SimGripper(world.hand, world.now, permission)

    def pair(self) -> StereoPair | None:
        """Take both pictures; None where a base was turning when they were taken."""
        if self._bases is None:
            return self._world.pair()
        reading = self._world.bases()
        self._bases.add(reading)
        pans = self._bases.at(reading.t)
        return None if pans is None else self._world.pair(pans)

    def wait(self) -> None:
        """Let a camera's period pass."""
        world = self._world
        for _ in range(N_SUBSTEPS):
            world.advance(1 / RATE / N_SUBSTEPS)
        if self._mover is not None and world.happened("alarm") and world.arm.braked is None:
            self._mover.alarm(ALARM)
        if self._paced:
            time.sleep(max(0.0, self._began + world.t - time.monotonic()))


@dataclass(frozen=True, slots=True)
class CellRun:
    """What a grab in the cell runs on."""

    world: CellWorld
    source: PairSource
    loop: GraspLoop


@dataclass(frozen=True, slots=True)
class CellMode:
    """How a grasp in the cell is driven."""

    auto: bool = False  # grasp as soon as the target stands still
    stepped: bool = False  # the arm takes one move at a time; else a stream of set points
    paced: bool = False  # keep to the computer's clock
    closed: bool = True  # the hand is seen above the object, and its end point corrected


def cell_grab(
    setup: CellSetup,
    scene: CellScene,
    target: Target | None = None,
    permission: ExecutePermission | None = None,
    *,
    mode: CellMode = CellMode(),
    bases: PanBuffer | None = None,
) -> CellRun:
    """Put a grab together; nothing has begun yet.

    The target is the colour of the scene's first cap, where none is given. Without the operator's
    permission the arm may not move.

    Raises:
        InputError: the target's colour has no name.
    """
    tracker = TargetTracker(setup.rig, target or ColourSelection(scene.caps[0].colour))
    world = CellWorld(setup, scene)
    cell = CellSource(world, bases, paced=mode.paced)
    actuators = watch = None
    if permission is not None:
        mover, gripper = cell.devices(permission)
        arm: DrivenArm = StreamedArm(setup.workspace, mover, 1 / RATE)
        if mode.stepped:
            arm = SteppedArm(setup.workspace, mover)
        actuators = Actuators(arm, gripper)
        if mode.closed:
            watch = FlangeWatch(setup.workspace.arm, setup.rig, setup.marker)
    aim = Aim(setup.workspace, setup.rig, watch)
    loop = GraspLoop(
        setup.workspace, tracker, aim, actuators, world.encoders, world.now, auto=mode.auto
    )
    return CellRun(world, cell, loop)
