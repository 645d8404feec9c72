"""The simulated cell as the loop's surroundings: pictures, joints, devices, and what goes wrong."""

import time

from verify.devices import EncoderReading
from verify.grab.motion_port import ExecuteRight
from verify.records import StereoPair
from verify.sim.cell import RATE, SUBSTEPS, World
from verify.sim.cell_arm import SimMover
from verify.sim.cell_hand import SimGripper

ALARM = "alarm 0930 (servo error)"


class CellSource:
    """Gives the loop what it asks for, and lets the world go on while it waits.

    Args:
        world: the cell.
        paced: keep to the computer's clock, for an operator who watches; else as fast as it goes.
    """

    def __init__(self, world: World, *, paced: bool = False) -> None:
        self._world, self._paced = world, paced
        self._began = time.monotonic()
        self._mover: SimMover | None = None

    def devices(self, right: ExecuteRight) -> tuple[SimMover, SimGripper]:
        """Make arm and gripper, which the operator's right allows to move."""
        world = self._world
        self._mover = SimMover(world.arm, world.setup.planner, world.now, right)
        return self._mover, SimGripper(world.hand, world.now, right)

    def pair(self) -> StereoPair | None:
        """Take both pictures."""
        return self._world.pair()

    def joints(self) -> EncoderReading | None:
        """Read the joints."""
        return self._world.encoders()

    def wait(self) -> None:
        """Let a camera's period pass."""
        world = self._world
        for _ in range(SUBSTEPS):
            world.advance(1 / RATE / SUBSTEPS)
        world.judge()
        if self._mover is not None and world.happened("alarm") and world.arm.braked is None:
            self._mover.alarm(ALARM)
        if self._paced:
            time.sleep(max(0.0, self._began + world.t - time.monotonic()))
