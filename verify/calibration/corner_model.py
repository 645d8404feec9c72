"""A corner's picture: two blurred edges that cross, between squares of two colours.

It is shade(x) + contrast(x) · cross(x), shade and contrast linear over the window. With F the
normal distribution, d1 and d2 the distances from the two edges, b1 and b2 their blur,

    cross = 1 - 2 F((d1 - e) / b1) F((-d2 - e) / b2) - 2 F((-d1 - e) / b1) F((d2 - e) / b2)

where e is by how much one colour has spread over the other: ink, or light where white saturates.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from verify.calibration.corner_window import Edges, Window
from verify.records import Array

X, Y, TURN_1, TURN_2, BLUR_1, BLUR_2, SPREAD, SHADE, SHADE_X, SHADE_Y = range(10)
CONTRAST, TILT_X, TILT_Y = range(10, 13)
BLUR = [BLUR_1, BLUR_2]
PARAMETERS = 13
SHARPEST = 0.7  # px: sharper than a pixel shows is not seen


def start_values(window: Window, edges: Edges, blur: float) -> Array:
    """Parameters to start from; the contrast's sign from the means of opposite quadrants."""
    same = np.ones(len(window.x))
    for angle in edges.start:
        same *= np.sign(window.x * np.cos(angle) + window.y * np.sin(angle))
    high, low = (window.value[part].mean() if part.any() else 0.0 for part in (same > 0, same < 0))
    start = np.zeros(PARAMETERS)
    start[[TURN_1, TURN_2]] = edges.start
    start[BLUR] = np.log(max(blur, SHARPEST))
    start[SHADE], start[CONTRAST] = (high + low) / 2, (high - low) / 2
    return start


def model(window: Window, edges: Edges, parameters: Array) -> tuple[Array, Array]:
    """Expected pixels (p,) and their derivatives by the parameters (p, 13)."""
    one = edge(window, parameters, edges.curvature, 0)
    two = edge(window, parameters, edges.curvature, 1)
    # Of the quadrants between the edges one diagonal pair is drawn over the other's ground.
    cross = 1 - 2 * (one.above * two.below + one.below * two.above)
    by_one = 2 * (one.near_below * two.above - one.near_above * two.below)
    by_two = 2 * (two.near_below * one.above - two.near_above * one.below)
    up_one, up_two = one.distance + one.spread, two.distance + two.spread
    down_one, down_two = one.distance - one.spread, two.distance - two.spread
    x, y = window.x / edges.scale, window.y / edges.scale
    contrast = parameters[CONTRAST] + parameters[TILT_X] * x + parameters[TILT_Y] * y
    shade = parameters[SHADE] + parameters[SHADE_X] * x + parameters[SHADE_Y] * y
    return shade + contrast * cross, np.stack(
        [
            contrast * (by_one * one.by_x + by_two * two.by_x),
            contrast * (by_one * one.by_y + by_two * two.by_y),
            contrast * by_one * one.by_turn,
            contrast * by_two * two.by_turn,
            2
            * contrast
            * (down_one * one.near_above * two.below - up_one * one.near_below * two.above),
            2
            * contrast
            * (down_two * two.near_above * one.below - up_two * two.near_below * one.above),
            2
            * contrast
            * (
                one.near_above * two.below
                + one.near_below * two.above
                + two.near_above * one.below
                + two.near_below * one.above
            ),
            np.ones_like(x),
            x,
            y,
            cross,
            cross * x,
            cross * y,
        ],
        axis=1,
    )


@dataclass(frozen=True, slots=True)
class Edge:
    """One edge over the window's pixels."""

    distance: Array  # (p,), px, along its normal
    spread: float  # px
    above: Array  # (p,), share of a pixel's light from beyond the edge, drawn back by the spread
    below: Array  # (p,), likewise from the other side
    near_above: Array  # (p,), 1/px, their derivatives' sizes
    near_below: Array
    by_x: Array  # (p,), d distance / d parameter
    by_y: Array
    by_turn: Array


def edge(window: Window, parameters: Array, curvature: tuple[float, float], which: int) -> Edge:
    """Blurred step across the first or second edge."""
    turn, width = parameters[TURN_1 + which], np.exp(parameters[BLUR_1 + which])
    spread, bend = parameters[SPREAD], curvature[which]
    from_x, from_y = window.x - parameters[X], window.y - parameters[Y]
    c, s = np.cos(turn), np.sin(turn)
    along, straight = from_y * c - from_x * s, from_x * c + from_y * s
    distance = straight - bend / 2 * along**2
    up, down = (distance - spread) / width, (-distance - spread) / width
    density = np.sqrt(2 * np.pi) * width
    return Edge(
        distance=distance,
        spread=spread,
        above=ndtr(up),
        below=ndtr(down),
        near_above=np.exp(-up * up / 2) / density,
        near_below=np.exp(-down * down / 2) / density,
        by_x=-c - bend * along * s,
        by_y=-s + bend * along * c,
        by_turn=along * (1 + bend * straight),
    )
