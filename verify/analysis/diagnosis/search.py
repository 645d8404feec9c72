"""Which set of faults explains the errors best: products of columns, and a search among sets.

Everything needed of a session is the products of what registration, clock and stated doubts leave
of the faults' columns and of the errors; any set is then solved in a few small matrices.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, combinations, islice

import numpy as np

from verify.analysis.diagnosis.faults import Fault
from verify.analysis.least_squares import residual_products
from verify.analysis.model import DETECTION_SIGMA, JointErrorModel
from verify.core.records import Array, Flags, Index
from verify.core.statistics import chi2_isf

P_FALSE_ALARM = 5e-3  # chance of accusing anybody at all where nothing is wrong
P_FALSE_BEGIN = 1e-3  # likewise of what begins in the session, whichever it is and whenever
MIN_SHARE = 0.01  # of the misfit: what explains less is no cause worth a name
TOL_RANK = 1e-8  # of a normalised Gram matrix: closer columns cannot be told apart at all
BEAM_WIDTH = 16  # sets that are carried on, of each size
EXCHANGE_WIDTH = 4  # likewise, when a member is exchanged
MAX_EXCHANGES = 3  # of a session that nothing explains there is no end soon
MAX_EXCHANGED = 3  # members for which a single one may stand
TOL_COST = 1e-9  # rounding
MAX_CAUSES = 8
# kinds of which all faults together are a rival: where the arm swings little they look alike
JOINT_RIVALS = {"base_drift": ("drift",), "camera_drift": ("drift", "base_drift")}
MAX_SIZES_WITHOUT_GAIN = 2  # sizes without a better set after which none is expected

FaultSet = tuple[int, ...]


@dataclass(frozen=True)
class FaultProducts:
    """What is left of c faults with p columns in all, and of the errors."""

    faults: list[Fault]
    gram: Array  # (p, p), of columns scaled to length 1
    moment: Array  # (p,)
    power: float
    scale: Array  # (p,), length of the columns before
    rows: int  # what the errors were, in number
    places: list[Index]  # columns of each fault
    visible: Flags  # (c,), something of the fault is left
    price: Array  # (c,), in chi-squared, of listing a fault

    @classmethod
    def of(cls, model: JointErrorModel, faults: list[Fault], kept: Flags) -> "FaultProducts":
        """Project out what was fitted and stated; `kept` (r,) are the rows to take."""
        parts = [*(f.columns for f in faults), model.xi[:, None]]
        if not kept.all():
            parts = [part[kept] for part in parts]
        products = residual_products(model.fitted[kept], model.prior[kept], parts)
        whole = np.concatenate([np.zeros(0), *(np.linalg.norm(p, axis=0) for p in parts[:-1])])
        scale = np.where(whole > 0, whole, 1.0)
        size = np.append(scale, 1.0)
        products /= np.outer(size, size)
        places = _places(faults)
        gram = products[:-1, :-1].copy()
        least, narrowest = np.empty(len(faults)), np.empty(len(faults))
        for which, at in _group_by_columns(places):
            least[which] = np.linalg.eigvalsh(gram[at[:, :, None], at[:, None, :]])[:, 0]
            narrowest[which] = scale[at].min(axis=1)
        known = np.sqrt(np.maximum(least, 0.0)) * narrowest
        sizes = np.array([f.largest.min() for f in faults])
        visible = (least > TOL_RANK) & (known * sizes > DETECTION_SIGMA)
        rows = int(kept.sum())
        return cls(
            faults, gram, products[:-1, -1].copy(), float(products[-1, -1]), scale, rows, places,
            visible, _penalties(faults, visible, rows),
        )  # fmt: skip

    def doubted(self, misfit: float) -> "FaultProducts":
        """The same with errors that are `misfit` times as likely as stated, as variances go."""
        root = np.sqrt(misfit)
        return replace(
            self, moment=self.moment / root, power=self.power / misfit, scale=self.scale / root
        )

    def subset(self, chosen: list[int]) -> "FaultProducts":
        """The same of some faults alone, each at the price that it has among all."""
        at, kept = self.columns(tuple(chosen)), np.array(chosen, dtype=np.int64)
        faults = [self.faults[i] for i in chosen]
        return replace(
            self, faults=faults, gram=self.gram[np.ix_(at, at)], moment=self.moment[at],
            scale=self.scale[at], places=_places(faults), visible=self.visible[kept],
            price=self.price[kept],
        )  # fmt: skip

    def of_kind(self, kind: str) -> FaultSet:
        """The visible faults of a kind."""
        every = enumerate(self.faults)
        return tuple(i for i, f in every if f.kind == kind and self.visible[i])

    @cached_property
    def largest(self) -> Array:
        """Largest coefficients that may be told, (p,), SI."""
        return np.concatenate([np.zeros(0), *(f.largest for f in self.faults)])

    def columns(self, chosen: FaultSet) -> Index:
        """Places of the columns of a set."""
        return np.concatenate([self.places[i] for i in chosen] or [np.zeros(0, dtype=np.int64)])

    def chi2(self, chosen: FaultSet) -> float:
        """Misfit with these faults fitted; infinite where they cannot be told apart.

        So it is where one would be larger than may be told: two that cancel each other fit the
        readings' noise, which their columns hold, too.
        """
        at = self.columns(chosen)
        normal = self.gram[np.ix_(at, at)]
        size = np.sqrt(np.diag(normal))
        if len(at) and np.linalg.eigvalsh(normal / np.outer(size, size))[0] < TOL_RANK:
            return float("inf")
        solution = np.linalg.solve(normal, self.moment[at]) if len(at) else self.moment[at]
        if np.any(np.abs(solution) > self.largest[at] * self.scale[at]):
            return float("inf")
        return self.power - float(solution @ self.moment[at])

    def estimate(self, chosen: FaultSet, i: int) -> tuple[Array, Array]:
        """Coefficients (p,) of one of a set and their covariance, SI, all fitted together."""
        at = self.columns(chosen)
        inverse = np.linalg.inv(self.gram[np.ix_(at, at)])
        own = np.isin(at, self.places[i])
        scale = self.scale[self.places[i]]
        return (inverse @ self.moment[at])[own] / scale, inverse[np.ix_(own, own)] / np.outer(
            scale, scale
        )

    def added(self, chosen: FaultSet) -> Array:
        """By how much each fault would lower the misfit beside a set, (c,); 0 where it cannot."""
        at, lowered = self.columns(chosen), np.zeros(len(self.faults))
        beside = np.column_stack([self.gram[at], self.moment[at]])
        try:
            root = np.linalg.cholesky(self.gram[np.ix_(at, at)])
        except np.linalg.LinAlgError:  # it cannot be told apart itself
            return lowered
        half = np.linalg.inv(root) @ beside  # small; a triangular solver takes ten times as long
        for which, columns, gram in self.visible_groups:
            own = half[:, columns].transpose(1, 2, 0)
            block = gram - own @ own.swapaxes(1, 2)
            part = self.moment[columns] - own @ half[:, -1]
            told = _least_eigenvalue(block) > TOL_RANK
            solved = _solve_blocks(block[told], part[told])
            lowered[which[told]] = np.sum(solved * part[told], axis=1)
        lowered[list(chosen)] = 0.0
        return lowered

    @cached_property
    def visible_groups(self) -> list[tuple[Index, Index, Array]]:
        """Visible faults (k,) with as many columns as each other, f.

        With them the columns (k, f), and their products with each other (k, f, f).
        """
        kept = ((which, at, self.visible[which]) for which, at in _group_by_columns(self.places))
        groups = [(which[seen], at[seen]) for which, at, seen in kept if seen.any()]
        return [(which, at, self.gram[at[:, :, None], at[:, None, :]]) for which, at in groups]

    def schwarz(self, chosen: FaultSet) -> float:
        """Schwarz's criterion, by which sets are compared with each other."""
        return self.chi2(chosen) + sum(self.faults[i].schwarz(self.rows) for i in chosen)

    def cost(self, chosen: FaultSet) -> float:
        """The criterion: misfit and the prices of what is listed."""
        return self.chi2(chosen) + float(self.price[list(chosen)].sum())


def _places(faults: list[Fault]) -> list[Index]:
    """Columns of each fault, one after the other."""
    ends = np.cumsum([f.freedom for f in faults])
    return [np.arange(end - f.freedom, end) for f, end in zip(faults, ends, strict=True)]


def _least_eigenvalue(block: Array) -> Array:
    """Of symmetric matrices (k, f, f); most are single numbers, or two by two."""
    if block.shape[1] == 1:
        return np.asarray(block[:, 0, 0])
    if block.shape[1] == 2:
        one, other, mixed = block[:, 0, 0], block[:, 1, 1], block[:, 0, 1]
        return np.asarray((one + other) / 2 - np.hypot((one - other) / 2, mixed))
    return np.asarray(np.linalg.eigvalsh(block)[:, 0])


def _solve_blocks(block: Array, part: Array) -> Array:
    """Solve (k, f, f) for (k, f)."""
    if block.shape[1] == 1:
        return np.asarray(part / block[:, 0])
    return np.asarray(np.linalg.solve(block, part[:, :, None])[:, :, 0])


def _group_by_columns(
    places: list[Index],
) -> list[tuple[Index, Index]]:
    """Faults (k,) with as many columns as each other, f, and the columns (k, f)."""
    freedom = np.array([len(place) for place in places])
    groups = [np.flatnonzero(freedom == each) for each in np.unique(freedom).tolist()]
    return [(which, np.array([places[i] for i in which])) for which in groups]


def _penalties(faults: list[Fault], visible: Flags, rows: int) -> Array:
    """What a fault has to lower chi-squared by to be listed.

    More than Schwarz's criterion asks, and more than chance gives the best of them all once in
    1 / P_FALSE_ALARM sessions (Bonferroni), the best instant of those that begin in the session
    once in 1 / P_FALSE_BEGIN; and in a long session, where the smallest effect that nobody stated
    becomes significant, a share of the misfit.
    """
    begins = np.array([f.begin is not None for f in faults])
    instants = np.array([f.instants for f in faults])
    kinds = len({f.name for f in faults if f.begin is not None})
    lasting = max(int((visible & ~begins).sum()), 1)
    each = np.where(begins, P_FALSE_BEGIN / (max(kinds, 1) * instants), P_FALSE_ALARM / lasting)
    chance = np.asarray(chi2_isf(each, np.array([f.freedom for f in faults])), dtype=np.float64)
    schwarz = np.array([f.schwarz(rows) for f in faults])
    prices: Array = np.maximum.reduce([chance, schwarz, np.full(len(faults), MIN_SHARE * rows)])
    return prices


def search_faults(products: FaultProducts) -> FaultSet:
    """Find the set of faults of least cost.

    A beam search: sets grow by one fault, the best BEAM_WIDTH of each size are kept, so that two
    faults that together resemble a third one are still found. Then members are exchanged: one of
    many coefficients absorbs the first of several faults, and up to MAX_EXCHANGED that came one by
    one may be what a single one explains.
    """
    least, best = _grow(products, (), (), BEAM_WIDTH)
    for _ in range(MAX_EXCHANGES):
        counts = range(1, min(len(best), MAX_EXCHANGED) + 1)  # one, then two together, and so on
        for removed in chain.from_iterable(combinations(best, count) for count in counts):
            without = tuple(k for k in best if k not in removed)
            width = EXCHANGE_WIDTH if len(removed) == 1 else 1
            cost, chosen = _grow(products, without, removed, width)
            if cost < least - TOL_COST:
                best, least = chosen, cost
                break
        else:
            break
    return best


def against_drifts(products: FaultProducts, best: FaultSet) -> FaultSet:
    """The set of least cost, or the best one without a drift of the base.

    That and drifts of joints look alike where the arm swings little. Each joint pays for being one
    of many faults, the base for being one: so Schwarz's criterion tells which it is.
    """
    bases = products.of_kind("base_drift")
    if not set(bases) & set(best):
        return best
    _, rival = _grow(products, (), bases, BEAM_WIDTH)
    return min(best, rival, key=products.schwarz)


def _grow(
    products: FaultProducts, start: FaultSet, barred: FaultSet, width: int
) -> tuple[float, FaultSet]:
    """The best set that a beam of such width finds from one on, and its cost; without the barred.

    It ends MAX_SIZES_WITHOUT_GAIN sizes after the last better set.
    """
    least, best = products.cost(start), start
    beam, idle = [(least, best)], 0
    while len(beam[0][1]) < MAX_CAUSES and idle < MAX_SIZES_WITHOUT_GAIN:
        beam = _extend_sets(products, beam, barred, width)
        if not beam:
            break
        idle += 1
        cost, chosen = min(beam)
        if cost < least:
            best, least, idle = chosen, cost, 0
    return least, best


def _extend_sets(
    products: FaultProducts, beam: list[tuple[float, FaultSet]], barred: FaultSet, width: int
) -> list[tuple[float, FaultSet]]:
    """The best sets with one fault more than those of known cost, and what they cost.

    Large errors leave many sets of which a member is larger than may be told: they keep no others
    from the beam.
    """
    found: dict[FaultSet, float] = {}
    for cost, chosen in beam:
        lowered = products.added(chosen)
        lowered[list(barred)] = 0.0
        for i in np.argsort(products.price - lowered)[:width].tolist():
            if lowered[i] > 0:
                found[tuple(sorted((*chosen, i)))] = cost - lowered[i] + float(products.price[i])
    costs = ((products.cost(c), c) for c in sorted(found, key=lambda c: found[c]))
    return list(islice((one for one in costs if np.isfinite(one[0])), width))
