"""Paths in space: whatever shape a box has, none of its labels is cut."""

import matplotlib as mpl
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.transforms import Bbox, BboxBase

from reports.document.charts import Path
from reports.format import matplotlib
from tests.support.reports.boxes import SHAPES, boxed


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
