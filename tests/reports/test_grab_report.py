"""The report of a grab says how it ended, and draws nothing where there is nothing."""

import pandas as pd
import pytest

from reports.blocks import Figure, figures
from reports.grab import document, outcome
from reports.results import Results

BARE = {"kind": "grab", "robot": "an arm", "target": "blue object", "cell": "simulated"}


@pytest.mark.parametrize(
    ("summary", "tone", "label"),
    [
        ({"execute": True, "state": "lifted", "reason": "held"}, "conform", "Grasped and lifted"),
        ({"execute": True, "state": "missed", "reason": "empty"}, "nonconform", "Missed"),
        ({"execute": True, "state": "fault", "reason": "alarm"}, "nonconform", "fault"),
        ({"execute": True, "state": "holding-lost", "reason": "gone"}, "undecided", "out of sight"),
        ({"execute": True, "state": "following", "reason": ""}, "undecided", "while following"),
        ({"execute": False, "state": "searching", "reason": ""}, "undecided", "not found"),
        ({"state": "tracking", "plan": {"branch": "b", "duration_s": 4.9}}, "none", "Planned"),
        ({"state": "tracking", "refusal": {"reason": "too wide"}}, "undecided", "Refused"),
    ],
)
def test_each_end_has_its_words(summary: dict[str, object], tone: str, label: str) -> None:
    said = outcome(summary)
    assert said.tone == tone
    assert label in said.label
    assert "None" not in said.sentence


def test_what_was_not_seen_is_said_and_not_drawn() -> None:
    told = document(Results(BARE | {"state": "searching"}, {}, {"cycles": pd.DataFrame()}))
    assert figures(told) == {}
    blocks = [block for section in told.sections for block in section.blocks]
    assert not any(isinstance(block, Figure) for block in blocks)
    words = " ".join(str(getattr(block, "text", "")) for block in blocks)
    for said in ("no pictures", "was not seen", "saw nothing", "No joint angles", "no plan"):
        assert said in words
