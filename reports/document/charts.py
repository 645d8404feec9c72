"""Charts in any format: panels of lines, bands, points, cells and bars; columns ready to draw.

A chart is drawn by `reports.format.svg` on paper, by `reports.format.plotly` on the screen and by
`reports.format.matplotlib` for a user of Python. A role stands for a colour and a line style. Lines
break where pairs are missing; long ones are thinned and keep their extremes.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Box = tuple[tuple[float, float], ...]

# points a line may have; a page is some 2,000 dots wide, so more cannot be told apart
MAX_LINE_POINTS = 5_000
# stretches that a longer line is cut into; each keeps its smallest and largest value
N_BINS = 1_000
MAX_COUNT_STEPS = 8  # of an axis that counts
# times the usual step: one dropped pair (2) is bridged, two are a break in the line
MAX_GAP_RATIO = 2.5
MAX_JOINED = 1.5  # s, or rows: pairs farther apart are single visits


def column(table: pd.DataFrame, name: str) -> Array:
    """Take a column as numbers; NaN where it is missing or empty."""
    if name not in table:
        return np.full(len(table), np.nan)
    return pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=float, na_value=np.nan)


def texts(table: pd.DataFrame, name: str) -> list[str]:
    """Take a column as text; empty where it is missing."""
    if name not in table:
        return [""] * len(table)
    return ["" if pd.isna(value) else str(value) for value in table[name]]


def columns(table: pd.DataFrame, names: Iterable[str]) -> Array:
    """Take columns as numbers side by side, (rows, columns); NaN where one is missing."""
    return np.stack([column(table, name) for name in names], axis=1)


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Take a table row by row."""
    return [{str(name): value for name, value in one.items()} for one in table.to_dict("records")]


def time_axis(frames: pd.DataFrame) -> tuple[Array, str]:
    """Give the times of the pairs, from the first, and the axis' label.

    Where nobody noted times, the pairs are counted.
    """
    t = column(frames, "t_s")
    valid = t[np.isfinite(t)]
    if not len(valid):
        return np.arange(len(t), dtype=np.float64), "pose, in order"
    return t - valid[0], "since first pair [s]"


def count_ticks(numbers: Array) -> "Ticks":
    """Choose ticks for an axis that counts: a few whole numbers."""
    known = numbers[np.isfinite(numbers)]
    if not len(known):
        return ()
    least = max(float(np.ptp(known)) / MAX_COUNT_STEPS, 1.0)
    magnitude = 10.0 ** np.floor(np.log10(least))
    step = int(next(s * magnitude for s in (1, 2, 5, 10) if s * magnitude >= least))
    first, last = -(-int(known.min()) // step), int(known.max()) // step
    return tuple((float(n * step), str(n * step)) for n in range(first, last + 1))


def trace(t: Array, y: Array) -> tuple[Array, Array]:
    """Make a line that is broken by NaN where pairs are missing; extremes survive thinning."""
    kept, part = split_at_gaps(t, y)
    if len(kept) > MAX_LINE_POINTS:
        chosen = _extremes(y[kept])
        kept, part = kept[chosen], part[chosen]
    return broken(t[kept], part), broken(y[kept], part)


def band(t: Array, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Make a band's edges, broken as `trace` breaks them; thinned, it is the bins' envelope."""
    kept, part = split_at_gaps(t, low + high)
    t, low, high = t[kept], low[kept], high[kept]
    if len(kept) > MAX_LINE_POINTS:
        starts = _starts(len(kept))
        ends = np.append(starts[1:], len(kept)) - 1
        sides = np.stack([starts, ends], axis=1).ravel()
        low = np.repeat(np.minimum.reduceat(low, starts), 2)
        high = np.repeat(np.maximum.reduceat(high, starts), 2)
        t, part = t[sides], part[sides]
    return broken(t, part), broken(low, part), broken(high, part)


def broken(points: Array, part: NDArray[Any]) -> Array:
    """Break a line of points (n,) or (n, k) by NaN wherever `part` (n,) changes."""
    return np.insert(points, np.flatnonzero(part[1:] != part[:-1]) + 1, np.nan, axis=0)


def pieces(x: Array) -> list[slice]:
    """Find the unbroken pieces of a line that NaN breaks."""
    valid = np.isfinite(x)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], valid, [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def isolated_points(x: Array, y: Array) -> NDArray[np.bool_]:
    """Find points without a neighbour: a line would not show them."""
    alone = np.zeros(len(x), dtype=bool)
    alone[[piece.start for piece in pieces(x + y) if piece.stop - piece.start == 1]] = True
    return alone


def unwrap_rotation(rotation_deg: Array, start: Array | None = None) -> Array:
    """Choose, of the rotation vectors that mean the same turn, those nearest to the ones before.

    A rotation vector jumps by a whole turn where its angle passes 180°; the turn it stands for
    does not. (n, 3), degrees; with `start` given, the nearest to its rows instead.
    """
    chosen = np.array(rotation_deg, dtype=float)
    angle = np.linalg.norm(chosen, axis=1)
    near = np.full(3, np.nan)
    for i in np.flatnonzero(np.isfinite(angle)):
        goal = near if start is None or not np.isfinite(start[i]).all() else start[i]
        if angle[i] > 0 and np.isfinite(goal).all():
            axis = chosen[i] / angle[i]
            chosen[i] += 360.0 * round(float((goal - chosen[i]) @ axis) / 360.0) * axis
        near = chosen[i]
    return chosen


def runs(words: list[str], t: Array) -> list[tuple[str, int, int]]:
    """Gather equal neighbours between which no pairs are missing: word, first and last row."""
    found: list[tuple[str, int, int]] = []
    broken = [True, *(np.diff(t) > MAX_GAP_RATIO * median_step(t)).tolist()]
    for i, word in enumerate(words):
        if found and found[-1][0] == word and not broken[i]:
            found[-1] = (word, found[-1][1], i)
        else:
            found.append((word, i, i))
    return found


def median_step(t: Array) -> float:
    """Find the usual time from one pair to the next; 1 where there is none."""
    valid = t[np.isfinite(t)]
    return float(np.median(np.diff(valid))) or 1.0 if len(valid) > 1 else 1.0


def numbers(values: Any) -> list[float]:
    """Take a list of numbers; anything else in it becomes NaN."""
    if not isinstance(values, list | tuple):
        return []
    return [float(v) if isinstance(v, int | float) else float("nan") for v in values]


def square(rows: Any, size: int) -> Array:
    """Take a list of lists as a square matrix; empty where it is none."""
    lines = [numbers(row) for row in rows] if isinstance(rows, list) else []
    fits = len(lines) == size and all(len(line) == size for line in lines)
    return np.array(lines) if fits else np.empty(0)


def box(points: Array, longer: float, share: float = 0.2, least: float = 0.0) -> Box:
    """Ranges of x, y and z around points (n, 3), NaN where a line breaks: axes that can be read.

    `longer`: each range over the points' own extent, half of which counts as at least `share` of
    the longest, and as at least `least`, in the points' unit.
    """
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    half = np.maximum((high - low) / 2, max(share * float((high - low).max()), least)) * longer
    middle = (low + high) / 2
    return tuple((float(m - h), float(m + h)) for m, h in zip(middle, half, strict=True))


def split_at_gaps(t: Array, y: Array) -> tuple[Indices, Indices]:
    """Find the rows where both are known, and of each the unbroken piece that it belongs to."""
    kept = np.flatnonzero(np.isfinite(t) & np.isfinite(y))
    if not len(kept):
        return kept, kept
    # a gap shorter than this could not be drawn
    stretch = len(kept) / N_BINS if len(kept) > MAX_LINE_POINTS else 1.0
    longest = stretch * min(MAX_GAP_RATIO * median_step(t), MAX_JOINED)
    broken = (np.diff(kept) > stretch) | (np.diff(t[kept]) > longest)
    return kept, np.concatenate([[0], np.cumsum(broken)])


def _starts(n: int) -> Indices:
    return np.linspace(0, n, N_BINS, endpoint=False).astype(np.int64)


def _extremes(y: Array) -> Indices:
    starts = _starts(len(y))
    ends = np.append(starts[1:], len(y))
    both = [
        (a + int(np.argmin(y[a:b])), a + int(np.argmax(y[a:b])))
        for a, b in zip(starts.tolist(), ends.tolist(), strict=True)
    ]
    return np.unique(np.array(both, dtype=np.int64))


Ticks = tuple[tuple[float, str], ...]  # place, word

# luminance of a cell below which white letters have more contrast than black ones; from WCAG 2.2:
# (1 + 0.05) / (L + 0.05) = (L + 0.05) / 0.05
MAX_DARK_LUMINANCE = 0.179
# Role: (on light, on dark). Hues after Okabe and Ito, told apart by every common colour vision.
PALETTE = {
    "ink": ("#1c1e21", "#e6e8ea"),
    "muted": ("#5b6068", "#a6acb4"),
    "grid": ("#dfe2e6", "#363c44"),
    "paper": ("#ffffff", "#15181c"),
    "black": ("#000000", "#000000"),
    "white": ("#ffffff", "#ffffff"),
    "measured": ("#0072b2", "#56b4e9"),
    "encoder": ("#d55e00", "#ff9a4d"),
    "error": ("#0072b2", "#56b4e9"),
    "error_band": ("#0072b238", "#56b4e940"),
    "resolved": ("#d55e00", "#ff9a4d"),
    "resolved_band": ("#d55e0048", "#ff9a4d50"),
    "tolerance": ("#7a1f5c", "#e79bc9"),
    "second_limit": ("#1c1e21", "#e6e8ea"),
    "start": ("#1c1e21", "#e6e8ea"),
    "beyond": ("#8c1d40", "#ff8fab"),
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
DASHES = {
    "encoder": "dash",
    "tolerance": "dot",
    "second_limit": "dash",
}  # told apart without colour too
HOLLOW = {"start"}  # single points drawn as rings: what lies on them stays to be seen
STROKES = {"error": 1.1, "resolved": 2.0, "encoder": 1.6, "vector": 0.7}  # px on a screen
STROKE = 1.4  # px, of every other line
RED_BLUE = ((0.0, "low"), (0.5, "paper"), (1.0, "high"))
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
    name: str = ""  # of the colours' scale, where no text says what they mean


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
    x_ticks: Ticks = ()
    y_ticks: Ticks = ()
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
    ranges: Box
    from_above: bool = False  # x and y once more beside it, in a plane


def legend(chart: Chart) -> dict[str, Mark]:
    """The marks that have a name, each name once."""
    found: dict[str, Mark] = {}
    for panel in chart.panels:
        for mark in panel.marks:
            if name := getattr(mark, "name", ""):
                found.setdefault(name, mark)
    return found


def letter_roles(cells: Cells, scheme: int) -> list[list[str]]:
    """Choose black or white for the letters in each cell, on light (0) or on dark (1)."""
    behind = cell_colours(cells, scheme) / 255
    linear = np.where(behind <= 0.04045, behind / 12.92, ((behind + 0.055) / 1.055) ** 2.4)
    dark = linear @ np.array([0.2126, 0.7152, 0.0722]) < MAX_DARK_LUMINANCE  # source: WCAG 2.2
    return [["white" if is_dark else "black" for is_dark in line] for line in dark]


def cell_colours(cells: Cells, scheme: int) -> Array:
    """The colour of each cell, (rows, columns, 3), 0 to 255, on light (0) or on dark (1)."""
    shares = [share for share, _ in cells.scale]
    ends = np.array([list(bytes.fromhex(PALETTE[role][scheme][1:])) for _, role in cells.scale])
    place = np.nan_to_num(cells.values - cells.low) / max(cells.high - cells.low, 1e-12)
    return np.stack([np.interp(place, shares, channel) for channel in ends.T], axis=-1)


def strips(panels: list[Panel], x_label: str, row_height: float) -> Chart | None:
    """Stack panels that share their x axis, its label below the last; None for no panels."""
    if not panels:
        return None
    last = replace(panels[-1], x_label=x_label)
    return Chart((*panels[:-1], last), row_height=row_height, shared_x=True)


def correlation_panel(
    values: Array, rows: Ticks, columns: Ticks, text: tuple[tuple[str, ...], ...] = ()
) -> Panel:
    """Lay out a correlation matrix (n, n), the first row on top, as a matrix is read."""
    n = len(values)
    places = np.arange(n, dtype=float)
    return Panel(
        (Cells(values, places, places, RED_BLUE, -1.0, 1.0, text, "" if text else "−1 to +1"),),
        x_ticks=columns,
        y_ticks=rows,
        x_range=(-0.5, n - 0.5),
        y_range=(n - 0.5, -0.5),
        equal=True,
    )
