"""Did the object come along, by the cameras? The last sight in the lift is kept, with its place.

What was seen of the hand is kept, told in the report, and said in the line at the end.
"""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
import pytest

import robots
from reports.document.blocks import Paragraph, Table
from reports.grasp.certificate import outcome
from reports.grasp.document import document
from reports.results import Results
from robots.transforms import carry
from tests.support.grasp.cells import melfa, quick_cell, setup
from verify.core.records import Array
from verify.grasping.control.aim import Aim, LoopCycle, TargetState
from verify.grasping.control.run import GraspOutcome
from verify.grasping.control.states import GraspState
from verify.grasping.planning.object import GraspObject
from verify.grasping.record.record import LIFT_FIELDS, GraspContext, GraspRecord
from verify.grasping.record.rows import tool_offset_fields, tool_offset_table
from verify.grasping.record.video import Mp4Writer
from verify.grasping.tool_offset.offset import FlangeMeasurement, OffsetMeasurement, ToolOffset
from verify.grasping.tracking.target import TargetObservation
from verify.live.recording.session import SessionFacts

CELL = quick_cell()
SPACE = CELL.workspace
NOTHING, SQUARE = np.full(3, np.nan), np.full((3, 3), np.nan)
SPREAD = np.diag([3e-3, 1e-3, 2e-3]) ** 2  # m², of the object's place


def raised(angle: float) -> Array:
    """Joint angles with the shoulder turned back from home, rad."""
    q: Array = CELL.home - np.array([0.0, angle, 0.0, 0.0, 0.0, 0.0])
    return q


def cycle(state: GraspState, q: Array, off: Array | None) -> LoopCycle:
    """A turn in which the object is seen `off` (3,), m, the grip point; None: it is not."""
    place = SPACE.grip(q)[:3, 3] + (NOTHING if off is None else off)
    seen = TargetObservation(
        frame=0, t=0.0, status="lost" if off is None else "occluded", reason="", left=None,
        right=None, windows=(None, None), centre=NOTHING, covariance=SQUARE, velocity=NOTHING,
        velocity_covariance=SQUARE, measured=carry(CELL.rig.rig_T_base, place),
        size=NOTHING[:2], size_standard_uncertainty=NOTHING[:2],
        epipolar=np.nan, quality=0.0,
    )  # fmt: skip
    # a place is predicted for a while after the last sight: no sight either
    thing = GraspObject(
        SPACE.grip(q)[:3, 3] if off is None else place, SPREAD, 0.03, 1e-3, 0.02, 1e-3
    )
    return LoopCycle(
        0.0, state, "", None, seen, TargetState(thing, np.zeros(3), False), q, q, None, 0.0
    )


def lift_fields(folder: Path, cycles: Sequence[LoopCycle]) -> list[Any]:
    facts = SessionFacts("arm", 6, {}, {}, turning=False)
    message = GraspContext("arm", "blue object", "simulated", True, datetime.now(UTC))
    record = GraspRecord(folder, facts, SPACE, message, 30.0)
    for one in cycles:
        record.add(one)
    record.close()
    outcome = GraspOutcome(GraspState.LIFTED, "", True, (), len(cycles), False)
    summary = record.results(outcome, Aim(CELL.workspace, CELL.rig)).summary
    return [summary[field] for field in LIFT_FIELDS]


@pytest.mark.parametrize("rate", [0.0001, 0.3, 29.97])
def test_a_film_has_the_rate_of_its_pictures_however_slow(tmp_path: Path, rate: float) -> None:
    film = Mp4Writer(tmp_path / "film.mp4", rate)
    for _ in range(3):
        film.add(cycle(GraspState.LIFTING, raised(0.0), None))
    film.close()
    with av.open(str(tmp_path / "film.mp4")) as opened:
        stream = opened.streams.video[0]
        assert float(stream.average_rate or 0) == pytest.approx(max(rate, 1e-3), rel=1e-3)
        assert sum(1 for _ in opened.decode(stream)) == 3


def test_the_last_detection_in_the_lift_is_kept(tmp_path: Path) -> None:
    low, middle, top = raised(0.0), raised(0.1), raised(0.3)
    cycles = [
        cycle(GraspState.CLOSING, low, np.array([0.09, 0.0, 0.0])),
        cycle(GraspState.LIFTING, low, np.array([0.05, 0.0, 0.0])),
        cycle(GraspState.LIFTING, middle, np.array([3e-3, 0.0, -4e-3])),
        cycle(GraspState.LIFTING, top, None),
        cycle(GraspState.LIFTED, top, None),
    ]
    far, expanded, up = lift_fields(tmp_path, cycles)
    assert far == pytest.approx(5.0)
    robot = SPACE.cell.accuracy.robot
    assert expanded == pytest.approx(2e3 * np.hypot(3e-3, robot))
    way = SPACE.grip(middle)[:3, 3] - SPACE.grip(low)[:3, 3]
    assert up == pytest.approx(1e3 * np.linalg.norm(way))
    assert up > 10


@pytest.mark.parametrize(
    "seen",
    [
        [(GraspState.APPROACHING, 0.0), (GraspState.CLOSING, 0.0), (GraspState.LIFTING, None)],
        [(GraspState.LIFTING, 0.0), (GraspState.RETREATING, None), (GraspState.APPROACHING, None)],
    ],
    ids=["before the lift", "in an earlier try"],
)
def test_other_detections_do_not_count(
    seen: list[tuple[GraspState, float | None]], tmp_path: Path
) -> None:
    cycles = [
        cycle(state, raised(0.0), None if off is None else np.full(3, off)) for state, off in seen
    ]
    last = cycle(GraspState.LIFTED, raised(0.2), None)
    assert lift_fields(tmp_path, [*cycles, last]) == [None, None, None]


Q = np.deg2rad([3.0, 35.0, 117.0, 0.0, 28.0, 3.0])
TOLD = robots.forward(melfa(), Q)
ENDED = {"execute": True, "state": "lifted", "reason": "the object came along"}
CYCLES = {"cycles": pd.DataFrame()}


def seen() -> OffsetMeasurement:
    measured = TOLD.copy()
    measured[0, 3] += 2e-3
    sights = (
        FlangeMeasurement(1.0, "measured", measured, np.eye(6) * 1e-8, None),
        FlangeMeasurement(1.1, "too_few_leds", None, None, None),
    )
    hand = ToolOffset(np.array([2.1e-3, 0.0, 0.0]), np.eye(3) * 1e-8, True)
    return OffsetMeasurement("the hand was off", sights, TOLD, TOLD, measured, hand)


def test_commanded_read_and_measured_positions_are_in_millimetres(tmp_path: Path) -> None:
    workspace = setup(tmp_path)
    fields = tool_offset_fields(seen(), workspace)
    commanded = np.array(fields["told_mm"])
    np.testing.assert_allclose(commanded, 1e3 * workspace.grip(Q)[:3, 3])
    np.testing.assert_allclose(fields["seen_mm"], commanded + np.array([2.0, 0.0, 0.0]))
    np.testing.assert_allclose(fields["off_mm"], [2.1, 0.0, 0.0])
    np.testing.assert_allclose(fields["off_expanded_uncertainty_mm"], [0.2, 0.2, 0.2])
    assert (fields["used"], fields["pictures"], fields["measured"]) == (True, 2, 1)
    rows = tool_offset_table(seen(), workspace)
    assert rows["status"].tolist() == ["measured", "too_few_leds"]
    np.testing.assert_allclose(rows["grip_x_mm"].iloc[0], commanded[0] + 2.0)
    assert np.isnan(rows["grip_x_mm"].iloc[1])
    assert list(tool_offset_table(None, workspace)) == list(rows)


def test_what_is_not_known_stays_empty(tmp_path: Path) -> None:
    blind = OffsetMeasurement("nothing was corrected", (), TOLD, None, None, None)
    fields = tool_offset_fields(blind, setup(tmp_path))
    for key in ("read_mm", "seen_mm", "off_mm", "off_expanded_uncertainty_mm"):
        assert fields[key] is None
    page = document(Results(ENDED | {"hand": fields}, {}, CYCLES))
    assert not any("nan" in str(block) for section in page.sections for block in section.blocks)


def test_report_and_last_line_state_the_outcome(tmp_path: Path) -> None:
    summary = ENDED | {"hand": tool_offset_fields(seen(), setup(tmp_path))}
    assert outcome(summary).sentence.startswith("The object came along, by the gripper's status")
    assert outcome(summary).sentence.endswith(". The hand was off.")
    assert "hand was" not in outcome(ENDED).sentence
    blocks = {s.name: s.blocks for s in document(Results(summary, {}, CYCLES)).sections}["hand"]
    (table,) = [block for block in blocks if isinstance(block, Table)]
    assert len(table.rows) == 5
    assert "2.10" in str(table.rows[3])
    without = {s.name: s.blocks for s in document(Results(ENDED, {}, CYCLES)).sections}["hand"]
    assert isinstance(without[0], Paragraph)
