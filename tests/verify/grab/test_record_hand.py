"""What was seen of the hand is kept, told in the report, and said in the line at the end."""

from pathlib import Path

import numpy as np
import pandas as pd

import robots
from reports.blocks import Paragraph, Table
from reports.grab import document, outcome
from reports.results import Results
from tests.verify.grab.planned_cell import melfa, setup
from verify.grab.hand_off import HandOff, HandSeen, LedSight
from verify.grab.record_rows import hand_fields, hand_table

Q = np.deg2rad([3.0, 35.0, 117.0, 0.0, 28.0, 3.0])
TOLD = robots.forward(melfa(), Q)
ENDED = {"execute": True, "state": "lifted", "reason": "the object came along"}
CYCLES = {"cycles": pd.DataFrame()}


def seen() -> HandSeen:
    measured = TOLD.copy()
    measured[0, 3] += 2e-3
    sights = (
        LedSight(1.0, "measured", measured, np.eye(6) * 1e-8, None),
        LedSight(1.1, "too_few_leds", None, None, None),
    )
    hand = HandOff(np.array([2.1e-3, 0.0, 0.0]), np.eye(3) * 1e-8, True)
    return HandSeen("the hand was off", sights, TOLD, TOLD, measured, hand)


def test_told_read_and_seen_places_are_kept_in_millimetres(tmp_path: Path) -> None:
    workspace = setup(tmp_path).workspace
    fields = hand_fields(seen(), workspace)
    told = np.array(fields["told_mm"])
    np.testing.assert_allclose(told, 1e3 * workspace.grip(Q)[:3, 3])
    np.testing.assert_allclose(fields["seen_mm"], told + np.array([2.0, 0.0, 0.0]))
    np.testing.assert_allclose(fields["off_mm"], [2.1, 0.0, 0.0])
    np.testing.assert_allclose(fields["off_expanded_uncertainty_mm"], [0.2, 0.2, 0.2])
    assert (fields["used"], fields["pictures"], fields["measured"]) == (True, 2, 1)
    rows = hand_table(seen(), workspace)
    assert rows["status"].tolist() == ["measured", "too_few_leds"]
    np.testing.assert_allclose(rows["grip_x_mm"].iloc[0], told[0] + 2.0)
    assert np.isnan(rows["grip_x_mm"].iloc[1])
    assert list(hand_table(None, workspace)) == list(rows)


def test_what_is_not_known_stays_empty(tmp_path: Path) -> None:
    blind = HandSeen("nothing was corrected", (), TOLD, None, None, None)
    fields = hand_fields(blind, setup(tmp_path).workspace)
    for key in ("read_mm", "seen_mm", "off_mm", "off_expanded_uncertainty_mm"):
        assert fields[key] is None
    told = document(Results(ENDED | {"hand": fields}, {}, CYCLES))
    assert not any("nan" in str(block) for section in told.sections for block in section.blocks)


def test_the_report_and_the_last_line_say_what_came_of_it(tmp_path: Path) -> None:
    summary = ENDED | {"hand": hand_fields(seen(), setup(tmp_path).workspace)}
    assert outcome(summary).sentence.startswith("The object came along, by the gripper's status")
    assert outcome(summary).sentence.endswith(". The hand was off.")
    assert "hand was" not in outcome(ENDED).sentence
    blocks = {s.name: s.blocks for s in document(Results(summary, {}, CYCLES)).sections}["hand"]
    (table,) = [block for block in blocks if isinstance(block, Table)]
    assert len(table.rows) == 5
    assert "2.10" in str(table.rows[3])
    without = {s.name: s.blocks for s in document(Results(ENDED, {}, CYCLES)).sections}["hand"]
    assert isinstance(without[0], Paragraph)
