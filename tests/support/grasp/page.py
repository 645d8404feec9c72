"""A grasp in the simulated cell that runs in a thread, with its page."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from websockets.sync.client import connect

from robots.transforms import carry, invert
from verify.cli.grab.conduct import GraspPage
from verify.cli.options import PageOptions
from verify.core.records import Array
from verify.grasping.actuators.protocols import ExecutePermission
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.run import GraspOutcome, StopConditions, run
from verify.grasping.control.states import GraspState
from verify.grasping.page import GraspFacts
from verify.grasping.tracking.camshift import Box
from verify.live.page.access import LOOPBACK
from verify.simulation.cell.grab import CellMode, CellRun, cell_grab
from verify.simulation.cell.scene import Cap, CellScene
from verify.simulation.cell.setup import ROBOT, SMALL_SIZE, cell_setup

STANDS = CellScene((Cap("blue", (0.47, 0.03)), Cap("red", (0.47, -0.12))), seed=1)
LIMIT = 30.0  # s, for anything to happen


class Cell:
    """The cell, its loop, and its page."""

    def __init__(self, scene: CellScene, *, execute: bool, selects: bool, paced: bool) -> None:
        setup = cell_setup(SMALL_SIZE)
        permission = ExecutePermission("test") if execute else None
        self.grab: CellRun = cell_grab(
            setup, scene, permission=permission, mode=CellMode(paced=paced, closed=False)
        )
        facts = GraspFacts(ROBOT, "played", setup.workspace, setup.rig, execute, 60.0)
        options = PageOptions(0, LOOPBACK, None)
        self.page = GraspPage(self.grab.loop, options, facts, selects=selects)
        self.ended: GraspOutcome | None = None
        self.angles: list[Array] = []  # as read, a turn each
        self.stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def state(self) -> GraspState:
        return self.grab.loop.machine.state

    @property
    def states(self) -> list[GraspState]:
        """All that were entered, first to last."""
        return [passage.target for passage in self.grab.loop.machine.log]

    @property
    def port(self) -> int:
        return int(self.page._page.url.split(":")[2].split("/")[0])

    def line(self, **settings: Any) -> Any:
        """A viewer's line, from the page's own origin; it takes what comes without being read."""
        host = f"127.0.0.1:{self.port}"
        settings = {"max_queue": None, **settings}
        return connect(f"ws://{host}/live", origin=f"http://{host}", **settings)

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < end, self.states
            time.sleep(0.01)

    def turns(self, count: int) -> None:
        """Let the loop turn some more."""
        wanted = len(self.angles) + count
        self.until(lambda: len(self.angles) >= wanted)

    def travelled(self, count: int) -> float:
        """How far any joint goes in the next turns, rad, by what is ordered."""
        self.turns(count)
        return float(np.ptp(np.array(self.angles[-count:]), axis=0).max())

    def box(self, cap: int = 0, side: int = 0) -> Box:
        """What a cap fills of a picture."""
        return filled(self.grab.world.scene.caps[cap], self.place(cap), side)

    def place(self, cap: int) -> Array:
        """Where a cap really is, (3,), m, base frame."""
        pose = self.grab.world.cap(cap, self.grab.world.t)
        return pose[:3, 3]

    def end(self) -> None:
        self.stop.set()
        self._thread.join(LIMIT)
        self.page.close()

    def _see(self, cycle: LoopCycle) -> None:
        self.page.show(cycle)
        self.angles.append(self.grab.world.arm.q(self.grab.world.t))

    def _run(self) -> None:
        loop, source = self.grab.loop, self.grab.source
        ends, page = StopConditions(60.0, 60.0), self.page
        self.ended = run(loop, source, ends, self._see, page.orders, page.refuse, self.stop.is_set)
        page.end(self.ended)


def filled(cap: Cap, place: Array, side: int = 0) -> Box:
    """What a cap fills of a picture, by where it really is: x, y, width, height, px."""
    rig = cell_setup(SMALL_SIZE).rig
    camera = (rig.left, rig.right)[side]
    turn = np.linspace(0, 2 * np.pi, 60)
    rim = cap.radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    ends = [rim + np.array([0, 0, sign * cap.height / 2]) for sign in (-1, 1)]
    points = carry(rig.rig_T_base, np.concatenate(ends) + place)
    seen = camera.project(carry(invert(camera.rig_T_camera(camera.pan)), points))
    low, high = np.floor(seen.min(axis=0)).astype(int), np.ceil(seen.max(axis=0)).astype(int)
    x, y, width, height = (int(v) for v in (*low, *(high - low + 1)))
    return x, y, width, height


@contextmanager
def grabbing(
    scene: CellScene = STANDS, *, execute: bool = True, selects: bool = False, paced: bool = True
) -> Iterator[Cell]:
    cell = Cell(scene, execute=execute, selects=selects, paced=paced)
    try:
        yield cell
    finally:
        cell.end()
