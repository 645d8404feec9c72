"""Random numbers that depend on the seed and on what they are for, never on the order of calls."""

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What a stream of random numbers is for; the numbers are part of every seed's meaning."""

    MOTION = 0
    TIMES = 1
    ENCODERS = 2
    SYSTEMATIC = 3
    PAN = 4
    CLOCK = 5
    ROOM = 6
    PIXELS = 7


def generator(seed: int, stream: Stream, *key: int) -> np.random.Generator:
    """Make the generator of one stream, e.g. of the pixels of one camera's frame 12."""
    sequence = np.random.SeedSequence(seed, spawn_key=(int(stream), *key))
    return np.random.Generator(np.random.PCG64(sequence))
