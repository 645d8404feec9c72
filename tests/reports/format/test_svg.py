"""Figures on paper: every word is in the drawing and none is cut, whatever the data."""

import io
import re
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
import typst
from matplotlib.image import imread

from reports.document import charts
from reports.document.charts import Array, Chart, Line, Panel, Path
from reports.format import pdf, svg
from reports.format.lettering import text_width
from reports.format.scales import extent, numbered
from tests.support.reports.boxes import SHAPES, boxed

PPI = 144.0  # dots of the drawn page an inch


def inked(drawing: bytes) -> Array:
    """Where a drawing has ink, (rows, columns); 20 dots around it show what it would cut off."""
    root = ElementTree.fromstring(drawing)
    width, height = (float(v) for v in root.attrib["viewBox"].split()[2:])
    root.attrib |= {"width": f"{width + 20}pt", "height": f"{height + 20}pt",
                    "viewBox": f"-10 -10 {width + 20} {height + 20}"}  # fmt: skip
    files = {
        "main.typ": b'#set page(width: auto, height: auto, margin: 0pt)\n#image("a.svg")',
        "a.svg": ElementTree.tostring(root),
    }
    shown = imread(io.BytesIO(typst.compile(files, format="png", ppi=PPI, **pdf.FONTS)), "png")
    return np.asarray(shown[:, :, :3].min(axis=2) < 0.9)


def words(drawing: bytes) -> list[str]:
    root = ElementTree.fromstring(drawing)
    return [element.text or "" for element in root.iter() if element.tag.endswith("text")]


def sine(**more: object) -> Panel:
    x = np.linspace(0.0, 10.0, 50)
    return Panel((Line(x, np.sin(x), "measured", "a line"),), "y [mm]", "x [s]", **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_no_label_of_a_path_leaves_the_drawing_and_the_box_fills_it(
    shape: tuple[float, ...],
) -> None:
    path = boxed(shape, 500.0)
    drawing = svg.svg(path)
    ink = inked(drawing)
    assert not ink[:18].any()
    assert not ink[-18:].any()
    assert not ink[:, :18].any()
    assert not ink[:, -18:].any()
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink[60:].any(axis=0))
    high, wide = ink.shape
    assert np.ptp(rows) > 0.55 * high or np.ptp(columns) > 0.55 * wide
    assert {"x [mm]", "distance [mm]", "z [mm]"} <= set(words(drawing))


@pytest.mark.parametrize("scale", [1e-7, 0.003, 1.0, 250.0, 4e6])
@pytest.mark.parametrize("columns", [1, 3])
def test_numbers_of_any_size_stay_within_the_drawing_and_do_not_touch(
    scale: float, columns: int
) -> None:
    x = scale * np.linspace(-1.0, 1.0, 30)
    panel = Panel((Line(x, 3 * x + scale, "measured"),), "y [mm]", "x [mm]", "a title")
    chart = Chart((panel,) * columns, columns=columns)
    drawing = svg.svg(chart)
    ink = inked(drawing)
    assert not ink[:, :18].any()
    assert not ink[:, -18:].any()
    assert not ink[-18:].any()
    places = [
        (float(y), float(x) - text_width(word, 6.5) / 2, float(x) + text_width(word, 6.5) / 2)
        for x, y, word in re.findall(
            r'<text x="([^"]+)" y="([^"]+)" font-size="6.5" text-anchor="middle"[^>]*>([^<]+)<',
            drawing.decode(),
        )
    ]
    places.sort()
    assert len(places) >= 2 * columns
    for (y, _, right), (below, left, _) in pairwise(places):
        assert y != below or left > right


def test_panels_of_one_figure_have_one_size() -> None:
    drawing = svg.svg(Chart((sine(), sine(title="two"), sine(), sine()), columns=2)).decode()
    sizes = re.findall(r'<rect x="[^"]+" y="[^"]+" (width="[^"]+" height="[^"]+")/></clip', drawing)
    assert len(sizes) == 4
    assert len(set(sizes)) == 1


def test_only_the_last_of_panels_with_one_axis_has_its_numbers() -> None:
    chart = charts.strips([sine(), sine()], "time [s]", 1.0)
    assert chart is not None
    assert words(svg.svg(chart)).count("10") == 1


@pytest.mark.parametrize("columns", [1, 2])
def test_the_name_of_y_stays_beside_a_square_panel(columns: int) -> None:
    panel = sine(equal=True, x_range=(0.0, 1.0), y_range=(0.0, 1.0))
    drawing = svg.svg(Chart((panel,) * columns, columns=columns, row_height=2.6))
    ink = inked(drawing)
    assert not ink[:, :18].any()
    assert not ink[:, -18:].any()
    name = next(
        float(x) for x in re.findall(r"translate\(([\d.-]+) [\d.]+\) rotate", drawing.decode())
    )
    frame = min(float(x) for x in re.findall(r'<rect x="([\d.]+)"', drawing.decode()))
    assert 0 < frame - name < 40


def test_where_one_unit_is_as_long_on_x_as_on_y_a_square_is_square() -> None:
    square = Line(np.array([0.0, 1, 1, 0]), np.array([0.0, 0, 1, 1]), "measured")
    drawing = svg.svg(Chart((Panel((square,), equal=True),))).decode()
    places = re.search(r'<path d="M([^"]+)" fill="none" stroke="#0072b2"', drawing)
    assert places is not None
    corners = np.array([[float(v) for v in pair.split(",")] for pair in places[1].split(" ")])
    assert np.ptp(corners[:, 0]) == pytest.approx(np.ptp(corners[:, 1]), abs=0.02)


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ((0.0, 10.0), ["0", "2", "4", "6", "8", "10"]),
        ((-0.013, 0.012), ["−0.010", "−0.005", "0.000", "0.005", "0.010"]),
        ((10.0, 0.0), ["0", "2", "4", "6", "8", "10"]),  # upside down
        ((0.0, 3e6), ["0", "1", "2", "3"]),
    ],
)
def test_numbers_of_an_axis_are_round_and_have_the_digits_of_their_steps(
    ends: tuple[float, float], expected: list[str]
) -> None:
    assert [word for _, word in numbered(ends, 5).ticks] == expected
    assert numbered((0.0, 3e6), 5).power == "×10⁶"


def test_bars_stand_on_their_axis_and_lines_have_a_margin() -> None:
    bars = charts.Bars(np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.zeros(2), "used", "bars")
    low, high = extent([Panel((bars,))], 1)
    assert (low, high) == (0.0, pytest.approx(4.2))
    low, high = extent([sine()], 0)
    assert (low, high) == (pytest.approx(-0.5), pytest.approx(10.5))


def test_many_cells_lie_as_few_do() -> None:
    """A picture of cells and rectangles show the same, also with the first row on top."""
    values = np.random.default_rng(1).random((10, 12))
    shown = []
    for limit in (50, 1000):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("reports.format.marks.MAX_VECTOR_CELLS", limit)
            cells = charts.Cells(
                values, np.arange(12.0), np.arange(10.0), ((0.0, "white"), (1.0, "black")), 0.0, 1.0
            )
            panel = Panel((cells,), x_range=(-0.5, 11.5), y_range=(9.5, -0.5))
            shown.append(inked(svg.svg(Chart((panel,), row_height=2.0))))
    assert np.mean(shown[0] != shown[1]) < 0.02
    assert shown[0].mean() > 0.3


def test_a_user_s_words_are_letters_and_no_markup() -> None:
    line = Line(np.arange(3.0), np.arange(3.0), "measured", 'LED <b>&"1"')
    drawing = svg.svg(Chart((Panel((line,), x_ticks=((1.0, "<i>"),)),)))
    assert {'LED <b>&"1"', "<i>"} <= set(words(drawing))


def test_a_figure_without_data_is_drawn() -> None:
    assert inked(svg.svg(Chart((Panel((), "y [mm]", title="no measured pair"),)))).any()
    assert isinstance(svg.svg(boxed((1.0, 1.0, 1.0), 1.0)), bytes)
    still = Panel((), y_range=(2.0, 2.0), x_range=(0.0, 0.0))
    assert inked(svg.svg(Chart((still,)))).any()
    point = Path((), ("x [mm]", "y [mm]", "z [mm]"), ((3.0, 3.0),) * 3)
    assert inked(svg.svg(point)).any()
    nothing = Path((), ("x [mm]", "y [mm]", "z [mm]"), ((0.0, 1.0),) * 3, from_above=True)
    assert inked(svg.svg(nothing)).any()


def test_shades_without_words_say_in_the_legend_what_they_stand_for() -> None:
    ticks = ((0.0, "a"), (1.0, "b"))
    values = np.array([[1.0, -0.4], [-0.4, 1.0]])
    drawing = svg.svg(Chart((charts.correlation_panel(values, ticks, ticks),)))
    assert "−1 to +1" in words(drawing)
    fills = re.findall(r'height="4.60" fill="(#[0-9a-f]+)"', drawing.decode())
    assert len(set(fills)) > 9  # a scale, from one end to the other
    written = charts.correlation_panel(values, ticks, ticks, (("1.00", "−0.40"),) * 2)
    assert "−1 to +1" not in words(svg.svg(Chart((written,))))
