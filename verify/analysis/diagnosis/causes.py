"""Causes as they are told: a fault that the data single out, or several they cannot tell apart."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.diagnosis.faults import Fault, Name, fault_figures
from verify.analysis.diagnosis.search import JOINT_RIVALS, FaultProducts, FaultSet
from verify.core.records import Array

MIN_ADVANTAGE = 15.0  # in chi-squared over every rival with as many coefficients
MIN_BIC_ADVANTAGE = 10.0  # over rivals with more or fewer, by Schwarz's criterion
# What would tell two faults apart, by the first kind that either has.
SEPARATING_MOTIONS = (
    ("geometry", "other_postures"), ("camera_drift", "other_distances"),
    ("base_drift", "other_postures"), ("base_moved", "independent_registration"),
    ("led_body_slipped", "independent_registration"), ("camera_turned", "other_distances"),
    ("clock_drift", "longer_record"), ("drift", "return_to_start"), ("step", "return_to_start"),
    ("camera_skew", "varied_speeds"), ("clock", "varied_speeds"), ("latency", "varied_speeds"),
    ("backlash", "two_sided_stops"), ("compliance", "lever_both_sides"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class CauseCandidate:
    """A fault that could be a cause: what it would be, and how much worse it fits."""

    fault: Fault
    value: float  # SI
    standard_uncertainty: float
    advantage: float  # Schwarz's criterion with it in the cause's place, less with the cause

    @property
    def kind(self) -> str:
        """Kind of the fault."""
        return self.fault.kind

    @property
    def joint(self) -> int | None:
        """Joint of the fault, from 1; None of a common one."""
        return self.fault.joint


@dataclass(frozen=True, slots=True)
class Cause:
    """A fault that the data single out, or several that they cannot tell apart. SI units."""

    kind: str  # of a fault, or ambiguous
    joint: int | None
    unit: str
    value: float
    standard_uncertainty: float
    explains: float
    fault: Fault
    details: dict[str, float]  # rad: phase of an eccentricity, turn of a displacement
    runner_up: CauseCandidate | None
    candidates: tuple[CauseCandidate, ...] = ()
    motion: str | None = None  # that would tell the candidates apart
    joints: tuple[int, ...] = ()  # that would have to make it
    waves: tuple[int, ...] = ()  # numbers a turn of an eccentricity that the data do not tell apart


def required_advantage(products: FaultProducts) -> Array:
    """By how much chi-squared with rival k in i's place must exceed that with i, (c, c)."""
    simpler = _bic_penalty(products)
    return np.where(simpler == 0, MIN_ADVANTAGE, MIN_BIC_ADVANTAGE - simpler)


def _bic_penalty(products: FaultProducts) -> Array:
    """What Schwarz's criterion holds against rival k for its parameters, less those of i."""
    price = np.array([fault.schwarz(products.rows) for fault in products.faults])
    simpler: Array = price - price[:, None]
    return simpler


def build_cause(products: FaultProducts, best: FaultSet, i: int) -> Cause:
    """Tell one member of the best set, with the rivals that come close."""
    fault, rest = products.faults[i], tuple(k for k in best if k != i)
    value, uncertainty, details = fault_figures(fault, *products.estimate(best, i))
    without, least = products.chi2(rest), products.chi2(best)
    waves = _other_waves(products, best, i)
    if waves:  # no phase is that of all, and the value is uncertain by which it is
        details, uncertainty = {}, _spread(products, rest, waves, value)
    others = _rivals(products, best, i)
    needed = required_advantage(products)[i]
    close = [(k, worse) for k, worse in others if worse < needed[k]]
    # what fits not half as well is kept for the record of the margin alone, not as a suspect
    suspects = [(k, worse) for k, worse in close if worse < (without - least) / 2] or close[:1]
    candidates = [CauseCandidate(fault, value, uncertainty, 0.0)]
    candidates += [_candidate(products, best, i, k, worse) for k, worse in suspects]
    candidates += _contesting(products, best, i)
    unclear = len(candidates) > 1
    motion, joints = separating_motion(candidates) if unclear else (None, ())
    return Cause(
        kind="ambiguous" if unclear else fault.kind,
        joint=None if unclear else fault.joint,
        unit=fault.unit,
        value=value,
        standard_uncertainty=uncertainty,
        explains=1 - least / without if without > 0 else 0.0,
        fault=fault,
        details=details,
        runner_up=_candidate(products, best, i, *others[0]) if others else None,
        candidates=_first_by_name(candidates) if unclear else (),
        motion=motion,
        joints=joints,
        waves=tuple(sorted(products.faults[k].per_turn or 1 for k in waves)),
    )


def _contesting(products: FaultProducts, best: FaultSet, i: int) -> list[CauseCandidate]:
    """What creeps or drifts and explains as much as i by all faults of its kind together.

    By how well they fit alone: that their coefficients are fewer makes several joints that drift at
    once no likelier than one tripod that sinks, nor a camera that turns. A joint's drift beside a
    camera may be what the base makes up for as well: the first axis turns as a base does.
    """
    kind, found = products.faults[i].kind, []
    own, drifts = {*products.of_kind(kind)}, {*products.of_kind("drift")}
    several = kind == "drift" and len(own & {*best}) > 1
    for other in ("base_drift",) if several else JOINT_RIVALS.get(kind, ()):
        rest = ({*best} - own, {*best} - own - drifts)
        sets = (tuple(sorted(part | {*products.of_kind(other)})) for part in rest)
        rival = min(sets, key=products.chi2)
        if products.chi2(rival) - products.chi2(best) >= MIN_ADVANTAGE:
            continue
        worse = products.schwarz(rival) - products.schwarz(best)
        for k in sorted({*rival} - {*best}):
            value, u, _ = fault_figures(products.faults[k], *products.estimate(rival, k))
            found.append(CauseCandidate(products.faults[k], value, u, worse))
    return found


def _other_waves(products: FaultProducts, best: FaultSet, i: int) -> dict[int, float]:
    """Waves of a joint that explain the data alike, and how much worse than i; empty: i alone."""
    fault, rest = products.faults[i], tuple(k for k in best if k != i)
    if fault.kind != "eccentricity":
        return {}
    lowered = products.added(rest)
    close = {
        k: max(float(lowered[i] - lowered[k]), 0.0)
        for k, other in enumerate(products.faults)
        if other.name == fault.name and k not in rest and lowered[i] - lowered[k] < MIN_ADVANTAGE
    }
    return close if len(close) > 1 else {}


def _spread(
    products: FaultProducts, rest: FaultSet, waves: dict[int, float], value: float
) -> float:
    """Standard uncertainty of a value about which waves differ, each as likely as it fits."""
    weights = np.exp([-worse / 2 for worse in waves.values()])
    sizes = [fault_figures(products.faults[k], *products.estimate((*rest, k), k)) for k in waves]
    square = [u**2 + (size - value) ** 2 for size, u, _ in sizes]
    return float(np.sqrt(np.average(square, weights=weights)))


def _rivals(products: FaultProducts, best: FaultSet, i: int) -> list[tuple[int, float]]:
    """Faults of another name that fit beside the others of a set, and how much worse than i."""
    rest = tuple(k for k in best if k != i)
    without, least = products.chi2(rest), products.chi2(best)
    lowered = products.added(rest)
    found = [
        (k, without - float(lowered[k]) - least)
        for k, fault in enumerate(products.faults)
        if k not in best and lowered[k] > 0 and fault.name != products.faults[i].name
    ]
    simpler = _bic_penalty(products)[i].tolist()
    return sorted(found, key=lambda entry: entry[1] + simpler[entry[0]])


def _candidate(
    products: FaultProducts, best: FaultSet, i: int, k: int, worse: float
) -> CauseCandidate:
    rest = tuple(other for other in best if other != i)
    value, uncertainty, _ = fault_figures(products.faults[k], *products.estimate((*rest, k), k))
    return CauseCandidate(
        products.faults[k], value, uncertainty, worse + float(_bic_penalty(products)[i, k])
    )


def merge_ambiguous(causes: list[Cause]) -> list[Cause]:
    """Unite what cannot be told apart in one entry with all its candidates."""
    unclear = [c for c in causes if c.candidates]
    if len(unclear) < 2:
        return causes
    candidates = _first_by_name([k for c in unclear for k in c.candidates])
    motion, joints = separating_motion(candidates)
    largest = max(unclear, key=lambda c: c.explains)
    united = replace(largest, candidates=candidates, motion=motion, joints=joints)
    return [*(c for c in causes if not c.candidates), united]


def _first_by_name(candidates: Iterable[CauseCandidate]) -> tuple[CauseCandidate, ...]:
    """The first of each name."""
    found: dict[Name, CauseCandidate] = {}
    for candidate in candidates:
        found.setdefault(candidate.fault.name, candidate)
    return tuple(found.values())


def separating_motion(candidates: Sequence[CauseCandidate]) -> tuple[str, tuple[int, ...]]:
    """The motion that would tell candidates apart, and the joints that have to make it."""
    joints = tuple(sorted({c.joint for c in candidates if c.joint is not None}))
    kinds = {c.kind for c in candidates}
    for kind, motion in SEPARATING_MOTIONS:
        if kind in kinds:
            return motion, joints
    if "dh" in kinds or len(joints) > 1:
        return "other_postures", joints
    return "wider_swing", joints
