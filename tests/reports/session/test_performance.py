"""The section of repeated poses and paths: its words and its pictures."""

from copy import deepcopy
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports import render_pdf
from reports.document.blocks import Bullets, Paragraph, Table, collect_figures
from reports.document.charts import Chart
from reports.results import Results
from reports.session.document import document
from reports.session.performance import DEVIATIONS, REASONS, deviation, performance
from tests.support.motions import ARM
from tests.support.repeated_poses import model_of, readings_of
from tests.support.repeated_poses import repeated as played
from tests.support.reports import session as made
from verify.analysis.performance.entries import performance_summary, performance_tables
from verify.analysis.performance.session import Performance
from verify.analysis.performance.session import performance as assess

WITH_FIGURES: list[dict[str, Any]] = [
    {"kind": "cycles", "found": 12, "standard": 30},
    {"kind": "passages", "found": 6, "standard": 10},
    {"kind": "poses", "found": 3, "standard": 5},
    {"kind": "plane", "off_plane_mm": 30.4},
    {"kind": "approach", "poses": ["P1", "P2"]},
    {"kind": "drift", "found_s": 182.0},
    {"kind": "uncertainty", "poses": ["P2"], "smallest_mm": 1.93},
    {"kind": "temperature", "found_c": 25.5},
]
FOUND = WITH_FIGURES + [
    {"kind": kind} for kind in DEVIATIONS if kind not in {one["kind"] for one in WITH_FIGURES}
]


@cache
def found() -> tuple[dict[str, Any], dict[str, pd.DataFrame]]:
    """Summary and tables of a simulated run of 12 cycles through five poses."""
    run = played(12)
    readings = readings_of(run)
    model = model_of(run, np.arange(0.05, run.end, 0.2), readings)
    judged = assess(model, ARM, readings, 0.0)
    assert isinstance(judged, Performance)
    return performance_summary(judged, FOUND), performance_tables(judged)


def repeated() -> Results:
    """P1 was come to in two ways, and P2's repeatability is within the noise."""
    entry, tables = found()
    entry, base = deepcopy(entry), made.nonconforming()
    ways = {"vap_mm": 0.2, "vap_low_mm": 0.15, "vap_high_mm": 0.25, "vap_of_noise_mm": 0.04}
    entry["poses"][0]["variation"] = ways | {"ways": 2, "vap_deg": 0.012}
    entry["poses"][1]["rp_robot_mm"] = None
    summary = base.summary | {"performance": entry, "performance_reason": None}
    return replace(base, summary=summary, tables=base.tables | tables)


def test_the_answer_comes_first_and_a_share_within_the_noise_floor_is_a_bound() -> None:
    section = performance(repeated())
    first = section.blocks[0]
    assert isinstance(first, Paragraph)
    assert first.text.startswith("5 poses, each visited 12 to 13 times. ")
    assert "AP 0.3899 (0.3787 – 0.4011) mm, at P1" in first.text
    assert "RP 0.70 (0.50 – 1.22) mm, at P3" in first.text
    table = next(b for b in section.blocks if isinstance(b, Table) and "AP" in b.caption)
    assert [cells[-1].text for cells in table.rows] == ["0.59", "≤ 0.769", "0.70", "0.52", "0.60"]


def test_every_index_has_its_table_and_positions_alone_have_no_angles() -> None:
    assert sum(isinstance(b, Table) for b in performance(repeated()).blocks) == 6
    bare = repeated()
    for pose in bare.summary["performance"]["poses"]:
        for key in [key for key in pose if key.endswith("_deg")]:
            del pose[key]
    found = [b.caption for b in performance(bare).blocks if isinstance(b, Table)]
    assert "Pose accuracy and pose repeatability of orientations." not in found


def test_every_deviation_is_listed() -> None:
    bullets = next(b for b in performance(repeated()).blocks if isinstance(b, Bullets))
    assert len(bullets.items) == len(FOUND)
    assert not any("{" in text or "–" in text for text in bullets.items[: len(WITH_FIGURES)])
    drift = deviation({"kind": "drift", "found_s": 182.0})
    assert drift.startswith("Drift was followed for 0.051 h")
    assert deviation({"kind": "something_new"}) == "something new"


@pytest.mark.parametrize("reason", REASONS)
def test_without_repetition_the_reason_is_stated(reason: str) -> None:
    missing = {"performance": None, "performance_reason": reason}
    (only,) = performance(Results(made.nonconforming().summary | missing, {}, {})).blocks
    assert isinstance(only, Paragraph)
    assert only.text == REASONS[reason]


def test_clusters_and_band_are_drawn() -> None:
    drawn = collect_figures(document(repeated()))
    clusters, band = drawn["pose_clusters"], drawn["path_band"]
    assert isinstance(clusters, Chart)
    assert isinstance(band, Chart)
    assert (len(clusters.panels), clusters.columns, len(band.panels)) == (10, 5, 5)
    assert render_pdf(repeated()).startswith(b"%PDF")
