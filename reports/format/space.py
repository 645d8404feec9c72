"""Paths in space on paper: a box seen from one side, in parallel projection.

A point p (mm along x, y, z) lies at (r · p, -u · p) on paper, with r = (-sin a, cos a, 0) to the
right and u = (-sin e cos a, -sin e sin a, cos e) upwards, at azimuth a and elevation e. The box is
as large as its names and numbers, which have one size, leave room for.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from reports.document.charts import (
    HOLLOW,
    Array,
    Line,
    Panel,
    Path,
    Points,
    isolated_points,
    pieces,
)
from reports.format import svg
from reports.format.drawing import Drawing, dash_of
from reports.format.lettering import printable, text_height, text_width
from reports.format.marks import DOT, Frame
from reports.format.scales import Scale, numbered, widened

ELEVATION, AZIMUTH = np.deg2rad((24.0, -58.0))  # from which a path is seen
TO_PAPER = np.array([
    [-np.sin(AZIMUTH), np.sin(ELEVATION) * np.cos(AZIMUTH)],
    [np.cos(AZIMUTH), np.sin(ELEVATION) * np.sin(AZIMUTH)],
    [0.0, -np.cos(ELEVATION)],
])  # (3, 2), y of the paper points down  # fmt: skip
MAX_AXIS_STEPS = 5  # between the numbers of the longest axis
SIDE, FROM_ABOVE = 0.6, 0.66  # of the width: the box, beside a plane; where the plane's room begins
COURSE_WIDTH, SINGLE, RING = 1.2, 2.2, 3.6  # pt: of a line; radii of a single point, of a ring
MAX_NAME_LETTERS = 60  # of a line, in the legend
# the edge of the box that carries each axis' numbers: its ends as shares of the ranges
NUMBERED = {0: (None, 0.0, 0.0), 1: (1.0, None, 0.0), 2: (1.0, 1.0, None)}
WALLS = ((0, 0.0), (1, 1.0), (2, 0.0))  # axis that a wall is upright to, and where: behind the path


@dataclass(frozen=True)
class _Word:
    """A word beside an edge, at an offset (2,) in pt from a place (3,) in the box."""

    place: Array
    offset: Array
    text: str
    size: float
    turn: float = 0.0  # degrees

    def corners(self, anchor: Array) -> Array:
        """The rectangle that it fills on paper, (4, 2)."""
        half = text_width(self.text, self.size) / 2, text_height(self.text, self.size) / 2
        turn = np.deg2rad(self.turn)
        turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        signs = np.array(list(product((-1, 1), repeat=2)))
        return np.asarray(anchor + self.offset + (signs * half) @ turned)


def draw_path(drawing: Drawing, path: Path) -> None:
    """Draw lines in space, their legend, and, where wanted, x and y once more beside it."""
    signs = [
        (Points if len(points) == 1 else Line)(points[:, 0], points[:, 1], role)
        for points, role, _ in path.lines
    ]
    names = [printable(name, MAX_NAME_LETTERS) for _, _, name in path.lines]
    top = svg.draw_legend(drawing, [both for both in zip(names, signs, strict=True) if both[0]])
    right = SIDE * drawing.width if path.from_above else drawing.width
    _draw_box(drawing, path, np.array([[svg.EDGE, top], [right, drawing.height - svg.EDGE]]))
    if path.from_above:
        _draw_plane(drawing, path, np.array([FROM_ABOVE * drawing.width, top]))


def _draw_plane(drawing: Drawing, path: Path, corner: Array) -> None:
    """Draw x and y of the path, from the corner (2,) at the top left to the drawing's other end."""
    wide = drawing.width - corner[0]
    panel = Panel(
        (), path.labels[1], path.labels[0],
        x_range=path.ranges[0], y_range=path.ranges[1], equal=True,
    )  # fmt: skip
    scales = svg.panel_scales(panel, wide, few=False)
    around = svg.panel_around(panel, *scales, wide, numbers=True)
    left, top = corner
    frame = svg.fitted(panel, Frame(
        left + around.left, top + around.above, drawing.width - around.right,
        drawing.height - around.below, *scales,
    ))  # fmt: skip
    name = frame.left - around.left + svg.EDGE + text_height(panel.y_label, svg.SIZE) / 2
    svg.draw_panel(drawing, frame, panel, name)
    for points, role, _ in path.lines:
        _draw_course(drawing, frame.places(points[:, 0], points[:, 1]), role)


def _draw_box(drawing: Drawing, path: Path, room: Array) -> None:
    """Draw the box with its path, as large as `room` (2, 2), from top left to bottom right."""
    ranges = [widened(ends) for ends in path.ranges]
    low, high = np.array(ranges).T
    sides = (high - low) / (high - low).max()
    scales = [
        numbered(ends, max(2, round(MAX_AXIS_STEPS * side)))  # a short side has room for few
        for ends, side in zip(ranges, sides, strict=True)
    ]
    words = [
        word for axis in range(3) for word in _words(axis, scales[axis], path.labels[axis], sides)
    ]
    unit = _unit(words, sides, room[1] - room[0])
    extent = _extent(words, sides, unit)
    shift = room.mean(axis=0) - extent.mean(axis=0)

    def on_paper(shares: Array) -> Array:
        return np.asarray(unit * (shares * sides) @ TO_PAPER + shift)

    drawing.lines([on_paper(line) for line in _grid(scales)], "grid", svg.GRID_WIDTH)
    drawing.lines([on_paper(_edge(axis)) for axis in range(3)], "muted", svg.AXIS_WIDTH)
    for points, role, _ in path.lines:
        _draw_course(drawing, on_paper((points - low) / (high - low)), role)
    for word in words:
        x, y = on_paper(word.place) + word.offset
        drawing.turned(x, y, word.text, word.size, word.turn)


def _draw_course(drawing: Drawing, places: Array, role: str) -> None:
    """Draw a line, (n, 2) on paper; a single point as a dot."""
    if len(places) == 1 and role in HOLLOW:
        drawing.rings(places, role, RING, svg.RING_WIDTH)
        return
    if len(places) == 1:
        drawing.dots(places, role, SINGLE)
        return
    parts = [places[piece] for piece in pieces(places.sum(axis=1))]
    drawing.lines([p for p in parts if len(p) > 1], role, COURSE_WIDTH, dash_of(role))
    drawing.dots(places[isolated_points(places[:, 0], places[:, 1])], role, DOT)


def _edge(axis: int) -> Array:
    """The edge that carries an axis' numbers, (2, 3), as shares of the box."""
    return np.array([
        [end if share is None else share for share in NUMBERED[axis]] for end in (0.0, 1.0)
    ])  # fmt: skip


def _grid(scales: list[Scale]) -> list[Array]:
    """The lines on the three walls behind the path, (2, 3) each, as shares of the box."""
    lines = []
    for wall, at in WALLS:
        for axis in {0, 1, 2} - {wall}:
            for value in [*(place for place, _ in scales[axis].visible()), *scales[axis].ends]:
                line = np.zeros((2, 3))
                line[1, 3 - wall - axis] = 1.0
                line[:, wall] = at
                line[:, axis] = scales[axis].place(value, 0.0, 1.0)
                lines.append(line)
    return lines


def _words(axis: int, scale: Scale, label: str, sides: Array) -> list[_Word]:
    """The numbers beside an axis' edge, and its name farther out, along the edge."""
    along = np.diff(_edge(axis) * sides, axis=0)[0] @ TO_PAPER
    along /= np.linalg.norm(along)
    out = np.array([-along[1], along[0]])
    out *= 1.0 if axis == 2 or out[1] > 0 else -1.0
    out = np.array([1.0, 0.0]) if axis == 2 else out
    found, reach = [], 0.0
    for value, word in scale.visible():
        half = np.array([text_width(word, svg.TICK_SIZE), text_height(word, svg.TICK_SIZE)]) / 2
        far = svg.TICK + float(np.abs(out) @ half)
        place = _edge(axis)[0]
        place[axis] = scale.place(value, 0.0, 1.0)
        found.append(_Word(place, far * out, word, svg.TICK_SIZE))
        reach = max(reach, far + float(np.abs(out) @ half))
    name = label + (f" {scale.power}" if scale.power else "")
    turn = float(np.degrees(np.arctan2(along[1], along[0])))
    turn = -90.0 if axis == 2 else (turn + 90.0) % 180.0 - 90.0
    far = reach + svg.GAP + text_height(name, svg.SIZE) / 2
    found.append(_Word(_edge(axis).mean(axis=0), far * out, name, svg.SIZE, turn))
    return found


def _extent(words: list[_Word], sides: Array, unit: float) -> Array:
    """The smallest and largest x and y (2, 2) of the box and its words, its longest side `unit`."""
    corners = np.array(list(product((0.0, 1.0), repeat=3))) * sides @ TO_PAPER * unit
    parts = [word.corners(unit * (word.place * sides) @ TO_PAPER) for word in words]
    every = np.concatenate([corners, *parts])
    return np.stack([every.min(axis=0), every.max(axis=0)])


def _unit(words: list[_Word], sides: Array, room: Array) -> float:
    """The longest side of the box, pt, with which all of it has room."""
    small, large = 1.0, float(2 * room.max())
    for _ in range(20):
        unit = (small + large) / 2
        fits = (np.diff(_extent(words, sides, unit), axis=0)[0] <= room).all()
        small, large = (unit, large) if fits else (small, unit)
    return small
