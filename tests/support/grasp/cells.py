"""The example cell of docs/grab.md, and an arm in it.

The simulated cell with small pictures and a quicker line down: the same grabs in less time.
"""

import functools
import re
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path

import msgspec
import numpy as np

import robots
from tests.support.grasp.monitor import MonitoredRun
from verify.core.records import Array
from verify.grasping import cell as grasping_cell
from verify.grasping.cell import Cell
from verify.grasping.planning.object import GraspObject
from verify.grasping.planning.workspace import RESOLUTION, Workspace, make_workspace
from verify.simulation.cell.setup import SMALL_SIZE, CellSetup, cell_setup

DOCS = Path(__file__).parents[3] / "docs" / "grab.md"
CELL = (resources.files("verify.simulation") / "cell.toml").read_text()
STATION = """
format = 1
robot = "{robot}"
rig = "film/rig.toml"
marker = "film/marker.toml"

[left]
source = "film/left.mkv"
rate_hz = 30.0

[right]
source = "film/right.mkv"
rate_hz = 30.0

[encoders]
driver = "melfa"
port = "{port}"
robot_type = "RV-3SD"
pause_ms = 20.0
"""
CAMERAS = np.array([[1.1, -0.2, 0.7], [1.1, 0.2, 0.7]])


def example() -> str:
    """The grab.toml that the page shows."""
    return re.findall(r"```toml\n(# grab\.toml\n.*?)```", DOCS.read_text("utf-8"), re.DOTALL)[0]


@functools.cache
def melfa() -> robots.DhArm:
    arm = robots.load("rv_3sd_melfa")
    assert isinstance(arm, robots.DhArm)
    return arm


def cell(folder: Path) -> Cell:
    path = folder / "grab.toml"
    path.write_text(example(), encoding="utf-8")
    read, warnings = grasping_cell.read(path)
    assert warnings == ()
    return read


def setup(folder: Path) -> Workspace:
    return make_workspace(melfa(), cell(folder), CAMERAS)


def changed(made: Workspace, cameras: Array | None = None, **cell: object) -> Workspace:
    """The same with other cameras, or with other parts of the cell."""
    return replace(
        made,
        cell=replace(made.cell, **cell),  # type: ignore[arg-type]
        cameras=made.cameras if cameras is None else cameras,
    )


def home(made: Workspace) -> Array:
    assert made.cell.moving.home is not None
    return made.cell.moving.home


def cap(x: float = 0.45, y: float = 0.0, z: float = 0.03, **changes: object) -> GraspObject:
    """A bottle cap, 30 mm wide and 20 mm high, known within a millimetre."""
    thing = GraspObject(np.array([x, y, z]), np.eye(3) * 1e-6, 0.03, 1e-3, 0.02, 1e-3)
    return replace(thing, **changes)  # type: ignore[arg-type]


SPEED, ACCELERATION, JERK = 0.12, 0.8, 8.0  # m/s, m/s², m/s³


@cache
def quick_cell(*, turning: bool = False) -> CellSetup:
    """Put it together; the arm's own limits stay as they are."""
    usual = cell_setup(SMALL_SIZE, turning=turning)
    line = msgspec.structs.replace(
        usual.workspace.cell.approach, speed=SPEED, acceleration=ACCELERATION, jerk=JERK
    )
    return replace(usual, workspace=changed(usual.workspace, approach=line))


def kept_limits(grab: MonitoredRun) -> bool:
    """Whether the arm kept to its speeds and to the workspace."""
    watch = grab.monitor.limits
    return max(watch.speed, watch.acceleration) < 1 + 1e-6 and watch.outside < RESOLUTION


def grip_error(grab: MonitoredRun) -> float:
    """Distance of the grip point from where it was to be, m, as the world knows it."""
    seen, plan = grab.monitor, grab.loop.aim.plan
    assert seen.closed_on is not None
    assert seen.closed_at is not None
    return float(np.linalg.norm(seen.closed_on - seen.closed_at - [0, 0, plan.margin.raised]))
