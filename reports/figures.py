"""Every figure of the report by its name: results in, chart out, None for nothing to draw."""

from collections.abc import Callable

from reports.charts import Chart, Path
from reports.evidence_figures import budget, clock, correlation, reprojection, residuals, timeline
from reports.motion_figures import joint_errors, path, pose, pose_errors
from reports.results import Results

FIGURES: dict[str, Callable[[Results], Chart | Path | None]] = {
    "correlation": correlation,
    "joint_errors": joint_errors,
    "pose": pose,
    "pose_errors": pose_errors,
    "path": path,
    "residuals": residuals,
    "reprojection": reprojection,
    "clock": clock,
    "timeline": timeline,
    "budget": budget,
}
