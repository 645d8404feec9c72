"""Accepted figures of the sample sessions, stage by stage.

`make accept` writes them anew; the difference belongs in the commit that causes it.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.command import sample_results

GOLDEN = Path(__file__).parent
NAMES = ("quarter_circle_6r", "multi_joint_fault_6r", "multi_joint_rv_3sd")
EVERY = 10  # frames apart: enough to see a stage move
# What other machines' rounding and iterations may change: a fiftieth of each figure's uncertainty.
TOLERANCE = {"spots_px": 2e-4, "pose_mm_deg": 2e-4, "joints_deg": 5e-4, "summary": 5e-4}


def stages(name: str) -> dict[str, Any]:
    found = sample_results(name)
    frames = found.tables["frames"].iloc[::EVERY]
    spots = found.tables["spots"]
    spots = spots[spots["frame"] % EVERY == 0]
    pose = ["x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
    joints = [f"q{j}_measured_deg" for j in range(1, 7)]
    summary = found.summary
    return {
        "spots_px": spots[["x_px", "y_px"]].round(6).to_numpy().tolist(),
        "pose_mm_deg": frames[pose].round(6).to_numpy().tolist(),
        "joints_deg": frames[joints].round(6).to_numpy().tolist(),
        "summary": [
            [round(summary["clock"]["encoder_offset_s"], 7)],
            [round(j["mean_error_deg"], 6) for j in summary["joints"]],
            [round(j["standard_uncertainty_deg"], 6) for j in summary["joints"]],
            [round(j["minimum_detectable_error_deg"], 6) for j in summary["joints"]],
            [round(c["value"], 6) for c in summary["diagnosis"]],
        ],
    }


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("stage", TOLERANCE)
def test_a_stage_gives_the_figures_that_were_accepted(
    name: str, stage: str, request: pytest.FixtureRequest
) -> None:
    path = GOLDEN / f"{name}.json"
    now = stages(name)
    if request.config.getoption("--accept"):
        path.write_text(json.dumps(now, indent=1) + "\n")
    accepted = json.loads(path.read_text())[stage]
    assert len(now[stage]) == len(accepted)
    for row, expected in zip(now[stage], accepted, strict=True):
        assert row == pytest.approx(expected, abs=TOLERANCE[stage], nan_ok=True)
