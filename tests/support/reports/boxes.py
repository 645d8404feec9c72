"""Paths in space in boxes of many shapes."""

import itertools

import numpy as np

from reports.document.charts import Path

SHAPES = [s for s in itertools.product((0.1, 0.4, 1.0), repeat=3) if max(s) == 1.0]


def boxed(shape: tuple[float, ...], scale: float) -> Path:
    """The diagonal of a box whose sides are `scale` times `shape`, mm."""
    low = -1.3 * scale * np.ones(3)
    ranges = tuple((float(a), float(a + scale * b)) for a, b in zip(low, shape, strict=True))
    points = np.array(list(zip(*ranges, strict=True)))
    lines = ((points, "measured", "target, seen by the cameras"),)
    return Path(lines, ("x [mm]", "distance [mm]", "z [mm]"), ranges)
