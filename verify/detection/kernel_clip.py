"""What a sensor makes of pixels near a limit of its range, compiled.

One loop does one thing, for then the processor takes several pixels at once: a dark background has
all of it asked of every pixel.
"""

import math

import numpy as np
from scipy.special import ndtr

from verify.compiled import compiled
from verify.detection.noise import QUANTISATION
from verify.records import Array

SENSOR_LIMIT = 255.0  # DN
CLIP_REACH = 4.5  # sigma from a limit within which clipping is computed
LOWEST_Z = -9.0  # sigma: below, a clipped pixel shows nothing
A_UNIT = 256.0  # entries of a table of the normal law
FREE = 6  # rows that are written over
_NODES = np.arange(LOWEST_Z, CLIP_REACH + 1.5 / A_UNIT, 1.0 / A_UNIT)
NORMAL = np.column_stack([ndtr(_NODES), np.exp(-_NODES * _NODES / 2.0) / math.sqrt(2.0 * math.pi)])


@compiled
def clip(mean: Array, variance: Array, visible: Array, free: Array) -> None:
    """Clip normal variables to the sensor's range.

    Args:
        mean: (p,), mu, DN; of the clipped variables, afterwards.
        variance: (p,), likewise.
        visible: (p,), filled with d mean / d mu.
        free: (6, p), written over.
    """
    room, count, near = free[0], len(mean), 0
    for k in range(count):  # the farther limit is always out of reach
        room[k] = min(SENSOR_LIMIT - mean[k], mean[k])
    for k in range(count):
        near += (room[k] < 0.0) | (room[k] * room[k] < CLIP_REACH**2 * variance[k])
    visible[:] = 1.0
    if near > 0:
        clip_near(mean, variance, visible, free)


@compiled
def clip_near(mean: Array, variance: Array, visible: Array, free: Array) -> None:
    """Clip those that are in a limit's reach; the first row that is free holds their room."""
    room, sigma, z = free[0], free[1], free[2]
    inside, density, excess = free[3], free[4], free[5]
    count = len(mean)
    for k in range(count):
        sigma[k] = math.sqrt(variance[k])
    for k in range(count):
        z[k] = min(max(room[k] / sigma[k], LOWEST_Z), CLIP_REACH)
    normal_law(z, inside, density)
    for k in range(count):
        excess[k] = room[k] * inside[k] + density[k] * sigma[k]
    for k in range(count):
        # E[u²] less E[u]², u the clipped room. No less than rounding: a deviation there is the
        # model's, not a miracle of the noise.
        held = max(variance[k] * inside[k] + excess[k] * (room[k] - excess[k]), QUANTISATION)
        variance[k] = held if z[k] < CLIP_REACH else variance[k]
    for k in range(count):
        held = SENSOR_LIMIT - excess[k] if SENSOR_LIMIT - mean[k] < mean[k] else excess[k]
        mean[k] = held if z[k] < CLIP_REACH else mean[k]
    for k in range(count):
        visible[k] = inside[k] if z[k] < CLIP_REACH else 1.0


@compiled
def normal_law(z: Array, below: Array, density: Array) -> None:
    """Share of a standard normal variable below each z (p,), and its density there, to 1e-9.

    A Taylor series about the next entry of a table.
    """
    for k in range(len(z)):
        at = int((z[k] - LOWEST_Z) * A_UNIT + 0.5)
        below[k], density[k] = NORMAL[at, 0], NORMAL[at, 1]
    for k in range(len(z)):
        node = math.floor((z[k] - LOWEST_Z) * A_UNIT + 0.5) * (1.0 / A_UNIT) + LOWEST_Z
        off, here = z[k] - node, density[k]
        curved = off * (node * node - 1.0)
        density[k] = here * (1.0 + off * (0.5 * curved - node))
        below[k] += here * off * (1.0 + off * (curved * (1.0 / 6.0) - 0.5 * node))
