"""A grab in the simulated cell, put together: the world, its source of pictures, and the loop."""

from dataclasses import dataclass

from verify.grab.flange_watch import FlangeWatch
from verify.grab.loop import Loop
from verify.grab.loop_arm import DrivenArm, StreamedArm
from verify.grab.loop_closed import ClosedAim, WatchedSource
from verify.grab.loop_orders import Hands
from verify.grab.loop_steps import SteppedArm
from verify.grab.loop_target import Aim
from verify.grab.motion_port import ExecuteRight
from verify.grab.run import Source
from verify.grab.target import Named, Options, Target
from verify.grab.target_tracking import Tracker
from verify.sim.cell import RATE, World
from verify.sim.cell_scene import Scene
from verify.sim.cell_setup import CellSetup
from verify.sim.cell_source import Bases, CellSource


@dataclass(frozen=True, slots=True)
class CellGrab:
    """What a grab in the cell runs on."""

    world: World
    source: Source
    loop: Loop


def cell_grab(
    setup: CellSetup,
    scene: Scene,
    target: Target | None = None,
    right: ExecuteRight | None = None,
    *,
    auto: bool = False,
    stepped: bool = False,
    paced: bool = False,
    closed: bool = True,
    bases: Bases | None = None,
) -> CellGrab:
    """Put a grab together; nothing has begun yet.

    Args:
        setup: what is known of the cell.
        scene: what stands there, and what happens.
        target: what to grab; by default the colour of the scene's first cap.
        right: the operator's order that the arm may move; None: it may not.
        auto: grab as soon as the target stands still.
        stepped: the arm takes one move at a time; else a stream of set points.
        paced: keep to the computer's clock.
        closed: the hand is seen above the object, and its end point corrected.
        bases: keep the angles of turning camera bases; None: fixed ones.

    Raises:
        InputError: the target's colour has no name.
    """
    tracker = Tracker(setup.rig, target or Named(scene.caps[0].colour), Options())
    world = World(setup, scene)
    cell = CellSource(world, bases, paced=paced)
    if right is None:
        aim = Aim(setup.planner, setup.rig)
        loop = Loop(setup.planner, tracker, aim, None, cell.joints, world.now)
        return CellGrab(world, cell, loop)
    mover, gripper = cell.devices(right)
    arm: DrivenArm = StreamedArm(setup.planner, mover, 1 / RATE)
    if stepped:
        arm = SteppedArm(setup.planner, mover)
    watch = FlangeWatch(setup.planner.arm, setup.rig, setup.marker)
    aim = ClosedAim(setup.planner, setup.rig, watch) if closed else Aim(setup.planner, setup.rig)
    loop = Loop(
        setup.planner,
        tracker,
        aim,
        Hands(arm, gripper),
        lambda: watch.read(cell.joints()),
        world.now,
        auto=auto,
    )
    return CellGrab(world, WatchedSource(cell, watch), loop)
