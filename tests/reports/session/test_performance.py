"""The section of repeated poses and paths: its words and its pictures."""

from dataclasses import replace
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
from tests.support.reports import session as made

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


def interval(
    name: str, value: float, low: float, high: float, unit: str = "mm"
) -> dict[str, float]:
    """An index and the ends of its interval, under their keys."""
    ends = zip(("", "_low", "_high"), (value, low, high), strict=True)
    return {f"{name}{end}_{unit}": number for end, number in ends}


def pose(name: str, *, robot: float | None, oriented: bool = True) -> dict[str, Any]:
    entry: dict[str, Any] = {"pose": name, "visits": 12, "pairs": 72}
    entry |= interval("ap", 0.371, 0.36, 0.382) | interval("rp", 0.44, 0.35, 0.7)
    entry |= {"ap_of_noise_mm": 0.008, "ap_less_bias_mm": 0.3709, "rp_floor_mm": 0.064}
    entry |= {"rp_robot_mm": robot, "rp_robot_at_most_mm": 0.697}
    ways = interval("vap", 0.2, 0.15, 0.25)
    entry["variation"] = {"ways": 2, "vap_of_noise_mm": 0.04, "vap_deg": 0.012} | ways
    changes = {"dap_mm": 0.08, "dap_of_noise_mm": 0.15, "drp_mm": 0.04, "drp_of_noise_mm": 0.17}
    entry["drift"] = {"blocks": 2, "duration_s": 180.0} | changes
    for axis in ("rx", "ry", "rz") if oriented else ():
        entry |= interval(f"ap_{axis}", -0.002, -0.006, 0.002, "deg")
        entry |= interval(f"rp_{axis}", 0.08, 0.06, 0.13, "deg")
    return entry


def path(name: str) -> dict[str, Any]:
    entry: dict[str, Any] = {"path": name, "passages": 6, "length_mm": 193.0, "speed_mm_s": 176.4}
    entry |= interval("at", 0.398, 0.354, 0.443) | interval("rt", 0.44, 0.31, 0.8)
    entry |= {"at_largest_of_noise_mm": 0.045, "rt_floor_mm": 0.1}
    return entry | {"rt_robot_mm": 0.4, "rt_robot_at_most_mm": 0.79}


def repeated() -> Results:
    rng = np.random.default_rng(1)
    places = {f"d{axis}_mm": rng.normal(0.2, 0.1, 24) for axis in "xyz"}
    visits = pd.DataFrame({"pose": np.repeat(["P1", "P2"], 12), **places})
    along, off = np.linspace(0, 193, 50), 0.35 + 0.05 * np.sin(np.linspace(0, 3, 50))
    stations = pd.DataFrame(
        {"path": ["P1 → P2"] * 50, "along_mm": along, "off_mm": off, "rt_mm": np.full(50, 0.4)}
    )
    distance: dict[str, Any] = {"poses": ["P1", "P2"], "commanded_mm": 199.4, "visits": 12}
    distance |= interval("ad", -0.0039, -0.018, 0.01) | interval("rd", 0.88, 0.62, 1.49)
    entry = {
        "noise_floor": {"source": "holds"},
        "poses": [pose("P1", robot=0.43), pose("P2", robot=None)],
        "distances": [distance],
        "paths": [path("P1 → P2")],
        "deviations": FOUND,
    }
    base = made.nonconforming()
    return replace(
        base,
        summary=base.summary | {"performance": entry, "performance_reason": None},
        tables=base.tables | {"performance_poses": visits, "performance_paths": stations},
    )


def test_the_answer_comes_first_and_a_share_within_the_noise_floor_is_a_bound() -> None:
    section = performance(repeated())
    first = section.blocks[0]
    assert isinstance(first, Paragraph)
    assert first.text.startswith("2 poses, each visited 12 times. ")
    assert "AP 0.3710 (0.3600 – 0.3820) mm, at P1" in first.text
    assert "RP 0.440 (0.350 – 0.700) mm" in first.text
    table = next(b for b in section.blocks if isinstance(b, Table) and "AP" in b.caption)
    assert [cells[-1].text for cells in table.rows] == ["0.430", "≤ 0.697"]


def test_every_index_has_its_table_and_positions_alone_have_no_angles() -> None:
    assert sum(isinstance(b, Table) for b in performance(repeated()).blocks) == 6
    bare = repeated()
    bare.summary["performance"]["poses"] = [pose("P1", robot=0.4, oriented=False)]
    found = [b.caption for b in performance(bare).blocks if isinstance(b, Table)]
    assert "Pose accuracy and pose repeatability of orientations." not in found


def test_every_deviation_is_listed() -> None:
    bullets = next(b for b in performance(repeated()).blocks if isinstance(b, Bullets))
    assert len(bullets.items) == len(FOUND)
    assert not any("{" in text or "–" in text for text in bullets.items[: len(WITH_FIGURES)])
    assert deviation({"kind": "drift", "found_s": 182.0}).startswith(
        "Drift was followed for 0.051 h"
    )
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
    assert (len(clusters.panels), clusters.columns, len(band.panels)) == (4, 2, 1)
    assert render_pdf(repeated()).startswith(b"%PDF")
