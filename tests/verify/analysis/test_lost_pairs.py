"""The verdict where most pairs of a session are lost: those left may bear none."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest

import robots
from tests.support.simulated import HOME_DEG, in_memory, marker_of, measured_at_spots, scene
from verify.analysis.session import analyse
from verify.analysis.verdict import Verdict, borne_verdict
from verify.core.records import Measurement, StereoPair
from verify.io.session.keys import Tolerance
from verify.measurement.chain import Setup
from verify.measurement.systematics import stated_systematics
from verify.simulation.scenario import ScenarioFault, ScenarioRecording

WIDE = Tolerance(joints=np.full(6, np.deg2rad(0.8)), position=None, orientation=None)
PAIRS = 30


def judged(
    left: int, lost_as: str, pairs: int = PAIRS, fault_deg: float = 0.0
) -> tuple[list[str], list[str]]:
    """Verdicts of the joints, and warnings, where the first `left` pairs alone are measured."""
    faults = [ScenarioFault(joint=2, offset_deg=fault_deg)] if fault_deg else []
    session = in_memory(scene(recording=ScenarioRecording(pairs=pairs, rate_hz=10.0), fault=faults))
    systematics = stated_systematics(session.rig, session.marker, turning=False)

    def chain(_pairs: Iterable[StereoPair], _setup: Setup) -> Iterator[Measurement]:
        for m in measured_at_spots(session, systematics, np.random.default_rng(3)):
            kept = m.frame < left
            yield m if kept else replace(m, status=lost_as, pose=None, left=None, right=None)

    summary = analyse(session, tolerance=WIDE, chain=chain).summary
    return [joint["verdict"] for joint in summary["joints"]], summary["warnings"]


def test_three_pairs_of_thirty_conform_to_nothing_and_three_recorded_ones_do() -> None:
    verdicts, warnings = judged(3, "too_few_leds")
    assert set(verdicts) == {"undecided"}
    assert any("Only 3 of 30 pairs gave a pose (27 too_few_leds)" in one for one in warnings)
    assert set(judged(3, "too_few_leds", pairs=3)[0]) == {"conform"}


def test_how_many_pairs_show_two_leds_alone_is_counted() -> None:
    session = in_memory(scene(marker=marker_of("AB")))
    systematics = stated_systematics(session.rig, session.marker, turning=False)

    def chain(_pairs: Iterable[StereoPair], _setup: Setup) -> Iterator[Measurement]:
        return measured_at_spots(session, systematics, np.random.default_rng(3))

    warnings = analyse(session, chain=chain).summary["warnings"]
    assert any("The LEDs of 12 of 12 pairs determine only 5 of 6 degrees" in w for w in warnings)


def test_hidden_leds_leave_pairs_that_bear_a_verdict_and_contradictions_do_not() -> None:
    assert set(judged(12, "too_few_leds")[0]) == {"conform"}
    assert set(judged(12, "outlier")[0]) == {"undecided"}


def test_a_clear_error_is_nonconform_unless_most_pairs_contradict_the_files() -> None:
    assert judged(12, "too_few_leds", fault_deg=2.0)[0][1] == "nonconform"
    assert set(judged(12, "outlier", fault_deg=2.0)[0]) == {"undecided"}


def test_without_a_tolerance_there_is_no_verdict_to_withhold() -> None:
    none = Verdict(None, "no_tolerance", 0.0, 1e-3, None)
    assert borne_verdict(none, Counter(measured=1, outlier=9)) == none


@pytest.mark.parametrize("arm", ["iust_6r", "rv_3sd_melfa", "ur5"])
def test_of_no_pose_none_is_reached(arm: str) -> None:
    q, reached = robots.nearest(robots.load(arm), np.zeros((0, 4, 4)), np.zeros((0, 6)))
    assert q.shape == (0, len(HOME_DEG))
    assert reached.shape == (0,)
