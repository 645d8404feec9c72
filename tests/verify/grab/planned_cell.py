"""The example cell of docs/grab.md, and an arm in it."""

import dataclasses
import functools
import re
from pathlib import Path

import numpy as np

import robots
from verify.grab import cell_file
from verify.grab.cell_file import Cell
from verify.grab.plan import Planner, planner
from verify.grab.plan_target import Thing
from verify.records import Array

DOCS = Path(__file__).parents[3] / "docs" / "grab.md"
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
    read, warnings = cell_file.read(path)
    assert warnings == ()
    return read


def setup(folder: Path) -> Planner:
    return planner(melfa(), cell(folder), CAMERAS)


def home(made: Planner) -> Array:
    assert made.cell.moving.home is not None
    return made.cell.moving.home


def cap(x: float = 0.45, y: float = 0.0, z: float = 0.03, **changes: object) -> Thing:
    """A bottle cap, 30 mm wide and 20 mm high, known within a millimetre."""
    thing = Thing(np.array([x, y, z]), np.eye(3) * 1e-6, 0.03, 1e-3, 0.02, 1e-3)
    return dataclasses.replace(thing, **changes)  # type: ignore[arg-type]
