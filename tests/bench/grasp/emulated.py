"""Grasps through the real drivers and the emulated devices, over TCP: python -m
tests.bench.grasp.emulated [N].

The simulated cell shows what the cameras see; its arm stands where the emulated controller says,
its fingers where the emulated gripper says. What is between them stops the emulated fingers.
"""

import sys
import time

from tests.support.devices.bench import running
from tests.support.devices.melfa_mover import controller, go_home, limits
from tests.support.devices.melfa_mover import mover as mover_at
from verify.core.records import StereoPair
from verify.devices.protocols import EncoderReading
from verify.grasping.actuators.gripper.gripper import GripperDriver
from verify.grasping.actuators.gripper.modbus import GripperSettings
from verify.grasping.actuators.melfa.mover import MelfaMover
from verify.grasping.actuators.protocols import ExecutePermission, GripperState
from verify.grasping.control.aim import Aim
from verify.grasping.control.arm import SteppedArm
from verify.grasping.control.loop import Actuators, GraspLoop
from verify.grasping.control.run import GraspOutcome, StopConditions, run
from verify.grasping.control.states import GraspState
from verify.grasping.tracking.target import ColourSelection, TrackingOptions
from verify.grasping.tracking.track import TargetTracker
from verify.simulation.cell.cell import RATE, CellWorld
from verify.simulation.cell.scene import draw_scene
from verify.simulation.cell.setup import SMALL_SIZE, cell_setup
from verify.simulation.emulators.gripper import GripperEngine, GripperOptions
from verify.simulation.emulators.hand import NO_CONTACT, contact_positions

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
    fingers = GripperEngine(GripperOptions(ACTIVATION))
    with running(controller(follows="command")) as at_arm, running(fingers) as at_fingers:
        go_home(at_arm, setup.home)  # the emulated program has left it outside the cell's box
        with mover_at(at_arm, limits(override=20, hand_speed=1.0), pause=0.02) as mover:
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
