"""How small a fault of each kind this session would list, and tell from every other fault.

After Baarda's internal reliability, with the thresholds that the diagnosis itself asks: what a
fault must lower chi-squared by to be listed, and by how much it must beat each rival. The closest
of many rivals is another one in each session, by chance: so noise is drawn, and a size is sought
that is named in four draws of five.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from verify.analysis.diagnosis.causes import required_advantage
from verify.analysis.diagnosis.faults import UNIT_SCALES, Name
from verify.analysis.diagnosis.search import JOINT_RIVALS, FaultProducts
from verify.core.records import Array, Flags, Index

MAX_RIVAL_RATIO = 100.0  # the listed size: a rival that leaves less of a fault is the same as it
POWER_SIGMA = 0.84  # standard deviations beyond a threshold: it is passed four times in five
NAMED_SHARE = 0.80  # of the sessions in which a fault of the separable size is named
DRAWS, SEED = 100, 20261126
TOL_ALIKE = 1e-9  # of a fault's square: what rounding leaves of it beside its equal
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
    favourable phase where it is listed and of any phase where it is named, a displacement's those
    of one along or about one axis alone, from the beginning.
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
        begun_again = fault.begin is not None and fault.name in stated
        if not fault.unit or begun_again or fault.variant:
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
    gram, scale = products.gram, np.minimum(products.scale[first], products.scale[last])
    own, other, mixed = (gram[ends] for ends in ((first, first), (last, last), (first, last)))
    # of a column, or of the worst mixture of two: the smaller eigenvalue of their products
    least = (own + other) / 2 - np.hypot((own - other) / 2, mixed)
    left = np.sqrt(np.maximum(np.where(first == last, own, least), 0.0)) * scale
    left[~products.visible[fault]] = np.nan
    listed = (np.sqrt(products.price[fault]) + POWER_SIGMA) / left
    named, rival = np.full(len(ways), np.nan), [-1] * len(ways)
    chance = _Chance.of(products)
    for k in np.flatnonzero(~np.isnan(listed)).tolist():
        needed, among = _named_sizes(products, chance, ways[k])
        size = float(np.sort(needed)[int(NAMED_SHARE * DRAWS)])
        closest = among[:, needed >= size].sum(axis=1)
        if closest.any():
            rival[k] = int(chance.fault[np.argmax(closest)])
        for kind in JOINT_RIVALS.get(products.faults[ways[k].fault].kind, ()):
            size = max(size, _beside_all(products, ways[k], kind))
        if size <= min(MAX_RIVAL_RATIO * listed[k], products.largest[ways[k].first]):
            named[k] = max(size, listed[k])  # at the worst phase, listing asks for more
    return listed, named, rival


def _beside_all(products: FaultProducts, way: _FaultVariant, kind: str) -> float:
    """Least size, SI, at which a drift of base or camera is listed beside all faults of a kind.

    Several of them at once are its rivals as well, and fewer of them have fewer coefficients.
    """
    at = products.columns(products.of_kind(kind))
    gram, own = products.gram, way.first
    left = gram[own, own] - gram[own, at] @ np.linalg.pinv(gram[np.ix_(at, at)]) @ gram[at, own]
    if left <= TOL_ALIKE * gram[own, own]:
        return float("inf")
    needed = np.sqrt(products.price[way.fault]) + POWER_SIGMA
    return float(needed / (np.sqrt(left) * products.scale[own]))


@dataclass(frozen=True)
class _Chance:
    """What noise alone gives the v visible faults, in m draws.

    Faults of as many columns as each other, f, are a group of k; those of each are orthonormal.
    """

    fault: Index  # (v,)
    given: list[Array]  # (k, f, p) a group: what a unit of each plain column gives them
    noise: list[Array]  # (k, f, m)
    gain: Array  # (v, m), by which the noise lowers chi-squared
    needed: Array  # (v, v), by which the second has to be beaten by the first

    @classmethod
    def of(cls, products: FaultProducts) -> "_Chance":
        """Draw the moments that noise of the stated size makes."""
        gram = products.gram
        value, axis = np.linalg.eigh(gram)
        drawn = np.random.default_rng(SEED).standard_normal((len(value), DRAWS // 2))
        moment = (axis * np.sqrt(np.maximum(value, 0.0))) @ np.hstack([drawn, -drawn])
        given, noise = [], []
        for _, at, _ in products.visible_groups:
            factor = np.linalg.cholesky(gram[at[:, :, None], at[:, None, :]])
            given.append(np.linalg.solve(factor, gram[at] * products.scale))
            noise.append(np.linalg.solve(factor, moment[at]))
        fault = np.concatenate([which for which, _, _ in products.visible_groups])
        names = [products.faults[k].name for k in fault.tolist()]
        needed = required_advantage(products)[np.ix_(fault, fault)]
        needed[[[one == other for other in names] for one in names]] = -np.inf
        return cls(fault, given, noise, _group_sums([n**2 for n in noise]), needed)


def _group_sums(groups: list[Array]) -> Array:
    """Sum each group's rows (k, f, m) a fault, (v, m)."""
    return np.concatenate([group.sum(axis=1) for group in groups])


def _named_sizes(
    products: FaultProducts, chance: _Chance, way: _FaultVariant
) -> tuple[Array, Flags]:
    """Sizes (m,), SI, from which a fault is named in each draw, and which rivals (v, m) ask for it.

    A fault of size s lowers chi-squared by the square of s times what it gives the columns, plus
    noise; it is listed from its price on, and named where it leads each rival by as much as is
    asked. Of an eccentricity, each draw has another phase.
    """
    own = int(np.flatnonzero(chance.fault == way.fault)[0])
    unit = [given[:, :, [way.first]] for given in chance.given]
    if way.first != way.last:
        phase = 2 * np.pi * np.arange(DRAWS) / DRAWS
        last = [given[:, :, [way.last]] for given in chance.given]
        unit = [a * np.cos(phase) + b * np.sin(phase) for a, b in zip(unit, last, strict=True)]
    square = _group_sums([u**2 for u in unit])
    mixed = _group_sums([u * noise for u, noise in zip(unit, chance.noise, strict=True)])
    short = chance.gain[own] - chance.gain - chance.needed[own][:, None]
    more = square[own] - square
    led = _from_then_on(more, mixed[own] - mixed, short)
    alike = more <= TOL_ALIKE * square[own]  # by all of it: chance alone decides, at any size
    led = np.where(alike, np.where(short > 0, 0.0, np.inf), led)
    price = float(products.price[way.fault])
    listed = _from_then_on(square[own], mixed[own], chance.gain[own] - price)
    size = np.maximum(listed, led.max(axis=0))
    return size, (led == size) & (led > listed)


def _from_then_on(square: Array, half: Array, constant: Array) -> Array:
    """From which s on `square` s^2 + 2 `half` s + `constant` is above 0."""
    with np.errstate(divide="ignore", invalid="ignore"):  # of one that is no rival, or the same
        discriminant = half**2 - square * constant
        crossing = (np.sqrt(np.maximum(discriminant, 0.0)) - half) / square
    return np.where(discriminant > 0, np.maximum(crossing, 0.0), 0.0)
