"""Grasps through the real drivers and the emulated devices, over TCP: python -m
tests.bench.grab_emulated [N].

The simulated cell shows what the cameras see; its arm stands where the emulated controller says,
its fingers where the emulated gripper says. What is between them stops the emulated fingers.
"""

import sys
import time

import numpy as np

import robots
from tests.verify.devices.bench import running, same_angles
from verify.devices import EncoderReading
from verify.emulators import trajectory
from verify.emulators.gripper import GripperEngine, GripperOptions
from verify.emulators.gripper_hand import NOTHING, contacts_of
from verify.emulators.melfa import ControllerOptions, MelfaEngine
from verify.emulators.melfa_arm import MelfaArm
from verify.grab.gripper import GripperDriver
from verify.grab.gripper_reader import GripperSettings
from verify.grab.loop import Loop
from verify.grab.loop_orders import Hands
from verify.grab.loop_steps import SteppedArm
from verify.grab.loop_target import Aim
from verify.grab.melfa_motion import MelfaMover
from verify.grab.melfa_motion_settings import MotionSettings, MoveLimits
from verify.grab.motion_port import ExecuteRight, GripperState, MoverState
from verify.grab.run import Ends, Outcome, run
from verify.grab.states import State
from verify.grab.target import Named, Options
from verify.grab.target_tracking import Tracker
from verify.records import Array, StereoPair
from verify.sim.cell import RATE, World
from verify.sim.cell_scene import drawn_scene
from verify.sim.cell_setup import ROBOT, SMALL, cell_setup

RIGHT = ExecuteRight("bench")
ENDS = Ends(duration=90.0, patience=5.0)
ACTIVATION = 0.5  # s


class Mirror:
    """The simulated world beside devices that keep the computer's time."""

    def __init__(
        self, world: World, mover: MelfaMover, gripper: GripperDriver, engine: GripperEngine
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
        self._engine.hand.contacts = contacts_of(1e3 * between) if between > 0 else NOTHING
        return world.pair()

    def joints(self) -> EncoderReading | None:
        status = self._mover.step()
        if status.q is None or status.t is None:
            return None
        t = status.t - self._began
        return EncoderReading(t, t, 0.05, 0, status.q)

    def wait(self) -> None:
        time.sleep(max(0.0, self._world.t + 1 / RATE - self.now()))


def grasp(seed: int) -> tuple[Outcome, World]:
    setup = cell_setup(SMALL)
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
            world = World(setup, drawn_scene(seed))
            mirror = Mirror(world, mover, gripper, fingers)
            tracker = Tracker(setup.rig, Named("blue"), Options())
            aim = Aim(setup.planner, setup.rig)
            hands = Hands(SteppedArm(setup.planner, mover), gripper)
            loop = Loop(setup.planner, tracker, aim, hands, mirror.joints, mirror.now, auto=True)
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
        good += held and ended.state is State.LIFTED
        took = time.monotonic() - began
        print(f"  seed {seed}: {ended.state.value}, {ended.reason}; held: {held}; {took:.0f} s")
    print(f"lifted with the cap in the hand, over TCP: {good} of {count}")


if __name__ == "__main__":
    main()
