"""Paths in space: whatever shape a box has, none of its labels is cut."""

import itertools
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.transforms import Bbox, BboxBase

from reports.document.charts import Path
from reports.format import matplotlib

SHAPES = [s for s in itertools.product((0.1, 0.4, 1.0), repeat=3) if max(s) == 1.0]


def boxed(shape: tuple[float, ...], scale: float) -> Path:
    low = -1.3 * scale * np.ones(3)
    ranges = tuple((float(a), float(a + scale * b)) for a, b in zip(low, shape, strict=True))
    points = np.array(list(zip(*ranges, strict=True)))
    lines = ((points, "measured", "target, seen by the cameras"),)
    return Path(lines, ("x [mm]", "distance [mm]", "z [mm]"), ranges)


def labels(path: Path) -> tuple[BboxBase, Bbox]:
    """The figure, and what its axes' names and numbers fill of it; px."""
    with mpl.rc_context(fname=matplotlib.STYLE):
        figure = matplotlib._draw_path(path)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        renderer, (axes,) = canvas.get_renderer(), figure.axes  # type: ignore[no-untyped-call]
        texts = []
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):  # type: ignore[attr-defined]
            low, high = axis.get_view_interval()
            ticks = [t.label1 for t in axis.get_major_ticks() if low <= t.get_loc() <= high]
            assert len(ticks) >= 2
            texts += [axis.label, *ticks]
        return figure.bbox, Bbox.union([text.get_window_extent(renderer) for text in texts])


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_no_label_is_cut_and_the_box_fills_the_figure(shape: tuple[float, ...]) -> None:
    figure, drawn = labels(boxed(shape, 500.0))
    assert drawn.x0 >= figure.x0
    assert drawn.x1 <= figure.x1
    assert drawn.y0 >= figure.y0 - 1.0  # a label's frame is a little higher than its letters
    assert drawn.y1 <= figure.y1
    assert drawn.height > 0.55 * figure.height or drawn.width > 0.55 * figure.width


def test_the_names_of_all_axes_are_in_the_drawing() -> None:
    root = ElementTree.fromstring(matplotlib.svg(boxed((0.8, 0.8, 1.0), 500.0)))
    texts = {element.text for element in root.iter() if element.tag.endswith("text")}
    assert {"x [mm]", "distance [mm]", "z [mm]"} <= texts
