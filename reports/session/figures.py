"""Every figure of the report by its name: results in, chart out, None for nothing to draw."""

from collections.abc import Callable

from reports.document.charts import Chart, Path
from reports.results import Results
from reports.session.evidence_figures import (
    budget,
    clock,
    correlation,
    reprojection,
    residuals,
    timeline,
)
from reports.session.motion_figures import flange_path, joint_errors, pose, pose_errors

FIGURES: dict[str, Callable[[Results], Chart | Path | None]] = {
    "correlation": correlation,
    "joint_errors": joint_errors,
    "pose": pose,
    "pose_errors": pose_errors,
    "path": flange_path,
    "residuals": residuals,
    "reprojection": reprojection,
    "clock": clock,
    "timeline": timeline,
    "budget": budget,
}
