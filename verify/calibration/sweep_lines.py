"""Relations between two axes: as a DH table gives them, and as they were measured."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import robots
from verify.records import Array

PARALLEL = np.deg2rad(5.0)  # axes nearer to parallel have no common normal to speak of
STEP = 1e-6  # rad and m, of numerical derivatives: small against curvature, large against rounding


@dataclass(frozen=True, slots=True)
class Line:
    """A joint's axis; the joint's angle grows by the right hand about the direction."""

    direction: Array  # (3,), unit vector
    point: Array  # (3,), m


def line_in_base(arm: robots.Arm, joint: int, q: Array) -> Line:
    """The axis of a joint (counted from 0) in the base at joint angles q (n,), by the arm's table.

    The point is the axis's nearest to the flange. From the geometric Jacobian: its column holds
    the direction z and z × (p − o) for the flange p and any point o of the axis.
    """
    column = robots.jacobian(arm, q)[:, joint]
    flange = robots.forward(arm, q)[:3, 3]
    return Line(column[3:], flange + np.cross(column[3:], column[:3]))


def parallel(one: Line, other: Line) -> bool:
    """Whether two lines count as parallel (or run against each other)."""
    return bool(np.linalg.norm(np.cross(one.direction, other.direction)) < np.sin(PARALLEL))


def angle_between(one: Line, other: Line) -> float:
    """Angle between two directions, rad, 0 to pi: the twist between axes."""
    sine = np.linalg.norm(np.cross(one.direction, other.direction))
    return float(np.arctan2(sine, one.direction @ other.direction))


def distance_between(one: Line, other: Line) -> float:
    """Distance of two lines along their common normal, m: the link length.

    Lines that are not parallel have it signed along one × other, so that noise about zero
    averages to zero; parallel ones have it across their mean direction.
    """
    apart = other.point - one.point
    if not parallel(one, other):
        normal = np.cross(one.direction, other.direction)
        return float(apart @ normal / np.linalg.norm(normal))
    sense = np.sign(one.direction @ other.direction)
    mean = one.direction + sense * other.direction
    mean = mean / np.linalg.norm(mean)
    return float(np.linalg.norm(apart - mean * (mean @ apart)))


def tilt_between(one: Line, other: Line) -> Array:
    """How far other's direction leaves one's line, (3,): a vector that parallel axes have at 0."""
    return other.direction * np.sign(one.direction @ other.direction) - one.direction


def frame_of(one: Line, other: Line) -> Array:
    """A frame of two lines, (4, 4): z along one, origin on it where the common normal meets it.

    x is along one × other; the lines must not be parallel.
    """
    x = np.cross(one.direction, other.direction)
    x = x / np.linalg.norm(x)
    apart = other.point - one.point
    # one + s z1 and other + t z2 are joined by x: solve for s
    solved = np.linalg.solve(np.stack([one.direction, -other.direction, x], axis=1), apart)
    frame = np.eye(4)
    frame[:3, :3] = np.stack([x, np.cross(one.direction, x), one.direction], axis=1)
    frame[:3, 3] = one.point + solved[0] * one.direction
    return frame


def nudged(line: Line, across: Array, step: Array) -> Line:
    """A line moved by its four small parameters: direction, then point, along `across` (2, 3)."""
    direction = line.direction + step[:2] @ across
    return Line(direction / np.linalg.norm(direction), line.point + step[2:] @ across)


def derivative(
    function: Callable[[Line, Line], Array],
    lines: tuple[Line, Line],
    across: tuple[Array, Array],
) -> Array:
    """Derivative of a function of two lines by their eight parameters, (…, 8), numerically."""

    def at(step: Array) -> Array:
        one, other = (
            nudged(line, a, s)
            for line, a, s in zip(lines, across, (step[:4], step[4:]), strict=True)
        )
        return np.asarray(function(one, other), dtype=np.float64)

    columns = [(at(row) - at(-row)) / (2 * STEP) for row in STEP * np.eye(8)]
    return np.stack(columns, axis=-1)
