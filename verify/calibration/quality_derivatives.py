"""How things change with each parameter of a rig, by finite differences through the rig itself."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from verify.calibration.parameters import KEYS, moved
from verify.records import Array
from verify.rig import Rig

STEP = 1e-6  # SI units and pixels: small against curvature, large against rounding


def by_parameters(
    function: Callable[[Rig], Array], rig: Rig, names: Sequence[str], step: float = STEP
) -> Array:
    """Derivative of what a rig gives by its named parameters.

    Args:
        function: a rig to an array of any shape.
        rig: where the derivative is taken.
        names: (p) parameters as in rig.toml's [covariance], of the cameras.
        step: SI units and pixels.

    Returns:
        (p, ...), a SI unit (or pixel, or one) of the parameter.
    """
    rows = [
        (function(with_moved(rig, name, step)) - function(with_moved(rig, name, -step))) / 2 / step
        for name in names
    ]
    return np.array(rows).reshape(len(names), *np.shape(function(rig)))


def with_moved(rig: Rig, name: str, amount: float) -> Rig:
    """Change one parameter of one camera, SI units and pixels; turns act on the left."""
    side, _, key = name.partition(".")
    step = amount * np.eye(len(KEYS))[KEYS.index(key)]
    if side == "left":
        return replace(rig, left=moved(rig.left, step))
    return replace(rig, right=moved(rig.right, step))
