"""Did the object come along, by the cameras? The last sight in the lift is kept, with its place."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robots.transforms import carry
from tests.verify.grab.quick_cell import quick_cell
from verify.grab.loop_record import Cycle, Known
from verify.grab.loop_target import Aim
from verify.grab.plan_target import Thing
from verify.grab.record import GrabRecord, Told
from verify.grab.run import Outcome
from verify.grab.states import State
from verify.grab.target import TargetSeen
from verify.recording.part import Facts
from verify.records import Array

CELL = quick_cell()
SPACE = CELL.planner.workspace
NOTHING, SQUARE = np.full(3, np.nan), np.full((3, 3), np.nan)
SPREAD = np.diag([3e-3, 1e-3, 2e-3]) ** 2  # m², of the object's place
FIELDS = ("seen_from_grip_mm", "seen_from_grip_expanded_uncertainty_mm", "seen_raised_mm")


def raised(angle: float) -> Array:
    """Joint angles with the shoulder turned back from home, rad."""
    q: Array = CELL.home - np.array([0.0, angle, 0.0, 0.0, 0.0, 0.0])
    return q


def cycle(state: State, q: Array, off: Array | None) -> Cycle:
    """A turn in which the object is seen `off` (3,), m, the grip point; None: it is not."""
    place = SPACE.grip(q)[:3, 3] + (NOTHING if off is None else off)
    seen = TargetSeen(
        frame=0, t=0.0, status="lost" if off is None else "occluded", reason="", left=None,
        right=None, windows=(None, None), centre=NOTHING, covariance=SQUARE, velocity=NOTHING,
        velocity_covariance=SQUARE, measured=carry(CELL.rig.rig_T_base, place),
        measured_covariance=SQUARE, size=NOTHING[:2], size_standard_uncertainty=NOTHING[:2],
        epipolar=np.nan, quality=0.0,
    )  # fmt: skip
    # a place is predicted for a while after the last sight: no sight either
    thing = Thing(SPACE.grip(q)[:3, 3] if off is None else place, SPREAD, 0.03, 1e-3, 0.02, 1e-3)
    return Cycle(0.0, state, "", None, seen, Known(thing, np.zeros(3), False), q, q, None, 0.0)


def told(folder: Path, cycles: Sequence[Cycle]) -> list[Any]:
    facts = Facts("arm", 6, {}, {}, turning=False)
    said = Told("arm", "blue object", "simulated", True, datetime.now(UTC))
    record = GrabRecord(folder, facts, SPACE, said, 30.0)
    for one in cycles:
        record.see(one)
    record.close()
    outcome = Outcome(State.LIFTED, "", True, (), len(cycles), False)
    summary = record.results(outcome, Aim(CELL.planner, CELL.rig)).summary
    return [summary[field] for field in FIELDS]


def test_the_last_sight_in_the_lift_outlives_what_is_not_seen_after_it(tmp_path: Path) -> None:
    low, middle, top = raised(0.0), raised(0.1), raised(0.3)
    cycles = [
        cycle(State.CLOSING, low, np.array([0.09, 0.0, 0.0])),
        cycle(State.LIFTING, low, np.array([0.05, 0.0, 0.0])),
        cycle(State.LIFTING, middle, np.array([3e-3, 0.0, -4e-3])),
        cycle(State.LIFTING, top, None),
        cycle(State.LIFTED, top, None),
    ]
    far, expanded, up = told(tmp_path, cycles)
    assert far == pytest.approx(5.0)
    robot = SPACE.cell.accuracy.robot
    assert expanded == pytest.approx(2e3 * np.hypot(3e-3, robot))
    way = SPACE.grip(middle)[:3, 3] - SPACE.grip(low)[:3, 3]
    assert up == pytest.approx(1e3 * np.linalg.norm(way))
    assert up > 10


def test_what_was_seen_before_the_lift_is_no_sight_of_it(tmp_path: Path) -> None:
    low, top = raised(0.0), raised(0.2)
    cycles = [
        cycle(State.APPROACHING, low, np.zeros(3)),
        cycle(State.CLOSING, low, np.zeros(3)),
        cycle(State.LIFTING, low, None),
        cycle(State.LIFTED, top, None),
    ]
    assert told(tmp_path, cycles) == [None, None, None]


def test_another_try_begins_without_the_sight_of_the_last(tmp_path: Path) -> None:
    low, top = raised(0.0), raised(0.2)
    slipped = [cycle(State.LIFTING, top, np.zeros(3)), cycle(State.RETREATING, top, None)]
    again = [cycle(State.APPROACHING, low, None), cycle(State.LIFTED, top, None)]
    assert told(tmp_path, slipped + again) == [None, None, None]
