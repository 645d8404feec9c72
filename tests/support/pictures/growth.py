"""How the cost of a measurement grows, drawn from the figures that `make bench` keeps."""

import io
import json
from itertools import groupby
from pathlib import Path

from matplotlib.figure import Figure as Drawing

from tests.bench import store
from tests.bench.goals import Figure

WIDTH_IN, HEIGHT_IN, PIXELS_PER_INCH = 8.0, 5.4, 110
COLOURS = ("#0072b2", "#d55e00")


def growth(path: Path = store.FILE) -> bytes:
    """Draw a panel for each thing that grows, a line for each cost; PNG."""
    points = store.figures(json.loads(path.read_text()), "growth")
    drawing = Drawing(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    panels = [list(own) for _, own in groupby(points, key=lambda point: point.along)]
    grid = drawing.subplots(2, 2).ravel()
    for axes in grid[len(panels) :]:  # not measured
        axes.set_visible(False)
    for axes, own in zip(grid, panels, strict=False):
        for name, colour in zip(dict.fromkeys(point.name for point in own), COLOURS, strict=False):
            line: list[Figure] = [point for point in own if point.name == name]
            axes.plot([p.at for p in line], [p.value for p in line], "o-", color=colour, label=name,
                      clip_on=False)  # fmt: skip
        top = 1.15 * max(point.value for point in own)
        axes.set(xlabel=own[0].along, ylabel=own[0].unit, ylim=(0.0, top), xlim=(0.0, None))
        axes.legend(frameon=False, fontsize=8, loc="best")
        axes.grid(color="#dfe2e6", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        if len({point.at for point in own}) < 4:
            axes.set_xticks(sorted({point.at for point in own}))
    buffer = io.BytesIO()
    drawing.savefig(buffer, format="png", dpi=PIXELS_PER_INCH)
    return buffer.getvalue()
