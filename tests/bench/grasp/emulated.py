"""Grasps through the real drivers and the emulated devices, over TCP: python -m
tests.bench.grasp.emulated [N].

The simulated cell shows what the cameras see; its arm stands where the emulated controller says,
its fingers where the emulated gripper says. What is between them stops the emulated fingers.
"""

import sys
import time

import numpy as np

import robots
from tests.support.devices.bench import running, same_angles
from verify.core.records import Array, StereoPair
from verify.devices.protocols import EncoderReading
from verify.grasping.actuators.gripper.gripper import GripperDriver
from verify.grasping.actuators.gripper.modbus import GripperSettings
from verify.grasping.actuators.melfa.mover import MelfaMover
from verify.grasping.actuators.melfa.orders import MotionSettings, MoveLimits
from verify.grasping.actuators.protocols import ExecutePermission, GripperState, MoverState
from verify.grasping.control.aim import Aim
from verify.grasping.control.arm import SteppedArm
from verify.grasping.control.loop import Actuators, GraspLoop
from verify.grasping.control.run import GraspOutcome, StopConditions, run
from verify.grasping.control.states import GraspState
from verify.grasping.tracking.target import ColourSelection, TrackingOptions
from verify.grasping.tracking.track import TargetTracker
from verify.simulation.cell.cell import RATE, CellWorld
from verify.simulation.cell.scene import draw_scene
from verify.simulation.cell.setup import ROBOT, SMALL_SIZE, cell_setup
from verify.simulation.emulators import trajectory
from verify.simulation.emulators.arm import MelfaArm
from verify.simulation.emulators.gripper import GripperEngine, GripperOptions
from verify.simulation.emulators.hand import NO_CONTACT, contact_positions
from verify.simulation.emulators.melfa import ControllerOptions, MelfaEngine

RIGHT = ExecutePermission("bench")
ENDS = StopConditions(duration=90.0, patience=5.0)
ACTIVATION = 0.5  # s


class Mirror:
    """The simulated world beside devices that keep the computer's time."""

    def __init__(
        self, world: CellWorld, mover: MelfaMover, gripper: GripperDriver, engine: GripperEngine
    ) -> None:
        self._world, self._mover, self._gripper, self._engine = world, mover, gripper, engine
        self._began = time.monotonic()

    def now(self) -> float:
        return time.monotonic() - self._began

    def pair(self) -> StereoPair | None:
        world, arm, fingers = self._world, self._mover.step(), self._gripper.step()
        if arm.q is not None:
            world.arm.braked = arm.q
        if fingers.opening is not None:
            world.hand.opening = min(fingers.opening, world.hand.widest)
        if fingers.state is GripperState.GRIPPED and world.hand.between > 0:
            world.hand.opening = world.hand.between  # the gripper tells it in whole steps
        world.hand.goal = world.hand.opening
        world.advance(self.now() - world.t)
        between = world.hand.between
        self._engine.hand.contacts = contact_positions(1e3 * between) if between > 0 else NO_CONTACT
        return world.pair()

    def joints(self) -> EncoderReading | None:
        status = self._mover.step()
        if status.q is None or status.t is None:
            return None
        t = status.t - self._began
        return EncoderReading(t, t, 0.05, 0, status.q)

    def wait(self) -> None:
        time.sleep(max(0.0, self._world.t + 1 / RATE - self.now()))


def grasp(seed: int) -> tuple[GraspOutcome, CellWorld]:
    setup = cell_setup(SMALL_SIZE)
    arm = robots.load(ROBOT)
    assert isinstance(arm, robots.DhArm)
    limits = np.column_stack([arm.lower, arm.upper])
    moved = MelfaArm(trajectory.load("hold", 6), 6, limits, "command", arm, True)
    controller = MelfaEngine(moved, ControllerOptions())
    fingers = GripperEngine(GripperOptions(ACTIVATION))
    with running(controller) as at_arm, running(fingers) as at_fingers:
        settings = MotionSettings(at_arm.address, "RV-3SD", pause=0.02)
        most = MoveLimits(limits, override=20, hand_speed=1.0)
        with MelfaMover(settings, same_angles(6), most, RIGHT) as mover:
            _go_home(mover, setup.home)
        with MelfaMover(settings, same_angles(6), most, RIGHT) as mover:
            gripper = GripperDriver(GripperSettings(at_fingers.address), RIGHT)
            world = CellWorld(setup, draw_scene(seed))
            mirror = Mirror(world, mover, gripper, fingers)
            tracker = TargetTracker(setup.rig, ColourSelection("blue"), TrackingOptions())
            aim = Aim(setup.planner, setup.rig)
            hands = Actuators(SteppedArm(setup.planner, mover), gripper)
            loop = GraspLoop(
                setup.planner, tracker, aim, hands, mirror.joints, mirror.now, auto=True
            )
            ended = run(loop, mirror, ENDS, lambda _: None)
            gripper.close()
    return ended, world


def _go_home(mover: MelfaMover, home: Array) -> None:
    """The emulated program has left the arm outside the cell's box."""
    mover.take_controls()
    _until(mover, MoverState.READY)
    mover.move_joints(home)
    _until(mover, MoverState.ARRIVED)


def _until(mover: MelfaMover, state: MoverState) -> None:
    end = time.monotonic() + 30.0
    while (status := mover.step()).state is not state:
        assert time.monotonic() < end, status
        time.sleep(0.01)


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    good = 0
    for seed in range(count):
        began = time.monotonic()
        ended, world = grasp(seed)
        held = world.held is not None and world.held[0] == 0
        good += held and ended.state is GraspState.LIFTED
        took = time.monotonic() - began
        print(f"  seed {seed}: {ended.state.value}, {ended.reason}; held: {held}; {took:.0f} s")
    print(f"lifted with the cap in the hand, over TCP: {good} of {count}")


if __name__ == "__main__":
    main()
