"""The stranger's test: ten questions, each answered by the text of page one alone.

The session is a sample; its README.md states the truth. docs/reports.md lists the questions.
"""

import re
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from reports.document.blocks import to_template_data
from reports.format.pdf import pages
from reports.session.certificate import certificate
from reports.session.document import document
from tests.support.reports.page import made_of, pdf_text, pdf_text_of, strings

QUESTIONS = {
    "Is my robot all right?": "The robot does not conform",
    "Which joint?": r"Joint 2 exceeds ±0\.2°",
    "How sure?": r"0\.348\d° ± 0\.00\d+° \(k = 2\)",
    "What do I type into the controller?": r"add −0\.348\d° to its reading",
    "What was not checked?": "This covers the poses, directions and speeds that the session shows",
    "With what instrument?": "Instrument +stereo rig with LEDs",
    "When?": "Date of measurement +2026-01-15",
    "What is the cause?": r"Cause +constant offset of joint 2, \+0\.348\d°",
    "Where is the flange off, and by how many mm?": (
        r"position \[mm\] +3\.\d+ +3\.\d+ ± 0\.\d+ +\(\d+, \d+, \d+\) mm, t = \d"
    ),
    "What do I do next?": r"What to do +add −0\.348\d° to its reading",
}
DOCUMENT = Path(__file__).parents[3] / "docs" / "reports.md"


@pytest.mark.parametrize("question", QUESTIONS)
def test_page_one_answers(question: str) -> None:
    first = pdf_text_of("nonconforming").split("\f")[0]
    assert re.search(QUESTIONS[question], first)


def test_the_document_lists_the_questions() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert re.findall(r"^\| (.+\?) \|", text, re.MULTILINE) == list(QUESTIONS)


def test_without_a_tolerance_page_one_says_what_is_taken_as_exact_and_what_to_do() -> None:
    text = " ".join(strings(to_template_data(certificate(made_of("no_tolerance")))))
    assert "Taken as exact, as their uncertainty is not stated: apparent LED centre" in text
    assert "Every figure holds on that condition" in text
    assert "give a tolerance" in text
    assert "and the tolerance" not in text


def test_where_many_pairs_are_lost_page_one_does_not_say_that_nothing_is_to_be_done() -> None:
    results = made_of("conforming")
    assert "nothing" in strings(to_template_data(certificate(results)))
    lost = {"recorded": 60, "measured": 40, "rejected": {"no_encoder": 20}}
    fewer = replace(results, summary=results.summary | {"pairs": lost})
    texts = strings(to_template_data(certificate(fewer)))
    assert "nothing" not in texts
    assert "find out why so many pairs are not counted" in texts


def test_a_displaced_led_is_to_be_measured_before_anything_else_is_done() -> None:
    results = made_of("nonconforming")
    led = {"name": "B", "displacement_mm": [0.0, 3.0, 0.0], "expanded_uncertainty_mm": 0.2}
    summary = results.summary | {"pictures": {"contradict": True, "displaced_led": led}}
    texts = strings(to_template_data(certificate(replace(results, summary=summary))))
    assert any(t.startswith("measure the place of LED B again; add −0.348") for t in texts)


def test_page_one_of_a_watched_run_holds_its_alarms() -> None:
    text = (
        "The reading of joint 2 has changed by +0.349° ± 0.011° (k = 2) against what is measured."
    )
    told = [(number, 2, float(number), text) for number in range(1, 5)]
    alarms = pd.DataFrame(told, columns=["alarm", "joint", "t_s", "text"])
    results = made_of("nonconforming")
    watched = replace(results, tables=results.tables | {"alarms": alarms})
    laid_out = document(watched)
    alone = replace(laid_out, sections=laid_out.sections[:1])
    first = pdf_text(pages(alone)).split("\f")[0]
    assert "alarms.csv lists every alarm" in first


def test_one_figure_has_one_uncertainty_with_its_own_factor_throughout_the_report() -> None:
    """Of few pairs k is 2.19: 0.0086 times that is 0.019, and not 0.017."""
    results = made_of("nonconforming")
    joint = results.summary["joints"][1] | {
        "mean_error_deg": 0.36, "standard_uncertainty_deg": 0.0086, "coverage_factor": 2.19,
        "expanded_uncertainty_deg": 2.19 * 0.0086,
        "worst_error_deg": 0.36, "worst_error_standard_uncertainty_deg": 0.0086,
    }  # fmt: skip
    cause = results.summary["diagnosis"][0] | {
        "value": 0.36, "standard_uncertainty": 0.0086, "expanded_uncertainty": 2.19 * 0.0086,
    }  # fmt: skip
    joints = [{**j, "coverage_factor": 2.0} for j in results.summary["joints"]]
    joints[1] = joint
    summary = results.summary | {"joints": joints, "diagnosis": [cause]}
    laid_out = document(replace(results, summary=summary))
    parts = tuple(s for s in laid_out.sections if s.name != "budget")  # sums have k = 2 there
    text = strings(to_template_data(parts))
    stated = [line for line in text if "0.360" in line and "±" in line]
    assert len(stated) >= 5
    assert [line for line in stated if "± 0.019" not in line] == []
    assert "Joint 2 reads 0.360° ± 0.019° (k = 2.19) too high" in " ".join(text)
    assert "(largest error: +0.360° ± 0.019°, k = 2.19)" in " ".join(text)
    assert "Causes of the errors found, k = 2.19." in text
    assert "Error of each joint: reading less true angle, k = 2 to 2.19." in text


def test_a_long_robot_name_stays_on_the_page_and_stands_in_the_certificate() -> None:
    results = made_of("nonconforming")
    name = "a_very_long_robot_name_for_the_research_arm_with_two_cameras_and_leds_in_hall_7"
    setup = results.setup | {"robot": results.setup["robot"] | {"name": name}}
    session = results.summary["session"] | {"robot": "arm.toml"}
    named = replace(results, setup=setup, summary=results.summary | {"session": session})
    laid_out = document(named)
    alone = replace(laid_out, sections=laid_out.sections[:1])
    text = pdf_text(pages(alone)).replace("\u200b", "")
    assert "arm.toml" not in text
    title = re.search(r"Encoder verification of (\S+)\s+(\S+)", text)
    assert title is not None
    assert title[1] + title[2] == name
    assert len(title[1]) < 40  # letters that the line has room for behind the other words
