"""Shares of false and of correct findings of the diagnosis, at spot level, with truth.

False accusations: of sessions without a fault, those with any cause listed. Detection, a kind of
fault and a joint: the session itself states what it would notice (detectable) and what it would
tell from every other fault (separable). A fault is put in at 1.5 times the separable size; at that
size, where four of five are named; between 1.5 times the detectable and 1.5 times the separable
one; and at half the separable one. Verdicts: a joint that is
sound, or has one of three faults whose mean is next to nothing, at a tolerance of 0.2°. A step
comes at any pair but the outermost; it is named with its instant (± 2 pairs) and its size (4 u),
and the verdicts on the other joints at 0.2° stay what they were. Limits: nine of ten named at 1.5
times the separable size, and named or among the candidates between, in every cell. At the separable
size and at half of it the shares of all cells together; a single one fails where its count has less
than a chance of 5 % to come anywhere in the table.

    python -m tests.bench.diagnosis.shares [SESSIONS] [SEED] [KIND ...]

With kinds, detection of those alone.
"""

import os
import sys
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from scipy.stats import binom

from tests.bench.cells import seeds as seeds_of
from tests.bench.diagnosis.sessions import Injected, Watched, judged, watched
from tests.bench.diagnosis.verdicts import CASES, TOLERANCE, verdicts
from verify.analysis.diagnosis.detectability import detectable
from verify.analysis.diagnosis.faults import UNIT_SCALES
from verify.analysis.diagnosis.search import FaultProducts
from verify.analysis.diagnosis.steps import beginning_faults, begun, instants
from verify.analysis.joint_errors import ResolvedErrors
from verify.analysis.model import JointErrorModel, visibility
from verify.analysis.verdict import judge_joint

SESSIONS = 100  # with faults; three times as many without
SEED = 20261121
HEALTHY = 3
MOST_FALSE = 0.02
LEVELS = ("1.5 sep", "sep", "between", "0.5 sep")
LEAST_RIGHT, MOST_WRONG = 0.90, 0.02
STATED = 0.80  # share named at the separable size
BY_CHANCE = 0.05  # that a cell of the whole table fails without a reason
LEAST_KEPT = 0.95  # verdicts on other joints after a step
MAX_PAIRS_OFF, MAX_SIGMA_OFF = 2.01, 4.0  # of a step's instant and size
UNMADE = ("beta",)  # a DH table has none to put a fault into
TRIALS = 400


@dataclass(frozen=True)
class Trial:
    """One fault put in, and what was said."""

    kind: str
    joint: int | None
    level: str
    named: bool
    inside: bool  # an entry that is ambiguous
    wrong: bool  # somebody else named
    kept: float  # share of the other joints whose verdict is what it was


def healthy(seed: int) -> list[str]:
    """What is said of a session without a fault."""
    return [f"{c.kind} {c.joint or ''}" for c in judged(watched(seed), None)[1].causes]


def trials(kinds: tuple[str, ...], seed: int) -> list[Trial]:
    """Put every fault, or those of some kinds, into one session, one at a time."""
    case, rng = watched(seed), np.random.default_rng([seed, 1])
    model, found_none, resolved = judged(case, None)
    first = int(rng.choice(instants(model)))
    steps = [begun(model, fault, first) for fault in beginning_faults(model, ())]
    faults = [*steps, *found_none.products.faults]  # the first of a name has its size stated
    every = FaultProducts.of(model, faults, np.ones(len(model.xi), dtype=np.bool_))
    stated = detectable(every).assign(begin=steps[0].begin)
    stated, sound = stated[stated["separable"].notna()], _verdicts(model, resolved)
    found = []
    if kinds:
        stated = stated[stated["kind"].isin(kinds)]
    for _, rows in stated.groupby([stated["kind"], stated["joint"].fillna(0)]):
        usable = rows[~rows["parameter"].astype(str).str.startswith(UNMADE)]
        if len(usable):
            row = usable.iloc[int(rng.integers(len(usable)))]
            found += [_trial(case, row, level, rng, sound) for level in LEVELS]
    return found


def _verdicts(model: JointErrorModel, resolved: ResolvedErrors) -> list[str | None]:
    least = visibility(model).detectable.tolist()
    return [judge_joint(resolved, j, TOLERANCE, d).verdict for j, d in enumerate(least)]


def _trial(
    case: Watched, row: pd.Series, level: str, rng: np.random.Generator, sound: list[str | None]
) -> Trial:
    low, high = 1.5 * float(row["detectable"]), 1.5 * float(row["separable"])
    between = low * (high / low) ** rng.random()
    size = {"1.5 sep": high, "sep": high / 1.5, "between": between, "0.5 sep": high / 3}
    joint = None if pd.isna(row["joint"]) else int(row["joint"])
    sign = 1.0 if row["kind"] == "eccentricity" else float(rng.choice([-1.0, 1.0]))
    fault = Injected(
        kind=str(row["kind"]),
        joint=joint,
        size=sign * size[level] / UNIT_SCALES[str(row["unit"])],
        parameter=None if pd.isna(row["parameter"]) else str(row["parameter"]),
        per_turn=1 if pd.isna(row["per_turn"]) else int(row["per_turn"]),
        phase=float(rng.uniform(0, 2 * np.pi)),
        begin=float(row["begin"]),
    )
    model, diagnosis, resolved = judged(case, fault)
    own = (fault.kind, fault.joint)
    causes = [c for c in diagnosis.causes if c.kind != "ambiguous"]
    right = [c for c in causes if (c.kind, c.joint) == own]
    if fault.kind == "step":
        late = MAX_PAIRS_OFF * float(np.median(np.diff(model.comparison.t)))
        right = [
            c
            for c in right
            if abs((c.fault.begin or 0.0) - fault.begin) < late
            and abs(c.value - fault.size) < MAX_SIGMA_OFF * c.standard_uncertainty
        ]
    unclear = [(k.kind, k.joint) for c in diagnosis.causes for k in c.candidates]
    after = _verdicts(model, resolved)
    kept = [after[j] == v for j, v in enumerate(sound) if j + 1 != fault.joint]
    wrong = any((c.kind, c.joint) != own for c in causes)
    return Trial(*own, level, bool(right), own in unclear, wrong, float(np.mean(kept)))


def accusations(pool: ProcessPoolExecutor, sessions: int, seed: int) -> int:
    """Print what is said of sessions without a fault; 1 where too much."""
    seeds = seeds_of([seed, 1], HEALTHY * sessions)
    message = [causes for causes in pool.map(healthy, seeds) if causes]
    good = len(message) <= MOST_FALSE * len(seeds)
    print(f"without a fault: {len(message)} of {len(seeds)} sessions accuse anybody"
          f"{'' if good else '  FAILS'}{': ' if message else ''}{'; '.join(map(str, message))}",
          flush=True)  # fmt: skip
    return int(not good)


def detection(pool: ProcessPoolExecutor, sessions: int, seed: int, kinds: tuple[str, ...]) -> int:
    """Print the table a kind and joint; return how many cells fail."""
    seeds = seeds_of([seed, 2], sessions)
    cells: dict[tuple[str, int, str], list[Trial]] = defaultdict(list)
    for outcome in pool.map(partial(trials, kinds), seeds):
        for trial in outcome:
            cells[trial.kind, trial.joint or 0, trial.level].append(trial)
    print(f"{'fault':28s} n    1.5 separable   separable  between: named    0.5 separable")
    print(f"{'':28s}       named  wrong    named     or inside  wrong   wrong  named")
    failed, rows = 0, sorted({key[:2] for key in cells})
    rare = BY_CHANCE / (2 * len(rows))
    for kind, joint in rows:
        high, least, between, low = (cells[kind, joint, level] for level in LEVELS)
        named, inside = _share(high, "named"), np.mean([t.named or t.inside for t in between])
        wrong, stated = _share(low, "wrong"), _share(least, "named")
        short = binom.cdf(_count(least, "named"), len(least), STATED) < rare
        many = binom.sf(_count(low, "wrong") - 1, len(low), MOST_WRONG) < rare
        bad = [bool(b) for b in (named < LEAST_RIGHT, short, inside < LEAST_RIGHT, many)]
        failed += sum(bad)
        marks = ["!" if b else " " for b in bad]
        name = f"{kind}, joint {joint}" if joint else kind
        print(f"{name:28s} {len(high):3d}  {named:5.0%}{marks[0]} {_share(high, 'wrong'):5.0%}"
              f"    {stated:5.0%}{marks[1]}    {inside:5.0%}{marks[2]}"
              f"    {_share(between, 'wrong'):5.0%}   {wrong:5.1%}{marks[3]}"
              f" {_share(low, 'named'):5.0%}", flush=True)  # fmt: skip
    for level, what, least_share, most_share in (
        (LEVELS[1], "named", STATED, 1.0), (LEVELS[3], "wrong", 0.0, MOST_WRONG)
    ):  # fmt: skip
        together = [t for key, cell in cells.items() if key[2] == level for t in cell]
        error = np.sqrt(STATED * (1 - STATED) / len(together)) if what == "named" else 0.0
        share = _share(together, what)
        good = least_share - 2 * error <= share <= most_share
        failed += int(not good)
        print(f"all of them at {level}: {what} in {share:.1%}{'' if good else '  FAILS'}")
    steps = [t for key, cell in cells.items() if key[::2] == ("step", LEVELS[0]) for t in cell]
    if not steps:
        return failed
    kept = float(np.mean([t.kept for t in steps]))
    failed += int(kept < LEAST_KEPT)
    print(f"after a step {kept:.1%} of the other joints keep their verdict"
          f"{'' if kept >= LEAST_KEPT else '  FAILS'}", flush=True)  # fmt: skip
    return failed


def _share(cell: list[Trial], what: str) -> float:
    return float(np.mean([getattr(t, what) for t in cell]))


def _count(cell: list[Trial], what: str) -> int:
    return sum(getattr(t, what) for t in cell)


def verdict_shares(pool: ProcessPoolExecutor, count: int, seed: int) -> int:
    """Print the verdicts; return how many lines fail."""
    seeds = seeds_of([seed, 3], count)
    outcomes = list(pool.map(verdicts, seeds))
    failed = 0
    for case, wanted, least in CASES:
        share = float(np.mean([o[case] == wanted for o in outcomes]))
        failed += int(share < least)
        print(f"verdict, {case}: {wanted} in {share:.1%} of {count}"
              f"{'' if share >= least else '  FAILS'}", flush=True)  # fmt: skip
    return failed


def main(sessions: int, seed: int, kinds: tuple[str, ...]) -> int:
    """Print the tables; 1 where a cell fails."""
    with ProcessPoolExecutor(max_workers=os.cpu_count()) as pool:
        failed = 0
        if not kinds:
            failed += verdict_shares(pool, TRIALS, seed)
            failed += accusations(pool, sessions, seed)
        failed += detection(pool, sessions, seed, kinds)
    print("all cells hold" if not failed else f"{failed} cells fail (!)")
    return int(failed > 0)


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SESSIONS
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else SEED
    sys.exit(main(count, seed, tuple(sys.argv[3:])))
