from dataclasses import replace
from typing import Any

import pytest

from reports.results import Results
from reports.session import causes
from reports.session.headline import headline
from tests.support.reports import session as made


def _with(results: Results, **summary: Any) -> Results:
    return replace(results, summary=results.summary | summary)


OFFSET = made.CAUSES[0]


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (0.4, "Joint 2 reads 0.400° ± 0.015° (k = 2) too high: add −0.400° to its reading."),
        (-0.25, "Joint 2 reads 0.250° ± 0.015° (k = 2) too low: add +0.250° to its reading."),
    ],
)
def test_an_offset_is_stated_with_its_correction(value: float, sentence: str) -> None:
    message = headline(_with(made.nonconforming(), diagnosis=[OFFSET | {"value": value}]))
    assert message.sentence == sentence
    assert message.tone == "nonconform"


@pytest.mark.parametrize(
    ("diagnosis", "parts"),
    [
        ([OFFSET | {"joint": 5}], ("Joint 2 exceeds ±0.2°", "no single cause")),
        (made.UNCLEAR, ("offset of joint 3", "offset of joint 4, −0.050° ± 0.060° (k = 2)")),
    ],
    ids=["a cause elsewhere explains nothing", "rivals are both named"],
)
def test_an_unclear_cause_is_stated(diagnosis: list[Any], parts: tuple[str, ...]) -> None:
    sentence = headline(_with(made.nonconforming(), diagnosis=diagnosis)).sentence
    assert all(part in sentence for part in parts)


def test_conformity_is_stated_with_its_probability_rounded_down() -> None:
    rows = made.conforming().summary["joints"]
    unsure = rows[0] | {"conformance_probability": 0.99312}
    message = headline(_with(made.conforming(), joints=[unsure, *rows[1:]]))
    assert "within ±0.5° at every pose" in message.sentence
    assert "at least 99.3 %" in message.sentence  # 0.99312, rounded down
    assert "no others" in " ".join(message.remarks)


LED_OFF = {"name": "B", "displacement_mm": [0.0, 3.0, 0.0], "expanded_uncertainty_mm": 0.2}


@pytest.mark.parametrize(
    ("pictures", "words"),
    [
        ({"contradict": True}, "the pictures contradict rig.toml or marker.toml"),
        ({"displaced_led": LED_OFF}, "LED B is seen 3.00 ± 0.20 mm from its place in marker.toml"),
        (
            {"displaced_led": LED_OFF | {"last_pairs_only": True}},
            "from its place in marker.toml in the last pairs",
        ),
    ],
)
def test_what_contradicts_the_files_is_said_before_any_figure(
    pictures: dict[str, Any], words: str
) -> None:
    faulty = headline(_with(made.nonconforming(), pictures=pictures)).sentence
    assert words.lower() in faulty.lower()
    assert faulty.index("not from the robot") < faulty.index("joint 2 exceeds ±0.2°")
    sound = headline(_with(made.conforming(), pictures=pictures)).sentence
    assert sound.startswith("Even though ")
    assert "nothing needs to be done" not in sound


def test_an_led_that_is_left_out_makes_no_figure_doubtful_and_is_something_to_do() -> None:
    pictures = {"contradict": False, "displaced_led": LED_OFF | {"left_out": True}}
    faulty = headline(_with(made.nonconforming(), pictures=pictures)).sentence
    assert faulty == headline(made.nonconforming()).sentence
    sound = headline(_with(made.conforming(), pictures=pictures)).sentence
    assert sound.startswith("Every joint's error stays within")
    assert "nothing needs to be done" not in sound
    remarks = headline(_with(made.conforming(), pictures=pictures)).remarks
    assert any("LED B is seen 3.00 ± 0.20 mm from its place" in remark for remark in remarks)


def test_leds_that_are_not_in_their_places_are_something_to_do() -> None:
    shifts = {"shift_mm": [[0.3, 0.4, 0.0], [0.0, 0.1, 0.0]], "expanded_uncertainty_mm": 0.03}
    pictures = {"contradict": False, "displaced_led": None, "led_shifts": shifts}
    sound = headline(_with(made.conforming(), pictures=pictures))
    assert "nothing needs to be done" not in sound.sentence
    assert any("LEDs are up to 0.50 mm from where marker.toml" in r for r in sound.remarks)


def test_where_many_pairs_fit_no_pose_that_is_said_before_any_cause() -> None:
    """Whatever is stated of the rig: without, summary.json has no `pictures`."""
    lost = {"recorded": 60, "measured": 22, "rejected": {"outlier": 38}}
    sentence = headline(_with(made.nonconforming(), pairs=lost, pictures=None)).sentence
    assert sentence.startswith("The pictures contradict rig.toml or marker.toml, and what follows")
    assert "too high" not in sentence  # no cause as a fact
    hidden = lost | {"rejected": {"too_few_leds": 30, "outlier": 8}}
    assert "contradict" not in headline(_with(made.nonconforming(), pairs=hidden)).sentence


def test_where_many_pairs_are_lost_no_pose_of_theirs_is_said_to_conform() -> None:
    lost = {"recorded": 60, "measured": 40, "rejected": {"no_encoder": 16, "outlier": 4}}
    message = headline(_with(made.conforming(), pairs=lost))
    assert "at every pose that was measured" in message.sentence
    assert "nothing needs to be done" not in message.sentence
    assert message.remarks[0].startswith(
        "20 of 60 pairs are not counted (no encoder reading at that time: 16; LEDs do not fit the "
        "marker: 4), and"
    )


def test_a_cause_that_is_found_is_something_to_do_and_the_headline_of_a_pose_that_fails() -> None:
    message = headline(_with(made.conforming(), diagnosis=[OFFSET]))
    assert "nothing needs to be done" not in message.sentence
    assert "; yet joint 2 reads" in message.sentence
    unclear = headline(_with(made.conforming(), diagnosis=[{"kind": "ambiguous"}]))
    assert unclear.sentence.endswith(" %.")
    rows = [row | {"verdict": "conform"} for row in made.conforming().summary["joints"]]
    position = {"verdict": "nonconform", "tolerance_mm": 1.0}
    failing = _with(made.conforming(), verdict="nonconform", joints=rows, position=position,
                    diagnosis=[OFFSET])  # fmt: skip
    assert "no single cause" not in headline(failing).sentence
    assert "oint 2" in headline(failing).sentence


def test_a_pose_that_fails_is_named_where_no_joint_does_and_once() -> None:
    """A cause in the headline does not say why the robot fails; a sentence of its own need not."""
    results = made.nonconforming()
    joints = [joint | {"verdict": "undecided"} for joint in results.summary["joints"]]
    position = {
        "verdict": "nonconform", "tolerance_mm": 1.0, "worst_error_mm": 2.053,
        "worst_error_standard_uncertainty_mm": 0.083,
    }  # fmt: skip
    rest = {"joints": joints, "position": position, "orientation": {}}
    said = "flange's position error exceeds 1 mm (largest error: 2.05 ± 0.17 mm, k = 2)"
    named = headline(_with(results, diagnosis=[OFFSET], **rest))
    assert said not in named.sentence
    assert f"The {said}." in named.remarks
    alone = headline(_with(results, diagnosis=[], **rest))
    assert said in alone.sentence
    assert not any(said in remark for remark in alone.remarks)


def test_undecided_never_reads_as_conforming() -> None:
    message = headline(made.undecided())
    text = " ".join((message.label, message.sentence, *message.remarks))
    assert message.label == "Undecided"
    assert "cannot tell" in message.sentence
    assert "first" in message.sentence
    assert "conforms" not in text
    assert "Taken as exact, as their uncertainty is not stated: rig and robot base." in text


def test_an_undecided_verdict_names_the_largest_source_to_improve() -> None:
    rows = [
        row | {"verdict": "undecided", "reason": "uncertainty_too_large"}
        for row in made.conforming().summary["joints"]
    ]
    message = headline(_with(made.conforming(), verdict="undecided", joints=rows))
    assert "improve first is LED body, which alone" in message.sentence


def test_causes_found_are_no_quantity_to_improve() -> None:
    rows = [
        row | {"verdict": "undecided", "reason": "uncertainty_too_large"}
        for row in made.conforming().summary["joints"]
    ]
    results = _with(made.conforming(), verdict="undecided", joints=rows)
    budget = results.tables["budget"].assign(source="causes found")
    sentence = headline(replace(results, tables=results.tables | {"budget": budget})).sentence
    assert "improve first is what separates the causes found from" in sentence
    assert "(more pairs, in other postures): this part of joint " in sentence


def test_a_joint_hidden_by_the_clock_requires_the_clock_offset() -> None:
    results = made.undecided()
    assert "first give the clock offset" in headline(results).sentence
    rig = results.setup["rig"] | {"base_source": "motion"}
    hidden = headline(replace(results, setup=results.setup | {"rig": rig}))
    assert "first give the robot base" in hidden.sentence


def test_without_a_tolerance_there_is_no_verdict_but_a_largest_error() -> None:
    message = headline(made.no_tolerance())
    assert message.label == "No verdict"
    assert "no tolerance was given" in message.sentence.lower()
    assert "joint" in message.sentence
    assert message.sentence.endswith(" (k = 2).")
    inapplicable = headline(_with(made.nonconforming(), verdict=None)).sentence
    assert "nothing that could be judged" in inapplicable
    assert "no tolerance" not in inapplicable


@pytest.mark.parametrize("verdict", ["conform", "nonconform", "undecided", None, "novel"])
@pytest.mark.parametrize("name", ["nonconforming", "nulls"])
def test_every_verdict_has_a_sentence_for_any_results(name: str, verdict: str | None) -> None:
    message = headline(_with(made.EVERY[name](), verdict=verdict))
    assert message.sentence.endswith(".")
    assert message.sentence[0] == message.sentence[0].upper()


def test_backlash_gain_and_eccentricity_have_their_own_sentences() -> None:
    message = [causes.finding(entry) for entry in made.CAUSES]
    assert "joint 2's reading turns 0.520 ± 0.040 % (k = 2) more than the joint" in message[1]
    backlash = "joint 4 has 0.310° ± 0.040° (k = 2) of backlash, its encoder on the motor's side"
    assert backlash in message[2]
    assert "joint 5's error is a wave of 0.120° ± 0.020° (k = 2), 1 wave a turn" in message[3]
    assert "add −0.01230 s to the clock offset" in message[4]
    assert "correct a2 in the robot file by +0.84 mm" in message[5]
