"""Are the claimed uncertainties true at the end of the whole chain? One seed a replicate.

Boards are simulated, a rig is calibrated from them, a robot registered in it by a fixture, a
session of a healthy arm measured with both. A cell is one parameter of the rig, one coordinate of
the robot's base, or one joint's mean error: the share of replicates whose ±1.96 u holds the truth.
With 2,000 replicates it must be 93 to 97 %; with fewer a cell fails where a true 95 % would give
so few hits as seldom as 86 of 100. The mean of d² over its degrees of freedom must lie within the
99 % interval of chi²: of the rig, of the base by itself and given the rig, of the joints together.
"Means apart" is what would be stated if base and cameras were taken as independent: it is there to
fail. Nothing is wrong with any replicate; of those that are refused all the same there may be no
more than the registration's own false alarms, one in a thousand an arm, make likely.

    python -m tests.bench.whole_chain [REPLICATES] [SEED] [--pixels]
"""

import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy.stats import binom, chi2

from tests.support.whole_chain import Checked, replicate
from verify.calibration.registration.fixture import P_FALSE_ALARM
from verify.core.records import Array
from verify.errors import InputError

REPLICATES = 2000
SEEDS = (20261121, 20270101)  # fixed beforehand; the second set is the check of the first
WITHIN = 1.96
MANY, LOW, HIGH = 2000, 0.93, 0.97
RARE = binom.cdf(86, 100, 0.95)
APART = "apart"
ARMS = 2


def attempt(seed: int, pixels: bool) -> dict[str, Checked] | str:
    """One replicate, or why it was refused; the cross terms are dropped too where it is cheap."""
    try:
        return replicate(seed, pixels, apart=not pixels)
    except InputError as error:
        return f"refused, replicate's seed {seed}: {error}"


def study(replicates: int, seed: int, pixels: bool) -> tuple[list[dict[str, Checked]], list[str]]:
    """All replicates of one seed, on all cores, and what was refused."""
    seeds = np.random.SeedSequence(seed).generate_state(replicates).tolist()
    with ProcessPoolExecutor(max_workers=os.cpu_count()) as pool:
        outcomes = list(pool.map(attempt, seeds, [pixels] * replicates))
    refused = [o for o in outcomes if isinstance(o, str)]
    return [o for o in outcomes if not isinstance(o, str)], refused


def d2_ratio(outcomes: list[Checked]) -> tuple[float, float, float]:
    """Sum of d² over the sum of its degrees of freedom, and the 99 % interval of that."""
    degrees = sum(o.degrees for o in outcomes)
    low, high = (float(chi2.ppf(p, degrees)) / degrees for p in (0.005, 0.995))
    return sum(o.d2 for o in outcomes) / degrees, low, high


def by_name(outcomes: list[Checked]) -> dict[str, Array]:
    """Normalised errors of every parameter over the replicates that have it."""
    errors: dict[str, list[float]] = {}
    for outcome in outcomes:
        for name, z in zip(outcome.names, outcome.z.tolist(), strict=True):
            errors.setdefault(name, []).append(z)
    return {name: np.array(z) for name, z in errors.items()}


def holds(z: Array) -> bool:
    """Whether a cell has as many hits as it should."""
    hits, count = int(np.sum(np.abs(z) <= WITHIN)), len(z)
    if count >= MANY:
        return LOW <= hits / count <= HIGH
    return bool(binom.cdf(hits, count, 0.95) > RARE)


def report(group: str, outcomes: list[Checked]) -> int:
    """Print a group's lines; return how many of its cells fail."""
    ratio, low, high = d2_ratio(outcomes)
    failed = int(not low <= ratio <= high)
    print(f"{group}: d²/dof {ratio:.3f} (99 %: {low:.3f} to {high:.3f}){'  FAILS' * failed}")
    cells = by_name(outcomes)
    if cells:
        pooled = np.concatenate(list(cells.values()))
        print(f"  {'pooled':26s} {np.mean(np.abs(pooled) <= WITHIN):.1%}")
    for name, z in cells.items():
        good = len(z) < len(outcomes) or holds(z)  # a coefficient seldom left free is no cell
        failed += int(not good)
        hits = int(np.sum(np.abs(z) <= WITHIN))
        print(f"  {name:26s} {hits / len(z):6.1%}  {hits} of {len(z)}{'' if good else '  FAILS'}")
    return failed


def main(replicates: int, seeds: tuple[int, ...], pixels: bool) -> int:
    """Print every cell; 1 where one fails."""
    failed = 0
    for seed in seeds:
        start = time.perf_counter()
        outcomes, refused = study(replicates, seed, pixels)
        spent = time.perf_counter() - start
        level = "through pixels" if pixels else "at spot level"
        print(f"seed {seed}, {replicates} replicates {level}, {spent / replicates:.1f} s each")
        print("\n".join(refused) or "none refused")
        failed += int(len(refused) > binom.isf(0.005, replicates, ARMS * P_FALSE_ALARM))
        for group in outcomes[0]:
            wrong = report(group, [o[group] for o in outcomes])
            if not group.endswith(APART):
                failed += wrong
    print("all cells hold" if not failed else f"{failed} cells fail")
    return int(failed > 0)


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    numbers = [int(a) for a in sys.argv[1:] if a != "--pixels"]
    chosen = (numbers[1],) if len(numbers) > 1 else SEEDS
    sys.exit(main(numbers[0] if numbers else REPLICATES, chosen, "--pixels" in sys.argv))
