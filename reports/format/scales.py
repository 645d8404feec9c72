"""Axes on paper: what range the marks of a panel fill, and where its numbers stand."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from reports.document import charts
from reports.document.charts import Array, Mark, Panel, Ticks

MARGIN = 0.05  # of the data's extent, left free on both sides
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # from one number to the next, times a power of ten
MIN_POWER, MAX_POWER = -4, 5  # of ten: numbers up to here, and from here, show it apart
HALF_RUN = 0.3  # of a row of a timeline: half a run's height
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Scale:
    """One axis: its ends, its ticks, and a power of ten that all numbers are times."""

    ends: tuple[float, float]
    ticks: Ticks
    power: str = ""

    def place(self, value: float | Array, start: float, end: float) -> Array:
        """Where values lie on paper, if the axis reaches from `start` to `end`; pt."""
        low, high = self.ends
        return np.asarray(start + (np.asarray(value) - low) / (high - low) * (end - start))

    def visible(self) -> list[tuple[float, str]]:
        """The ticks between the ends, with their words."""
        low, high = sorted(self.ends)
        near = 1e-9 * (high - low)
        return [(at, word) for at, word in self.ticks if low - near <= at <= high + near]


def scale(ends: tuple[float, float], most: int, words: Ticks) -> Scale:
    """Make an axis with the given words, or with numbers at `most` steps at most."""
    return Scale(widened(ends), words) if words else numbered(widened(ends), most)


def widened(ends: tuple[float, float]) -> tuple[float, float]:
    """Give a range that is one value only a margin on both sides."""
    low, high = ends
    if abs(high - low) > 1e-12 * max(abs(low), abs(high)):
        return ends
    half = MARGIN * abs(low) or MARGIN
    return low - half, high + half


def numbered(ends: tuple[float, float], most: int) -> Scale:
    """Make an axis with round numbers."""
    low, high = sorted(ends)
    least = (high - low) / max(most, 1)
    magnitude = 10.0 ** math.floor(math.log10(least))
    step = next(s * magnitude for s in STEPS if s * magnitude >= least * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    places = [n * step for n in range(first, last + 1)]
    largest = max((abs(place) for place in places), default=0.0)
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    power = 0 if MIN_POWER < power < MAX_POWER else power
    unit = 10.0**power
    digits = next(d for d in range(20) if abs(round(step / unit, d) * unit - step) < 1e-6 * step)
    words = [f"{place / unit:.{digits}f}".replace("-", "\N{MINUS SIGN}") for place in places]
    shown = f"×10{str(power).translate(SUPERSCRIPTS)}" if power else ""
    return Scale(ends, tuple(zip(places, words, strict=True)), shown)


def extent(panels: Iterable[Panel], along: int) -> tuple[float, float]:
    """Find the range that all marks of some panels fill along x (0) or y (1), with its margins."""
    loose, firm = coverage(panels, along)
    values = np.concatenate([loose, firm])
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if widened((low, high)) != (low, high):
        return widened((low, high))
    fixed = set(firm.tolist())  # bars stand on their axis
    margin = MARGIN * (high - low)
    return low - margin * (low not in fixed), high + margin * (high not in fixed)


def coverage(panels: Iterable[Panel], along: int) -> tuple[Array, Array]:
    """List what marks cover along x (0) or y (1): values with margins (n,), edges without (m,)."""
    covered = [_reach(mark, along) for panel in panels for mark in panel.marks]
    loose, firm = (
        np.concatenate(
            [np.empty(0), *(np.ravel(a).astype(float) for one in covered for a in one[i])]
        )
        for i in range(2)
    )
    return loose[np.isfinite(loose)], firm[np.isfinite(firm)]


def edges(centres: Array) -> Array:
    """Find the edges of cells from their centres."""
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.array([2 * centres[0] - middle[0], *middle, 2 * centres[-1] - middle[-1]])


def _reach(mark: Mark, along: int) -> tuple[list[Array], list[Array]]:
    """What a mark covers on one axis: values that want a margin, and edges that want none."""
    if isinstance(mark, charts.Line | charts.Points):
        known = np.isfinite(mark.x) & np.isfinite(mark.y)
        return [(mark.x, mark.y)[along][known]], []
    if isinstance(mark, charts.Band):
        return [mark.x] if along == 0 else [mark.low, mark.high], []
    if isinstance(mark, charts.Level):
        return [np.array([mark.value])] if mark.upright == (along == 0) else [], []
    if isinstance(mark, charts.Runs):
        row = np.array([mark.row - HALF_RUN, mark.row + HALF_RUN])
        return [row] if along else [mark.starts, mark.ends], []
    if isinstance(mark, charts.Cells):
        return [], [edges((mark.x, mark.y)[along])]
    if isinstance(mark, charts.Bars):
        half = mark.width / 2
        return ([mark.below + mark.heights], [mark.below]) if along else (
            [mark.x - half, mark.x + half], [])  # fmt: skip
    return [], []
