"""How far the pictures of a calibration have come, and what is missing, in words."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from verify.calibration.quality_advice import (
    DEPTH_RATIO,
    EDGE,
    EDGES,
    FEW_PAIRS,
    HORIZONTAL,
    ONE_SIDED,
    TILT,
    VERTICAL,
)
from verify.calibration.quality_coverage import CELLS_ACROSS, REGIONS
from verify.live.board_taken import Standing, TakenPairs
from verify.records import Array

SIDES = ("left", "right")
IN_A_REGION = 10  # corners
PAN_PLACES = 3  # of each base that turns


@dataclass(frozen=True, slots=True)
class Goal:
    """Something that the pictures must have."""

    name: str
    reached: bool
    words: str  # how far it is, or what to do


@dataclass(frozen=True, slots=True)
class Coverage:
    """What one camera's pictures have covered."""

    cells: Array  # (rows, columns), corners seen, over a grid of square cells
    regions: Array  # (3, 3), likewise, upper left first
    margins: Array  # (4,), share left, above, right and below all corners
    standings: tuple[Standing, ...]


def coverage(taken: TakenPairs, side: int) -> Coverage:
    """Count what the left (0) or right (1) camera has seen."""
    width, height = taken.image_size
    views = [(pair.left, pair.right)[side] for pair in taken.pairs]
    seen = np.concatenate([v.centre for v in views if v is not None] or [np.empty((0, 2))])
    down = max(round(CELLS_ACROSS * height / width), 1)
    margins = np.ones(4)
    if len(seen):
        low, high = (f(axis=0) + 0.5 for f in (seen.min, seen.max))
        margins = np.concatenate([low / [width, height], 1 - high / [width, height]])
    return Coverage(
        _counted(seen, (width, height), (CELLS_ACROSS, down)),
        _counted(seen, (width, height), (REGIONS, REGIONS)),
        margins,
        tuple(taken.of_camera(side)),
    )


def goals(taken: TakenPairs, covered: Sequence[Coverage], *, turning: bool) -> tuple[Goal, ...]:
    """Say what the pictures must have and how far they are, most needed first.

    The limits are those by which the report judges (`quality_advice`).

    Args:
        taken: the pairs.
        covered: of both cameras.
        turning: the bases are turned: their angles must be varied too.
    """
    wanted = 2 * FEW_PAIRS
    count = Goal("pairs", len(taken) >= wanted, f"{len(taken)} of {wanted}")
    images = [_image(side, c) for side, c in zip(SIDES, covered, strict=True)]
    stances = [s.stance for s in covered[0].standings]
    return (
        *images,
        _tilt("horizontal", [s.about_horizontal for s in stances], ("upper", "lower")),
        _tilt("vertical", [s.about_vertical for s in stances], ("right", "left")),
        _distance([s.distance for s in stances]),
        *(_bases(taken) if turning else ()),
        count,
    )


def _counted(seen: Array, size: tuple[int, int], cells: tuple[int, int]) -> Array:
    edges = [np.linspace(-0.5, extent - 0.5, n + 1) for extent, n in zip(size, cells, strict=True)]
    counts: Array = np.histogram2d(seen[:, 1], seen[:, 0], bins=(edges[1], edges[0]))[0]
    return counts


def _image(side: str, covered: Coverage) -> Goal:
    name = f"{side} image"
    bare = np.argwhere(covered.regions < IN_A_REGION).tolist()
    if bare:
        row, column = bare[0]
        where = f"{VERTICAL[row]} {HORIZONTAL[column]}".replace("middle middle", "middle")
        done = REGIONS * REGIONS - len(bare)
        words = f"{done} of {REGIONS * REGIONS} parts; hold the board in the {where}"
        return Goal(name, False, words)
    far = int(np.argmax(covered.margins))
    if covered.margins[far] > EDGE:
        return Goal(name, False, f"bring the board nearer to the {EDGES[far]} edge")
    return Goal(name, True, "covered up to its edges")


def _tilt(axis: str, angles: Sequence[float], edges: tuple[str, str]) -> Goal:
    """Judge the tilts about one axis; a positive one brings the first edge nearer."""
    name = f"tilt, {edges[0]} and {edges[1]}"
    most = [max((sign * a for a in angles), default=0.0) for sign in (1, -1)]
    reached = max(most) >= TILT and min(most) >= ONE_SIDED
    if reached:
        return Goal(name, True, f"up to {np.rad2deg(max(most)):.0f}° about the {axis} axis")
    edge = edges[int(most[1] < most[0])]
    return Goal(name, False, f"tilt the board by 30° to 45°, its {edge} edge nearer")


def _distance(distances: Sequence[float]) -> Goal:
    if not distances:
        return Goal("distance", False, "hold the board near, then far")
    near, far = min(distances), max(distances)
    if far >= DEPTH_RATIO * near:
        return Goal("distance", True, f"{near:.2f} m to {far:.2f} m")
    words = f"at {far / DEPTH_RATIO:.2f} m or nearer, or at {near * DEPTH_RATIO:.2f} m or farther"
    return Goal("distance", False, f"hold the board {words}")


def _bases(taken: TakenPairs) -> Iterator[Goal]:
    for side, name in enumerate(SIDES):
        angles = [(pair.pan_left, pair.pan_right)[side] for pair in taken.pairs]
        places = len(np.unique(np.round(np.rad2deg(angles)))) if angles else 0
        words = f"{places} of {PAN_PLACES} angles; turn it"
        if places >= PAN_PLACES:
            words = f"{places} angles"
        yield Goal(f"{name} base", places >= PAN_PLACES, words)
