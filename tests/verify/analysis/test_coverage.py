"""The claimed uncertainties are true: a small share of what `make bench-coverage` runs in full.

From boards to mean joint errors in one seed, small: metrology.md section 5 (b) and (c).
"""

import numpy as np
import pytest

from tests.bench import coverage
from tests.bench.cells import WITHIN, Checked, d2_ratio
from tests.bench.whole_chain import holds
from tests.support.whole_chain import ARMS, replicate

pytestmark = pytest.mark.slow

SESSIONS = 5  # an arm
PAIRS = 20  # a session
SEED = 20260131
# A session's share of hits scatters by some 7 % (so that 100 sessions know a cell to 0.7 %), and
# its six joints are worth two or three: ten sessions know the mean to about 1.5 %.
LOW, HIGH = 0.905, 0.99


def test_joint_intervals_have_their_stated_coverage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coverage, "PAIRS", PAIRS)
    seeds = np.random.SeedSequence(SEED).generate_state(SESSIONS).tolist()
    found = [[coverage.session_shares(arm, seed) for seed in seeds] for arm in coverage.ARMS]
    shares = np.array([[session[0] for session in of_arm] for of_arm in found])
    assert LOW < np.nanmean(shares) < HIGH
    # no joint of either arm is left out of that: five sessions know one to about 3 %
    assert np.nanmean(shares, axis=1).min() > 0.82
    for of_arm in found:
        assert np.mean([singular for _, singular, _ in of_arm]) < 0.1
        assert np.mean([lost for _, _, lost in of_arm]) < 0.02


REPLICATES = 8  # d²/6 of two arms is then known to 15 %


def of_arms(outcomes: list[dict[str, Checked]], what: str) -> list[Checked]:
    return [o[f"{arm} {what}"] for o in outcomes for arm in ARMS]


def test_stated_uncertainties_hold_from_boards_to_mean_joint_errors() -> None:
    """One test: processes that share the tests would each draw the replicates."""
    seeds = np.random.SeedSequence(SEED).generate_state(REPLICATES).tolist()
    outcomes = [replicate(seed, apart=True) for seed in seeds]
    for what in ("base", "base given rig", "means"):
        ratio, low, high = d2_ratio(of_arms(outcomes, what))
        assert low < ratio < high, what
    the_calibration_lies_as_near_its_truth_as_it_says(outcomes)
    every_joint_of_a_healthy_arm_is_found_healthy(outcomes)
    base_and_cameras_taken_as_independent_would_state_too_much(outcomes)


def the_calibration_lies_as_near_its_truth_as_it_says(outcomes: list[dict[str, Checked]]) -> None:
    rigs = [o["rig"] for o in outcomes]
    ratio, low, high = d2_ratio(rigs)
    assert low < ratio < high
    # parameters of a rig err together: worth some ten a rig, of which 95 % hold to 2 %
    pooled = np.concatenate([r.z for r in rigs])
    assert 0.88 < np.mean(np.abs(pooled) < WITHIN) < 0.99


def every_joint_of_a_healthy_arm_is_found_healthy(outcomes: list[dict[str, Checked]]) -> None:
    z = np.array([c.z for c in of_arms(outcomes, "means")])
    assert z.shape == (REPLICATES * len(ARMS), 6)
    assert all(holds(joint) for joint in z.T)


def base_and_cameras_taken_as_independent_would_state_too_much(
    outcomes: list[dict[str, Checked]],
) -> None:
    """What a registration found through the cameras shares with them cancels in the session."""
    together = np.array([c.u for c in of_arms(outcomes, "means")])
    apart = np.array([c.u for c in of_arms(outcomes, "means apart")])
    # joint 1 turns with the base, which the cameras' own errors moved along
    assert np.median(together[:, 0] / apart[:, 0]) < 0.7
