"""What a sensor makes of a pixel near a limit of its range, compiled."""

import math

import numpy as np
from scipy.special import ndtr

from verify.compiled import compiled
from verify.detection.noise import QUANTISATION

SENSOR_LIMIT = 255.0  # DN
CLIP_REACH = 4.5  # sigma from a limit within which clipping is computed
LOWEST_Z = -9.0  # sigma: below, a clipped pixel shows nothing
A_UNIT = 64.0  # entries of a table of the normal law
_NODES = np.arange(LOWEST_Z, CLIP_REACH + 1.5 / A_UNIT, 1.0 / A_UNIT)
NORMAL = np.column_stack([ndtr(_NODES), np.exp(-_NODES * _NODES / 2.0) / math.sqrt(2.0 * math.pi)])


@compiled
def clipped(mu: float, noise: float) -> tuple[float, float, float]:
    """Mean, variance and d mean / d mu of a normal variable clipped to the sensor's range."""
    from_above = SENSOR_LIMIT - mu
    room = min(from_above, mu)  # the farther limit is always out of reach
    sigma = math.sqrt(noise)
    z = room / sigma
    if z >= CLIP_REACH:
        return mu, noise, 1.0
    inside, density = normal_law(max(z, LOWEST_Z))
    excess = room * inside + density * sigma
    # E[u²] less E[u]², u the clipped room. No less than rounding: a deviation there is the
    # model's, not a miracle of the noise.
    variance = max(noise * inside + excess * (room - excess), QUANTISATION)
    return (SENSOR_LIMIT - excess if from_above < mu else excess), variance, inside


@compiled
def normal_law(z: float) -> tuple[float, float]:
    """Share of a standard normal variable below z, and its density there, to 1e-9.

    A Taylor series about the next entry of a table: a dark background has it asked of each pixel.
    """
    at = int((z - LOWEST_Z) * A_UNIT + 0.5)
    node = at * (1.0 / A_UNIT) + LOWEST_Z
    off, share, density = z - node, NORMAL[at, 0], NORMAL[at, 1]
    one, two, three = -node, (node * node - 1.0) / 2.0, (3.0 - node * node) * node / 6.0
    here = density * (1.0 + off * (one + off * (two + off * three)))
    below = share + density * off * (
        1.0 + off * (one / 2.0 + off * (two / 3.0 + off * (three / 4.0)))
    )
    return below, here
