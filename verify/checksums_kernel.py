"""Bits in the other order, compiled: several bytes at once, where Python's table takes one."""

import numpy as np
from numpy.typing import NDArray

from verify.compiled import compiled

Bytes = NDArray[np.uint8]


@compiled
def turn_bits(data: Bytes, turned: Bytes) -> None:
    """Fill in bytes (n,) with the bits of each in the other order."""
    for k in range(len(data)):
        bits = data[k]
        bits = ((bits >> 1) & 0x55) | ((bits & 0x55) << 1)
        bits = ((bits >> 2) & 0x33) | ((bits & 0x33) << 2)
        turned[k] = ((bits >> 4) & 0x0F) | ((bits & 0x0F) << 4)
