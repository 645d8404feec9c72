"""Faults of single joints: what a unit of each would do to every pair.

Signs and zeros are those of docs/results.md: error = reading less true angle. A column is whitened
as the session's rows are, and holds what the registration left of a fault that was already there.
"""

from collections.abc import Iterator

import numpy as np

from verify.judgement.faults import Fault
from verify.judgement.model import Model
from verify.records import Array

LEAST_SPAN = np.deg2rad(2.0)  # a joint that turns less shows its offset and nothing else
LEAST_PAIRS_A_DIRECTION = 3
SHORTEST_LEVER = 1e-3  # m: shorter ones are rounding
LEAST_LEVER = 0.5  # of the longest: a lever that varies less pulls like an offset
# Below this much of a wave, sine and cosine are a parabola: an offset and a gain in disguise.
LEAST_WAVE = np.deg2rad(60.0)  # of one wave a turn, as the resolved error has it
LEAST_WAVES = np.deg2rad(270.0)  # of several a turn, which must show that they come back
PAIRS_A_WAVE = 4  # fewer take one number of waves for another
WAVES = (*range(1, 9), 10, 12, 16, 20, 24, 30, 36, 48, 60, 72)  # a turn: encoders, cycloids, teeth


def joint_faults(model: Model, j: int) -> Iterator[Fault]:
    """Faults of one joint (from 0) that its motion can show at all."""
    comparison, joint = model.comparison, j + 1
    yield Fault("offset", joint, "deg", model.offsets[:, [j]])
    yield from _by_angle(model, j)
    direction = comparison.direction[:, j]
    if min(np.sum(direction > 0), np.sum(direction < 0)) >= LEAST_PAIRS_A_DIRECTION:
        yield Fault("backlash", joint, "deg", shaped(model, j, direction[:, None] / 2))
    # what hangs below pulls with its horizontal lever; an elastic joint reads more than it turned
    lever = comparison.jacobian[:, 2, j]
    longest = float(np.abs(lever).max(initial=0.0))
    if longest > SHORTEST_LEVER and np.ptp(lever) > LEAST_LEVER * longest:
        yield Fault("compliance", joint, "deg/m", shaped(model, j, lever[:, None]))
    elapsed = comparison.t - comparison.t[0]
    if np.ptp(elapsed) > 0:
        column = model.joints[:, [j]] * elapsed[model.white.pair, None]
        yield Fault("drift", joint, "deg/h", column)


def _by_angle(model: Model, j: int) -> Iterator[Fault]:
    """What changes with the joint's angle alone: gain, and waves of every number a turn."""
    q = model.comparison.q[:, j]
    span = float(np.ptp(q))
    if span <= LEAST_SPAN:
        return
    yield Fault("gain", j + 1, "ratio", shaped(model, j, q[:, None]))
    shown = [waves for waves in WAVES if _shows(q, span, waves)]
    angles = q[:, None] * np.array(shown, dtype=float)
    shapes = np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(q), -1)
    columns = shaped(model, j, shapes)
    for i, waves in enumerate(shown):
        own = columns[:, 2 * i : 2 * i + 2]
        yield Fault("eccentricity", j + 1, "deg", own, per_turn=waves)


def _shows(q: Array, span: float, waves: int) -> bool:
    if waves == 1:
        return bool(span > LEAST_WAVE)
    enough = len(q) >= PAIRS_A_WAVE * max(1.0, waves * span / (2 * np.pi))
    return bool(enough and waves * span > LEAST_WAVES)


def shaped(model: Model, j: int, shape: Array) -> Array:
    """Whitened columns (r, p) of a joint's error that varies as `shape` (n, p) does.

    Of its mean, the registration hides what it hides of an offset; what varies about it is seen.
    """
    mean = shape.mean(axis=0)
    varying = model.joints[:, [j]] * (shape - mean)[model.white.pair]
    columns: Array = varying + model.offsets[:, [j]] * mean
    return columns
