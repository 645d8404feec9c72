"""Pairs that are compared together give the figures of each alone."""

import numpy as np
from numpy.testing import assert_allclose

from tests.support.spot_level import OFFSET, READ_EVERY, SpotRun, facing_rig, without_pictures
from verify.core.readings import Readings
from verify.live.clock import LiveClock
from verify.live.joint_row import Comparer
from verify.measurement.chain import Setup, measure

SECONDS = 0.8


def test_pairs_that_one_reading_brackets_are_compared_together_as_they_would_be_alone() -> None:
    rig, marker = facing_rig()
    run = SpotRun(rig, marker, 30.0, 0.0)
    with without_pictures():
        measured = list(measure(run.pairs(SECONDS), Setup(rig, marker)))
    several = [run.reading(number) for number in range(int((SECONDS + 3.0) / READ_EVERY))]
    readings = Readings(np.array([r.t for r in several]), np.array([r.q for r in several]))
    comparer = Comparer(run.arm, rig, marker, 1e-5, turning=False)
    # each pair has its own instant of a clock that drifts
    pairs = [(m, LiveClock(OFFSET + 1e-5 * m.frame, 1e-4, "estimated")) for m in measured[-4:]]
    lost = LiveClock(OFFSET - 1e3, 1e-4, "estimated")
    doubts = np.array([1e-4, 2e-4, 0.0, 3e-3, 5e-4])
    together = comparer.rows([*pairs[:2], (measured[0], lost), *pairs[2:]], readings, doubts)
    assert [row.status for row in together] == ["measured"] * 2 + ["no_encoder"] + ["measured"] * 2
    compared = zip(pairs, together[:2] + together[3:], doubts[[0, 1, 3, 4]], strict=True)
    for (measurement, clock), row, doubt in compared:
        (alone,) = comparer.rows([(measurement, clock)], readings, np.array([doubt]))
        assert row.frame == alone.frame == measurement.frame
        for name in ("measured", "encoder", "error", "uncertainty", "base_T_measured"):
            assert_allclose(getattr(row, name), getattr(alone, name), rtol=0, atol=1e-15)
        for name in ("xi", "jacobian", "noise", "prior", "clock"):
            here, there = getattr(row.evidence, name), getattr(alone.evidence, name)
            assert_allclose(here, there, rtol=1e-12, atol=1e-18)
