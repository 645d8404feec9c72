"""Agreement of the budget with Monte Carlo where it states to hold within 5 %; both arms.

Visits are drawn all over the joints' ranges, near singularities too. Of each session the check as
`verify run` makes it (200 draws) says where linear propagation holds; then thousands of other draws
tell. Printed are the largest and the 95th percentile of |drawn / linear - 1| where it is said to
hold, how much is said to hold, and how much of the rest truly fails.

    python -m tests.bench.monte_carlo [SESSIONS] [SEED]
"""

import sys
from collections.abc import Iterator

import numpy as np

from tests.support.spotted import HOMES, SPREAD, spotted
from verify.analysis.uncertainty.monte_carlo import MAX_RATIO_ERROR
from verify.core.records import Array

SESSIONS = 10
SEED = 20261123
VISITS = 10
DRAWS = 10_000
NEAR = np.deg2rad(1.5)  # of joint 5 about its singularity, in every fifth visit


def lines(sessions: int = SESSIONS, seed: int = SEED) -> Iterator[str]:
    """Compare a session at a time, for either arm."""
    for arm in HOMES:
        found = [session(arm, seed + number) for number in range(sessions)]
        holds, apart = (np.concatenate(parts).ravel() for parts in zip(*found, strict=True))
        chance = 3 / np.sqrt(2 * DRAWS)
        inside = float(np.mean(apart[holds] <= MAX_RATIO_ERROR + chance))
        failing = np.mean(apart[~holds] > MAX_RATIO_ERROR - chance) if (~holds).any() else np.nan
        largest, most = np.max(apart[holds]), np.quantile(apart[holds], 0.95)
        yield (
            f"{arm}: said to hold for {holds.mean():.1%} of {len(holds)} errors; there drawn and "
            f"linear differ by {largest:.1%} at most, {most:.1%} in 95 %, and by 5 % or less in "
            f"{inside:.2%} (three standard deviations of chance, {chance:.1%}, allowed for); of "
            f"the rest {failing:.0%} differ by more"
        )


def session(arm: str, seed: int) -> tuple[Array, Array]:
    """What is said to hold (m, j), and |drawn / linear - 1| by many other draws (m, j)."""
    rng = np.random.default_rng(seed)
    q = HOMES[arm] + 1.5 * SPREAD * rng.uniform(-1, 1, (VISITS, 6))
    q[::5, 4] = NEAR * rng.uniform(-1, 1, len(q[::5]))
    q[0] = HOMES[arm]  # where the robot is placed before the cameras by
    made = spotted(arm, q, seed, larger=float(rng.uniform(0.5, 2.0)))
    found, many = made.check(), made.check(draws=DRAWS, seed=seed)
    apart = np.abs(many.scatter / many.linear - 1)
    return found.holds, np.where(np.isnan(apart), np.inf, apart)


if __name__ == "__main__":
    for line in lines(*(int(a) for a in sys.argv[1:3])):
        print(line, flush=True)
