"""How far results of one number may be from those of an array, by the processor's own functions."""

import math

import numpy as np

_Y, _X = np.random.default_rng(0).uniform(-3.0, 3.0, (2, 4096))
# numpy's arctan2 of an array is math's but with AVX-512: only there may angles differ at all
ALIKE = np.arctan2(_Y, _X).tolist() == list(map(math.atan2, _Y.tolist(), _X.tolist()))
ROUNDING_RAD = 0.0 if ALIKE else 1e-13
ROUNDING_DEG = 0.0 if ALIKE else 1e-11
