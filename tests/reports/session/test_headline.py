from dataclasses import replace
from typing import Any

import pytest

from reports.document import formatting
from reports.results import Results
from reports.session import causes, phrases
from reports.session.headline import headline
from tests.support.reports import session as made


def _with(results: Results, **summary: Any) -> Results:
    return replace(results, summary=results.summary | summary)


def test_an_offset_is_stated_with_its_correction() -> None:
    message = headline(made.nonconforming())
    assert message.sentence == (
        "Joint 3 reads 0.400° ± 0.015° (k = 2) too high: add −0.400° to its reading."
    )
    assert message.tone == "nonconform"


def test_a_negative_offset_is_corrected_upwards() -> None:
    cause = made.nonconforming().summary["diagnosis"][0] | {"value": -0.25}
    message = headline(_with(made.nonconforming(), diagnosis=[cause]))
    assert message.sentence == (
        "Joint 3 reads 0.250° ± 0.015° (k = 2) too low: add +0.250° to its reading."
    )


def test_a_cause_elsewhere_does_not_explain_a_failing_joint() -> None:
    cause = made.nonconforming().summary["diagnosis"][0] | {"joint": 5}
    message = headline(_with(made.nonconforming(), diagnosis=[cause]))
    assert "Joint 3 exceeds ±0.2°" in message.sentence
    assert "no single cause" in message.sentence


def test_rival_causes_are_both_named() -> None:
    ambiguous = made.undecided().summary["diagnosis"]
    message = headline(_with(made.nonconforming(), diagnosis=ambiguous))
    assert "offset of joint 3" in message.sentence
    assert "offset of joint 4, −0.050° ± 0.060° (k = 2)" in message.sentence


def test_conformity_is_stated_with_its_probability_rounded_down() -> None:
    message = headline(made.conforming())
    assert "within ±0.5° at every pose" in message.sentence
    assert "at least 99.3 %" in message.sentence  # 0.99312, rounded down
    assert "no others" in " ".join(message.remarks)


def test_undecided_never_reads_as_conforming() -> None:
    message = headline(made.undecided())
    text = " ".join((message.label, message.sentence, *message.remarks))
    assert message.label == "Undecided"
    assert "cannot tell" in message.sentence
    assert "first" in message.sentence
    assert "conforms" not in text
    assert "on the condition that rig and robot base are exact" in text


def test_an_undecided_verdict_names_the_largest_source_to_improve() -> None:
    rows = [
        row | {"verdict": "undecided", "reason": "uncertainty_too_large"}
        for row in made.conforming().summary["joints"]
    ]
    message = headline(_with(made.conforming(), verdict="undecided", joints=rows))
    assert "improve first is relative yaw of the cameras" in message.sentence


def test_a_joint_hidden_by_the_clock_requires_the_clock_offset() -> None:
    rows = [dict(row) for row in made.undecided().summary["joints"]]
    message = headline(_with(made.undecided(), joints=rows))
    assert "first give the clock offset" in message.sentence
    setup = made.undecided().setup
    hidden = setup | {"rig": setup["rig"] | {"base_source": "motion"}}
    message = headline(replace(made.undecided(), setup=hidden))
    assert "first give the robot base" in message.sentence


def test_without_a_tolerance_there_is_no_verdict_but_a_largest_error() -> None:
    message = headline(made.no_tolerance())
    assert message.label == "No verdict"
    assert "no tolerance was given" in message.sentence.lower()
    assert "joint" in message.sentence
    assert message.sentence.endswith(" (k = 2).")


def test_an_inapplicable_tolerance_is_not_reported_as_missing() -> None:
    message = headline(_with(made.nonconforming(), verdict=None))
    assert "nothing that could be judged" in message.sentence
    assert "no tolerance" not in message.sentence


@pytest.mark.parametrize("verdict", ["conform", "nonconform", "undecided", None, "novel"])
@pytest.mark.parametrize("name", ["nonconforming", "nulls"])
def test_every_verdict_has_a_sentence_for_any_results(name: str, verdict: str | None) -> None:
    message = headline(_with(made.EVERY[name](), verdict=verdict))
    assert message.sentence.endswith(".")
    assert message.sentence[0] == message.sentence[0].upper()


@pytest.mark.parametrize("index", range(8))
def test_every_kind_of_cause_has_a_name_and_a_remedy(index: int) -> None:
    entry = made.every_cause().summary["diagnosis"][index]
    assert causes.cause_name(entry)
    assert causes.remedy(entry)


def test_backlash_gain_and_eccentricity_have_their_own_sentences() -> None:
    message = [causes.finding(entry) for entry in made.every_cause().summary["diagnosis"]]
    assert "joint 2's reading turns 0.520 ± 0.040 % (k = 2) more than the joint" in message[1]
    assert (
        "joint 4 has 0.310° ± 0.040° (k = 2) of backlash, its encoder on the motor's side"
        in message[2]
    )
    assert "joint 5's error is a wave of 0.120° ± 0.020° (k = 2), 1 wave a turn" in message[3]
    assert "add −0.01230 s to the clock offset" in message[4]
    assert "correct a2 in the robot file by +0.84 mm" in message[5]


def test_unknown_labels_are_shown_as_they_are() -> None:
    assert formatting.lookup_label(phrases.STATUSES, "lens_cap_on") == "lens cap on"
    assert formatting.lookup_label(phrases.STATUSES, None) == "–"
