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
from functools import partial

import numpy as np
from scipy.stats import binom

from tests.bench import cells
from tests.support.whole_chain import replicate
from verify.calibration.registration.fixture import P_FALSE_ALARM
from verify.core.records import Array

REPLICATES = 2000
RARE = binom.cdf(86, 100, 0.95)
APART = "apart"
ARMS = 2


def holds(z: Array) -> bool:
    """Whether a cell has as many hits as it should."""
    hits, count = int(np.sum(np.abs(z) <= cells.WITHIN)), len(z)
    if count >= REPLICATES:
        return cells.LOW <= hits / count <= cells.HIGH
    return bool(binom.cdf(hits, count, 0.95) > RARE)


def report(group: str, outcomes: list[cells.Checked]) -> int:
    """Print a group's lines; return how many of its cells fail."""
    ratio, low, high = cells.d2_ratio(outcomes)
    failed = int(not low <= ratio <= high)
    print(f"{group}: d²/dof {ratio:.3f} (99 %: {low:.3f} to {high:.3f}){'  FAILS' * failed}")
    errors = cells.by_name(outcomes)
    if errors:
        print(f"  {'pooled':26s} {cells.share(np.concatenate(list(errors.values()))):.1%}")
    for name, z in errors.items():
        good = len(z) < len(outcomes) or holds(z)  # a coefficient seldom left free is no cell
        failed += int(not good)
        hits = int(np.sum(np.abs(z) <= cells.WITHIN))
        print(f"  {name:26s} {hits / len(z):6.1%}  {hits} of {len(z)}{'' if good else '  FAILS'}")
    return failed


def main(count: int, seeds: tuple[int, ...], pixels: bool) -> int:
    """Print every cell; 1 where one fails."""
    failed = 0
    # the cross terms are dropped too where it is cheap
    work = partial(replicate, pixels=pixels, apart=not pixels)
    for seed in seeds:
        start = time.perf_counter()
        outcomes = cells.replicates(work, seed, count)
        spent = time.perf_counter() - start
        level = "through pixels" if pixels else "at spot level"
        refused = count - len(outcomes)
        print(f"seed {seed}, {count} replicates {level}, {spent / count:.1f} s each")
        print(f"{refused or 'none'} refused")
        failed += int(refused > binom.isf(0.005, count, ARMS * P_FALSE_ALARM))
        for group in outcomes[0]:
            wrong = report(group, [o[group] for o in outcomes])
            if not group.endswith(APART):
                failed += wrong
    return cells.conclude(failed)


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    numbers = [int(a) for a in sys.argv[1:] if a != "--pixels"]
    chosen = (numbers[1],) if len(numbers) > 1 else cells.SEEDS
    sys.exit(main(numbers[0] if numbers else REPLICATES, chosen, "--pixels" in sys.argv))
