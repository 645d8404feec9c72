"""Are the claimed uncertainties true? The random part, by simulated sessions through pixels.

The unit is the session. A cell (arm, joint) is the mean over sessions of the share of pairs whose
±1.96 u holds the true angle: it must lie within 93 to 97 %, with a standard error between
sessions of at most 0.7 %. Near-singular pairs are left out by the tool's own flag.

    python -m tests.bench.coverage [SESSIONS] [SEED]
"""

import os
import sys
from functools import partial

import numpy as np

from tests.bench.cells import HIGH, LOW, SEEDS, WITHIN, conclude, replicates
from tests.support.random_scenarios import random_scenario
from tests.support.simulated import in_memory
from verify.analysis.session import analyse
from verify.core.records import Array

ARMS = ("iust_6r", "rv_3sd_melfa")
SESSIONS = 100
PAIRS = 40
STANDARD_ERROR = 0.007


def session_shares(arm: str, seed: int) -> tuple[Array, float, float]:
    """Share of pairs that hold the truth, a joint; share left out as singular; as not measured."""
    rng = np.random.default_rng(seed)
    session = in_memory(random_scenario(rng, arm, leds=int(rng.integers(3, 6)), pairs=PAIRS))
    frames = analyse(session).tables["frames"]
    truth = np.rad2deg(session.truth)
    joints = truth.shape[1]
    measured = frames[[f"q{j + 1}_measured_deg" for j in range(joints)]].to_numpy()
    u = frames[[f"q{j + 1}_u_deg" for j in range(joints)]].to_numpy()
    hit = np.abs(measured - truth) <= WITHIN * u
    seen = (frames["status"] == "measured").to_numpy()
    clear = seen & (frames["ambiguous_joints"] == "").to_numpy()
    shares = hit[clear].mean(axis=0) if clear.any() else np.full(joints, np.nan)
    return shares, 1 - clear.sum() / max(int(seen.sum()), 1), 1 - float(seen.mean())


def main(sessions: int, seeds: tuple[int, ...]) -> int:
    """Print every cell; 1 where one fails."""
    failed = 0
    for seed in seeds:
        for arm in ARMS:
            outcomes = replicates(partial(session_shares, arm), seed, sessions)
            shares, left_out, not_measured = map(np.array, zip(*outcomes, strict=True))
            share, count = np.nanmean(shares, axis=0), np.sum(~np.isnan(shares), axis=0)
            error = np.nanstd(shares, axis=0, ddof=1) / np.sqrt(count)
            good = (share >= LOW) & (share <= HIGH) & (error <= STANDARD_ERROR)
            failed += int(np.sum(~good))
            print(f"{arm}, seed {seed}, {sessions} sessions of {PAIRS} pairs; left out as singular "
                  f"{left_out.mean():.1%}, not measured {not_measured.mean():.1%}")  # fmt: skip
            for j in range(len(share)):
                message = "" if good[j] else "  FAILS"
                print(f"  q{j + 1}  {share[j]:.1%} ± {error[j]:.1%}{message}")
    return conclude(failed)


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SESSIONS
    chosen = (int(sys.argv[2]),) if len(sys.argv) > 2 else SEEDS
    sys.exit(main(count, chosen))
