"""What is said of a session of which many pairs are not measured or have no reading."""

import re

import numpy as np
import pytest

from tests.support.simulated import in_memory, scene
from verify.analysis.measured import with_gaps_named
from verify.analysis.results.warnings import lost_pairs_warning
from verify.core.readings import Readings
from verify.core.records import Measurement
from verify.simulation.scenario import ScenarioRecording

SESSION = in_memory(scene(recording=ScenarioRecording(pairs=2, rate_hz=10.0)))


def pairs(statuses: str) -> list[Measurement]:
    words = {"m": "measured", "o": "outlier", "a": "ambiguous_leds", "f": "too_few_leds"}
    return [Measurement(i, i / 10, words[s], 3) for i, s in enumerate(statuses)]


@pytest.mark.parametrize("statuses", ["m" * 40, "m" * 36 + "o" * 4, "fooo" + "m" * 40])
def test_of_few_lost_pairs_nothing_is_said(statuses: str) -> None:
    assert lost_pairs_warning(pairs(statuses)) is None


def test_a_camera_that_was_moved_shows_by_the_pairs_since() -> None:
    warning = lost_pairs_warning(pairs("m" * 30 + "oaomooaaoo" + "o" * 10)) or ""
    assert re.match(r"Only 31 of 50 pairs gave a pose \(16 outlier, 3 ambiguous_leds\)", warning)
    assert "from t_left_s = 3.00 on" in warning
    assert "no camera or LED has moved" in warning


@pytest.mark.parametrize("statuses", ["mmmmmo", "m" * 12 + "oo"])
def test_a_last_pair_or_two_that_are_lost_are_no_beginning(statuses: str) -> None:
    warning = lost_pairs_warning(pairs(statuses)) or ""
    assert f"Only {statuses.count('m')} of {len(statuses)} pairs gave a pose" in warning
    assert "nearly all lost" not in warning


def test_pairs_lost_all_over_have_no_beginning_and_hidden_leds_another_advice() -> None:
    scattered = lost_pairs_warning(pairs("mmo" * 20)) or ""
    assert scattered.startswith("Only 40 of 60 pairs gave a pose (20 outlier). The pictures")
    hidden = lost_pairs_warning(pairs("mmmf" * 20)) or ""
    assert "lit and in view" in hidden
    assert "contradict" not in hidden


@pytest.mark.parametrize(
    ("silent", "words"),
    [
        (np.linspace(2.0, 4.0, 30), ["30 of 90 pairs lie before its first reading or after"]),
        (np.array([-0.1, 1.05, 1.1]), []),
    ],
)
def test_a_log_that_ends_early_is_named(silent: np.ndarray, words: list[str]) -> None:
    t = np.arange(0.0, 1.0, 0.02)
    readings = Readings(t, np.zeros((len(t), 6)))
    warnings = with_gaps_named(SESSION, readings, silent, 90).warnings
    assert len(warnings) == len(words)
    assert all(any(word in one for one in warnings) for word in words)
