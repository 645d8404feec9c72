"""How many lens coefficients the pictures support.

A lens has fx, fy, k1, k2, p1 and p2. k3 joins them where Bayes' information criterion gains by it.
Where it does not, k3 is 0 and the other parameters' uncertainties hold for a lens without it; but
where chance alone seldom shows so much of it, it keeps the standard uncertainty that it had while
it was free, and the others' covariance grows as if it were.

The other coefficients are never judged by their size: one that is small is small for that lens,
and leaving it out would move the principal point by more than its stated uncertainty. They go
where the pictures know less of them than is known of any lens, and keep that as their standard
uncertainty.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.calibration import bundle
from verify.calibration.estimate import Estimate, estimate
from verify.calibration.gauge import FOCAL_TIE, LENS_KEYS
from verify.calibration.parameters import LENS, SIDES, WIDTH, Corners
from verify.records import Array

REFIT = 6  # iterations after a coefficient went: the state hardly moves
SELDOM = 1.96  # standard uncertainties that chance exceeds once in twenty
# What lenses and sensors of small cameras have, as standard uncertainties about 0.
USUAL = {"k2": 0.5, "p1": 0.003, "p2": 0.003}
USUAL_FOCAL = 0.005  # of the focal length: difference of fx and fy


@dataclass(frozen=True, slots=True)
class Dropped:
    """A coefficient that the pictures do not support."""

    name: str  # left.k3; left.fy_px: the difference of the focal lengths
    value: float  # what the pictures gave for it
    uncertainty: float
    remaining: float  # standard uncertainty of holding it

    @property
    def sentence(self) -> str:
        """Say it to the reader."""
        side, _, key = self.name.partition(".")
        what, unit = (key, "") if key != FOCAL_TIE else ("fy - fx", " px")
        sentence = (
            f"{side} camera: {what} held at 0, as the pictures do not support it "
            f"({self.value:.2g} ± {self.uncertainty:.2g}{unit})"
        )
        if self.remaining:
            return f"{sentence}; ± {self.remaining:.2g}{unit} of it stays in the covariance."
        return f"{sentence}; the uncertainties hold for a lens without it."


def reduce(found: Estimate, corners: Corners) -> tuple[Estimate, tuple[Dropped, ...]]:
    """Take away what the pictures do not support, one at a time, and adjust again."""
    gone: list[Dropped] = []
    while (weak := next(unsupported(found), None)) is not None:
        gone.append(weak)
        model = replace(found.model, held=(*found.model.held, weak.name))
        state = bundle.adjust(found.state, corners, model, found.used.astype(float), REFIT)
        found = estimate(state, corners, model, found.used)
    return found, tuple(gone)


def unsupported(found: Estimate) -> Iterator[Dropped]:
    """Name the free coefficients that the pictures do not support, the first to go first.

    Args:
        found: an adjusted state; what its model holds already is not named.
    """
    # a pair whose corners err together counts for fewer
    price = float(np.log(max(2 * found.used.sum() / found.together, math.e)))
    for side in SIDES:
        if f"{side}.k3" not in found.model.held:
            value, u = _known(found, side, "k3")
            if value**2 <= price * u**2:
                remaining = u if abs(value) > SELDOM * u else 0.0
                yield Dropped(f"{side}.k3", value, u, remaining)
    for side, camera in zip(SIDES, found.state.cameras, strict=True):
        usual = {**USUAL, FOCAL_TIE: USUAL_FOCAL * camera.matrix[0, 0]}
        for key, spread in usual.items():
            # a radial coefficient does not go before that of the next order
            if f"{side}.{key}" in found.model.held or (
                key == "k2" and f"{side}.k3" not in found.model.held
            ):
                continue
            value, u = _known(found, side, key)
            if u > spread:
                yield Dropped(f"{side}.{key}", value, u, spread)


def _known(found: Estimate, side: str, key: str) -> tuple[float, float]:
    """Value and standard uncertainty of a coefficient, or of fy less fx."""
    index = SIDES.index(side)
    camera = found.state.cameras[index]
    row = np.zeros(2 * WIDTH)
    if key == FOCAL_TIE:
        row[index * WIDTH : index * WIDTH + 2] = -1.0, 1.0
        value = camera.matrix[1, 1] - camera.matrix[0, 0]
    else:
        row[index * WIDTH + LENS.start + LENS_KEYS.index(key)] = 1.0
        value = camera.distortion[LENS_KEYS.index(key)]
    return float(value), float(np.sqrt(row @ found.covariance @ row))


def shortest() -> tuple[str, ...]:
    """All that may be held: the model to begin with."""
    return tuple(f"{side}.{key}" for side in SIDES for key in ("k3", *USUAL, FOCAL_TIE))


def left_open(dropped: Sequence[Dropped], moved: Array) -> Array:
    """Covariance (44, 44) that holding coefficients leaves; `moved` (44, h): by a unit of each."""
    spread = moved * np.array([d.remaining for d in dropped])
    covariance: Array = spread @ spread.T
    return covariance
