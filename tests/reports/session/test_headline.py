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
    said = headline(made.nonconforming())
    assert said.sentence == (
        "Joint 3 reads 0.400° ± 0.015° (k = 2) too high: add −0.400° to its reading."
    )
    assert said.tone == "nonconform"


def test_a_negative_offset_is_corrected_upwards() -> None:
    cause = made.nonconforming().summary["diagnosis"][0] | {"value": -0.25}
    said = headline(_with(made.nonconforming(), diagnosis=[cause]))
    assert said.sentence == (
        "Joint 3 reads 0.250° ± 0.015° (k = 2) too low: add +0.250° to its reading."
    )


def test_a_cause_elsewhere_does_not_explain_a_failing_joint() -> None:
    cause = made.nonconforming().summary["diagnosis"][0] | {"joint": 5}
    said = headline(_with(made.nonconforming(), diagnosis=[cause]))
    assert "Joint 3 exceeds ±0.2°" in said.sentence
    assert "no single cause" in said.sentence


def test_rival_causes_are_both_named() -> None:
    ambiguous = made.undecided().summary["diagnosis"]
    said = headline(_with(made.nonconforming(), diagnosis=ambiguous))
    assert "offset of joint 3" in said.sentence
    assert "offset of joint 4, −0.050° ± 0.060° (k = 2)" in said.sentence


def test_conformity_is_stated_with_its_probability_rounded_down() -> None:
    said = headline(made.conforming())
    assert "within ±0.5° at every pose" in said.sentence
    assert "at least 99.3 %" in said.sentence  # 0.99312, rounded down
    assert "no others" in " ".join(said.remarks)


def test_undecided_never_reads_as_conforming() -> None:
    said = headline(made.undecided())
    text = " ".join((said.label, said.sentence, *said.remarks))
    assert said.label == "Undecided"
    assert "cannot tell" in said.sentence
    assert "first" in said.sentence
    assert "conforms" not in text
    assert "on the condition that rig and robot base are exact" in text


def test_an_undecided_verdict_names_the_largest_source_to_improve() -> None:
    rows = [
        row | {"verdict": "undecided", "reason": "uncertainty_too_large"}
        for row in made.conforming().summary["joints"]
    ]
    said = headline(_with(made.conforming(), verdict="undecided", joints=rows))
    assert "improve first is relative yaw of the cameras" in said.sentence


def test_a_joint_hidden_by_the_clock_requires_the_clock_offset() -> None:
    rows = [dict(row) for row in made.undecided().summary["joints"]]
    said = headline(_with(made.undecided(), joints=rows))
    assert "first give the clock offset" in said.sentence
    setup = made.undecided().setup
    hidden = setup | {"rig": setup["rig"] | {"base_source": "motion"}}
    said = headline(replace(made.undecided(), setup=hidden))
    assert "first give the robot base" in said.sentence


def test_without_a_tolerance_there_is_no_verdict_but_a_largest_error() -> None:
    said = headline(made.no_tolerance())
    assert said.label == "No verdict"
    assert "no tolerance was given" in said.sentence.lower()
    assert "joint" in said.sentence
    assert said.sentence.endswith(" (k = 2).")


def test_an_inapplicable_tolerance_is_not_reported_as_missing() -> None:
    said = headline(_with(made.nonconforming(), verdict=None))
    assert "nothing that could be judged" in said.sentence
    assert "no tolerance" not in said.sentence


@pytest.mark.parametrize("verdict", ["conform", "nonconform", "undecided", None, "novel"])
@pytest.mark.parametrize("name", ["nonconforming", "nulls"])
def test_every_verdict_has_a_sentence_for_any_results(name: str, verdict: str | None) -> None:
    said = headline(_with(made.EVERY[name](), verdict=verdict))
    assert said.sentence.endswith(".")
    assert said.sentence[0] == said.sentence[0].upper()


@pytest.mark.parametrize("index", range(8))
def test_every_kind_of_cause_has_a_name_and_a_remedy(index: int) -> None:
    entry = made.every_cause().summary["diagnosis"][index]
    assert causes.cause_name(entry)
    assert causes.remedy(entry)


def test_backlash_gain_and_eccentricity_have_their_own_sentences() -> None:
    said = [causes.finding(entry) for entry in made.every_cause().summary["diagnosis"]]
    assert "joint 2's reading turns 0.520 ± 0.040 % (k = 2) more than the joint" in said[1]
    assert (
        "joint 4 has 0.310° ± 0.040° (k = 2) of backlash, its encoder on the motor's side"
        in said[2]
    )
    assert "joint 5's error is a wave of 0.120° ± 0.020° (k = 2), 1 wave a turn" in said[3]
    assert "add −0.01230 s to the clock offset" in said[4]
    assert "correct a2 in the robot file by +0.84 mm" in said[5]


def test_unknown_labels_are_shown_as_they_are() -> None:
    assert formatting.lookup_label(phrases.STATUSES, "lens_cap_on") == "lens cap on"
    assert formatting.lookup_label(phrases.STATUSES, None) == "–"
