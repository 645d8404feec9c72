"""What is drawn, whatever draws it: panels of lines, bands, points, cells and bars.

`figures.py` turns tables into charts; `drawing.py` draws them with matplotlib for paper,
`plotting.py` with plotly for the screen. A role stands for a colour and a line style.
"""

from dataclasses import dataclass, field

from reports.series import Array

# Role: (on light, on dark). Hues after Okabe and Ito, told apart by every common colour vision.
PALETTE = {
    "ink": ("#1c1e21", "#e6e8ea"),
    "muted": ("#5b6068", "#a6acb4"),
    "grid": ("#dfe2e6", "#363c44"),
    "paper": ("#ffffff", "#15181c"),
    "measured": ("#0072b2", "#56b4e9"),
    "encoder": ("#d55e00", "#ff9a4d"),
    "error": ("#0072b2", "#56b4e9"),
    "error_band": ("#0072b238", "#56b4e940"),
    "resolved": ("#d55e00", "#ff9a4d"),
    "resolved_band": ("#d55e0048", "#ff9a4d50"),
    "tolerance": ("#7a1f5c", "#e79bc9"),
    "used": ("#0072b2", "#56b4e9"),
    "unused": ("#d55e00", "#ff9a4d"),
    "vector": ("#5b606866", "#a6acb466"),
    "low": ("#0072b2", "#56b4e9"),
    "high": ("#d55e00", "#ff9a4d"),
    "series_1": ("#0072b2", "#56b4e9"),
    "series_2": ("#e69f00", "#f2b134"),
    "series_3": ("#009e73", "#2cc79a"),
    "series_4": ("#cc79a7", "#e29ac3"),
    "series_5": ("#56b4e9", "#a9d9f5"),
    "series_6": ("#d55e00", "#ff9a4d"),
    "series_7": ("#8c6d31", "#c9a86a"),
    "series_8": ("#999999", "#8a8f96"),
}
DASHES = {"encoder": "dash", "tolerance": "dot"}  # told apart without colour too
SERIES = [name for name in PALETTE if name.startswith("series_")]


@dataclass(frozen=True)
class Line:
    """A line, broken where NaN stands; points without a neighbour are drawn as dots."""

    x: Array
    y: Array
    role: str
    name: str = ""


@dataclass(frozen=True)
class Band:
    """The space between two lines; without a neighbour, an upright bar."""

    x: Array
    low: Array
    high: Array
    role: str
    name: str = ""


@dataclass(frozen=True)
class Level:
    """A line right across at one value of y, or upright at one of x."""

    value: float
    role: str
    name: str = ""
    upright: bool = False


@dataclass(frozen=True)
class Points:
    """Separate points; a few are drawn larger than thousands."""

    x: Array
    y: Array
    role: str
    name: str = ""
    size: float = 1.0


@dataclass(frozen=True)
class Runs:
    """Stretches of time on one row of a timeline."""

    starts: Array
    ends: Array
    row: int
    role: str


@dataclass(frozen=True)
class Cells:
    """A matrix of coloured cells; `text` is written into them where given."""

    values: Array  # (rows, columns)
    x: Array  # (columns,), centres
    y: Array  # (rows,), centres
    scale: tuple[tuple[float, str], ...]  # share of the way from low to high, role
    low: float
    high: float
    text: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class Bars:
    """One layer of stacked upright bars: heights at x, on top of `below`."""

    x: Array
    heights: Array
    below: Array
    role: str
    name: str
    width: float = 0.62


@dataclass(frozen=True)
class Note:
    """A few letters at a place."""

    x: float
    y: float
    text: str


Mark = Line | Band | Level | Points | Runs | Cells | Bars | Note


@dataclass(frozen=True)
class Panel:
    """One pair of axes. A range that is not given follows the data."""

    marks: tuple[Mark, ...]
    y_label: str = ""
    x_label: str = ""
    title: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    x_ticks: tuple[tuple[float, str], ...] = ()
    y_ticks: tuple[tuple[float, str], ...] = ()
    equal: bool = False  # one unit as long on x as on y
    unit: str = ""  # of y, for what a pointer reads off


@dataclass(frozen=True)
class Chart:
    """A figure: panels in reading order, `columns` wide."""

    panels: tuple[Panel, ...]
    columns: int = 1
    row_height: float = 1.2  # inches on paper; the screen scales it
    shared_x: bool = False
    width: float = 1.0  # share of the line width


@dataclass(frozen=True)
class Path:
    """Lines in space: (n, 3) each, with role and name; `ranges` are those of x, y, z."""

    lines: tuple[tuple[Array, str, str], ...]
    labels: tuple[str, str, str]
    ranges: tuple[tuple[float, float], ...] = field(default=())
