"""Figures of every kind of report: drawn where there is data, with units, always the same."""

import base64
import re

import numpy as np
import plotly.graph_objects as go
import pytest

from reports.document.blocks import collect_figures
from reports.document.charts import Chart, Level, Panel, Points
from reports.format import plotly, svg
from tests.support.reports.page import coloured, document_of, drawing_of

CALIBRATION = {
    "views", "vectors", "coverage", "stances", "scene", "accuracy", "contributions",
    "parameter_correlation",
}  # fmt: skip
FIGURES: dict[str, set[str]] = {
    **{name: set() for name in ("nothing", "uncalibrated", "bare", "unchecked")},
    "nonconforming": {
        "correlation", "joint_errors", "pose", "pose_errors", "path", "residuals", "reprojection",
        "clock", "timeline", "budget", "pair", "relative", "overview",
    },
    "good": CALIBRATION | {"rectified"},
    "doubtful": CALIBRATION,
    "motion": {"visible", "over_time", "vectors", "linearity"},
    "not_held": {"lengths", "figures", "over_pairs"},
}  # fmt: skip
DRAWN = [
    (name, figure)
    for name, figures in FIGURES.items()
    for figure in sorted(figures - {"pair", "rectified"})  # pictures
]


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_there_and_none_without_data(name: str) -> None:
    assert set(collect_figures(document_of(name))) == FIGURES[name]


@pytest.mark.parametrize(("name", "figure"), DRAWN)
def test_a_figure_is_accepted_by_plotly_drawn_alike_and_has_units(name: str, figure: str) -> None:
    chart = drawing_of(name, figure)
    plot = coloured(plotly.specification(chart))
    go.Figure(plot["data"], plot["layout"])
    go.Figure(plot["data"], plot["narrow"])
    assert svg.svg(chart) == svg.svg(chart)
    for panel in chart.panels if isinstance(chart, Chart) else ():
        for label in (panel.x_label, panel.y_label):
            counted = label in ("", "pair", "were they exact", "LEDs seen", "misfit",
                                "LEDs at its ends", "figure over its u",
                                "source left out")  # fmt: skip
            assert counted or re.search(r"\[(s|°|mm|mm/m|px|%)\]$", label), label


@pytest.mark.parametrize(("x_range", "ends"), [((-0.5, 5.5), [-0.5, 5.5]), (None, [0.0, 5.0])])
def test_a_level_is_as_long_as_its_panel_or_what_is_drawn_there(
    x_range: tuple[float, float] | None, ends: list[float]
) -> None:
    marks = Level(0.0, "muted"), Points(np.arange(6.0), np.ones(6), "error")
    level = plotly.specification(Chart((Panel(marks, "error [°]", x_range=x_range),)))["data"][0]
    assert np.frombuffer(base64.b64decode(level["x"]["bdata"])).tolist() == ends
