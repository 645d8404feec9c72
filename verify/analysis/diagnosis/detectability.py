"""How small a fault of each kind this session would list, and tell from every other fault.

After Baarda's internal reliability, with the thresholds that the diagnosis itself asks: what a
fault must lower chi-squared by to be listed, and by how much it must beat each rival.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from verify.analysis.diagnosis.causes import MIN_ADVANTAGE, required_advantage
from verify.analysis.diagnosis.faults import UNIT_SCALES, Name
from verify.analysis.diagnosis.search import FaultProducts
from verify.core.records import Array
from verify.core.statistics import chi2_isf

MAX_RIVAL_RATIO = 100.0  # the listed size: a rival that leaves less of a fault is the same as it
POWER_SIGMA = 0.84  # standard deviations beyond a threshold: it is passed four times in five
# Of a rival's chance: the closest is beaten 85 times in 100, as others come close besides; of what
# begins in the session, of the largest chance at the instants where it resembles a drift most.
RIVAL_SIGMA = 1.04
INSTANTS_SIGMA = 2.0
AXES = ("x", "y", "z", "rx", "ry", "rz")
DETECTABILITY_COLUMNS = [
    "joint", "kind", "parameter", "per_turn", "unit", "detectable", "separable", "rival_joint",
    "rival_kind",
]  # fmt: skip


def detectable(products: FaultProducts) -> pd.DataFrame:
    """One row a fault that was tried: its smallest size that is listed, and that is named.

    Columns: `joint` (none of a common fault), `kind`, `parameter` (of a link; the axis of a
    displacement), `per_turn` (waves of an eccentricity), `unit`; `detectable` and `separable`, in
    that unit, nan where no size would do; `rival_joint`, `rival_kind`: from which it is told last.
    A step's are those of one in the middle of the session, an eccentricity's those of its least
    favourable phase, a displacement's those of one along or about one axis alone, from the
    beginning.
    """
    ways = _fault_directions(products)
    listed, named, rival = _sizes(products, ways)
    rows = []
    for way, size, told, k in zip(ways, listed.tolist(), named.tolist(), rival, strict=True):
        fault, other = products.faults[way.fault], products.faults[k] if k >= 0 else None
        scale = UNIT_SCALES[way.unit]
        rows.append(
            (
                fault.joint, fault.kind, way.parameter, fault.per_turn, way.unit, size * scale,
                told * scale, other.joint if other else None, other.kind if other else None,
            )
        )  # fmt: skip
    return pd.DataFrame(rows, columns=DETECTABILITY_COLUMNS)


class _FaultVariant(NamedTuple):
    """A way that a fault can be: its only one, or one axis of a displacement."""

    fault: int
    first: int  # of its columns; of an eccentricity's two
    last: int
    parameter: str | None
    unit: str


def _fault_directions(products: FaultProducts) -> list[_FaultVariant]:
    ways = []
    stated: set[Name] = set()
    for i, (fault, place) in enumerate(zip(products.faults, products.places, strict=True)):
        if not fault.unit or (fault.begin is not None and fault.name in stated):
            continue
        stated.add(fault.name)
        if fault.freedom == len(AXES):
            units = ("mm",) * 3 + ("deg",) * 3
            along = zip(place.tolist(), AXES, units, strict=True)
            ways += [_FaultVariant(i, k, k, axis, unit) for k, axis, unit in along]
        else:
            ways.append(
                _FaultVariant(i, int(place[0]), int(place[-1]), fault.parameter, fault.unit)
            )
    return ways


def _sizes(products: FaultProducts, ways: list[_FaultVariant]) -> tuple[Array, Array, list[int]]:
    """Least sizes listed and named, SI, a way each, and the rival that asks for most (or -1)."""
    fault, first, last = (np.array([way[k] for way in ways], dtype=np.int64) for k in range(3))
    scale = np.minimum(products.scale[first], products.scale[last])
    largest = np.array([products.faults[way.fault].largest for way in ways])
    own, other, mixed = (
        products.gram[ends] for ends in ((first, first), (last, last), (first, last))
    )
    left = _worst_mixture(own, other, mixed, alone=first == last) * scale
    left[~products.visible[fault]] = np.nan
    # beside those that resemble it, the best of all rivals fits something by mere chance
    chance = chi2_isf(1 / max(int(products.visible.sum()), 2), 1)
    price = products.price[fault]
    listed = (np.sqrt(price) + POWER_SIGMA) / left
    named = (np.sqrt(np.maximum(price, MIN_ADVANTAGE + chance)) + POWER_SIGMA) / left
    same_name = _same_name(products)[:, fault]
    advantages = required_advantage(products)[fault].T
    rival = np.full(len(ways), -1)
    for k, beside in _remainders_beside(products, first, last):
        advantage = advantages[k]
        # the rival gains by the very chance by which the fault loses
        z = INSTANTS_SIGMA if products.faults[k].instants > 1 else RIVAL_SIGMA
        with np.errstate(divide="ignore"):
            needed = (z + np.sqrt(np.maximum(z**2 + advantage, 0.0))) / (beside * scale)
        needed[needed > np.fmin(MAX_RIVAL_RATIO * listed, largest)] = np.nan
        # a rival with many more coefficients asks for nothing: it never stands in its place
        harder = ~same_name[k] & (advantage > -(z**2)) & ~np.isnan(named) & ~(needed <= named)
        named[harder], rival[harder] = needed[harder], k
    return listed, named, rival.tolist()


def _same_name(products: FaultProducts) -> NDArray[np.bool_]:
    """Which faults (c, c) have the same name."""
    number = {name: i for i, name in enumerate(dict.fromkeys(f.name for f in products.faults))}
    which = np.array([number[f.name] for f in products.faults])
    alike: NDArray[np.bool_] = which[:, None] == which
    return alike


def _remainders_beside(
    products: FaultProducts, first: NDArray[np.int64], last: NDArray[np.int64]
) -> Iterator[tuple[int, Array]]:
    """What is left of each way's unit column beside every visible fault in turn, (ways,)."""
    gram = products.gram
    left = np.empty((len(products.faults), len(first)))
    ways = (first, first), (last, last), (first, last)
    for which, at in products.seen:
        rows = gram[at]
        shared = np.linalg.solve(gram[at[:, :, None], at[:, None, :]], rows)
        one, other, mixed = (
            gram[a, b] - np.sum(rows[:, :, a] * shared[:, :, b], axis=1) for a, b in ways
        )
        left[which] = _worst_mixture(one, other, mixed, alone=first == last)
    for k in np.flatnonzero(products.visible).tolist():
        yield k, left[k]


def _worst_mixture(one: Array, other: Array, mixed: Array, *, alone: NDArray[np.bool_]) -> Array:
    """Length of a column, or of two columns' worst mixture, by their products."""
    least = (one + other) / 2 - np.hypot((one - other) / 2, mixed)  # smaller eigenvalue
    return np.sqrt(np.maximum(np.where(alone, one, least), 0.0))
