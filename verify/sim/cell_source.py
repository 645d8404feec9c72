"""The simulated cell as the loop's surroundings: pictures, joints, devices, and what goes wrong."""

import time
from typing import Protocol

from verify.devices import EncoderReading, PanReading
from verify.grab.motion_port import ExecuteRight
from verify.records import StereoPair
from verify.sim.cell import RATE, SUBSTEPS, World
from verify.sim.cell_arm import SimMover
from verify.sim.cell_hand import SimGripper

ALARM = "alarm 0930 (servo error)"


class Bases(Protocol):
    """Turns readings of the camera bases into angles at an instant, as `verify run` does."""

    def add(self, reading: PanReading) -> None:
        """Take a reading."""
        ...

    def at(self, t: float) -> tuple[float, float] | None:
        """Angles of left and right base, rad, at an instant, s; None where they are not known."""
        ...


class CellSource:
    """Gives the loop what it asks for, and lets the world go on while it waits.

    Args:
        world: the cell.
        bases: are told how the camera bases stand, and asked; None: they stand as the rig says.
        paced: keep to the computer's clock, for an operator who watches; else as fast as it goes.
    """

    def __init__(self, world: World, bases: Bases | None = None, *, paced: bool = False) -> None:
        self._world, self._bases, self._paced = world, bases, paced
        self._began = time.monotonic()
        self._mover: SimMover | None = None

    def devices(self, right: ExecuteRight) -> tuple[SimMover, SimGripper]:
        """Make arm and gripper, which the operator's right allows to move."""
        world = self._world
        self._mover = SimMover(world.arm, world.setup.planner, world.now, right)
        return self._mover, SimGripper(world.hand, world.now, right)

    def pair(self) -> StereoPair | None:
        """Take both pictures; None where a base was turning when they were taken."""
        if self._bases is None:
            return self._world.pair()
        reading = self._world.bases()
        self._bases.add(reading)
        pans = self._bases.at(reading.t)
        return None if pans is None else self._world.pair(pans)

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
