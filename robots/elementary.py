"""Elementary functions of one float or of an array: a formula written once serves both.

For one number numpy takes some 25 times as long as `math`, and a camera frame must not wait.
"""

import math
from typing import Any

import numpy as np

Number = Any  # a float, or an array (m,)
Condition = Any  # a bool, or an array (m,) of them


def sqrt(x: Number) -> Number:
    """Square root."""
    return math.sqrt(x) if isinstance(x, float) else np.sqrt(x)


def cos(x: Number) -> Number:
    """Cosine of an angle, rad."""
    return math.cos(x) if isinstance(x, float) else np.cos(x)


def sin(x: Number) -> Number:
    """Sine of an angle, rad."""
    return math.sin(x) if isinstance(x, float) else np.sin(x)


def arctan2(y: Number, x: Number) -> Number:
    """Angle of (x, y) from x towards y, rad, in [-pi, pi]."""
    return math.atan2(y, x) if isinstance(y, float) else np.arctan2(y, x)


def clip(x: Number, least: float, most: float) -> Number:
    """The nearest number from least to most."""
    return min(max(x, least), most) if isinstance(x, float) else np.clip(x, least, most)


def where(condition: Condition, one: Any, other: Any) -> Any:
    """One where the condition holds, else the other: numbers, or tuples of them."""
    if isinstance(condition, bool):
        return one if condition else other
    return np.where(condition, one, other)


def some(condition: Condition) -> bool:
    """Whether a condition holds anywhere."""
    return condition if isinstance(condition, bool) else bool(condition.any())
