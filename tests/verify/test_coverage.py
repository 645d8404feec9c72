"""The claimed uncertainties are true: a small share of what `make bench-coverage` runs in full."""

import numpy as np
import pytest

from tests.bench import coverage
from verify.records import Array

SESSIONS = 5  # an arm
PAIRS = 20  # a session
SEED = 20260131
# A session's share of hits scatters by some 7 % (so that 100 sessions know a cell to 0.7 %), and
# its six joints are worth two or three: ten sessions know the mean to about 1.5 %.
LOW, HIGH = 0.905, 0.99


@pytest.fixture(scope="module")
def outcomes() -> dict[str, list[tuple[Array, float, float]]]:
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coverage, "PAIRS", PAIRS)
        for arm in coverage.ARMS:
            seeds = np.random.SeedSequence(SEED).generate_state(SESSIONS).tolist()
            found[arm] = [coverage.session_shares(arm, seed) for seed in seeds]
    return found


def test_intervals_hold_the_true_joints_as_often_as_they_say(
    outcomes: dict[str, list[tuple[Array, float, float]]],
) -> None:
    shares = np.array([[o[0] for o in of_arm] for of_arm in outcomes.values()])
    assert LOW < np.nanmean(shares) < HIGH
    # no joint of either arm is left out of that: five sessions know one to about 3 %
    assert np.nanmean(shares, axis=1).min() > 0.82


def test_hardly_a_pair_is_left_out_of_that(
    outcomes: dict[str, list[tuple[Array, float, float]]],
) -> None:
    for of_arm in outcomes.values():
        assert np.mean([singular for _, singular, _ in of_arm]) < 0.1
        assert np.mean([lost for _, _, lost in of_arm]) < 0.02
