"""The report of an identified arm: its words and its pictures."""

import re
from dataclasses import replace

import pytest

from reports import render_html, render_pdf
from reports.document.blocks import Verdict, collect_figures
from reports.document.formatting import with_uncertainty
from reports.identification.certificate import observability_text
from reports.identification.document import document
from reports.identification.names import in_words
from reports.results import Results
from tests.support.reports.identification import made
from tests.support.reports.page import page_one, tables


@pytest.fixture(scope="module")
def every() -> dict[str, Results]:
    return {
        "geometry": made(1.0, outlying=True),
        "offsets": made(0.0),
        "positions": made(1.0, position_only=True),
        "bare": Results({"kind": "identification"}, {}, {}),
    }


def test_the_verdict_is_first(every: dict[str, Results]) -> None:
    first = document(every["geometry"]).sections[0].blocks[0]
    assert isinstance(first, Verdict)
    assert re.match(
        r"The largest offset is that of joint \d, which reads 0\.\d+° ± ", first.sentence
    )
    assert "On poses held out, the mean position residual goes from" in first.sentence
    assert first.remarks[0].startswith("30 parameters were identified from 59 poses")
    assert first.remarks[1] == "The offset of joints 1 and 6 was not identified."
    assert first.remarks[2].startswith("Observability (O1 to O5) is good: the condition number is")
    page = page_one(document(every["geometry"]))
    for words in ("Add to the reading [°]", "What to do Enter the last column", "Not checked The "):
        assert words in page


def test_observability_is_judged_by_the_condition_and_the_worst_combination() -> None:
    assert observability_text({}) == ""
    few = {"observability": {"O2": 1 / 250, "O3": 4.0}}
    poor = observability_text(few)
    assert "is poor: the condition number is 250, above the limit of 100" in poor
    assert "U = 0.50 (mm or °, k = 2). Add poses" in poor
    # what recordings differ by enlarges every parameter's U beyond it
    several = observability_text(few | {"recordings": {"count": 3, "scatter": 4.4}})
    assert "U = 0.50 (mm or °, k = 2) by the poses' noise alone. Add poses" in several


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("offset_3", "joint 3, offset"), ("a_2", "joint 2, link length a"),
        ("d_12", "joint 12, link offset d"), ("alpha_1", "joint 1, twist α"),
        ("beta_2", "joint 2, twist β"), ("base_rz", "base, turn about z"),
        ("tool_2_x", "tool 2, x"), ("strange", "strange"),
    ],
)  # fmt: skip
def test_parameters_are_named_in_words(name: str, words: str) -> None:
    assert in_words(name) == words


def test_a_person_reads_k_2_and_what_few_poses_ask_for_beyond_it(every: dict[str, Results]) -> None:
    few = replace(every["offsets"], summary=every["offsets"].summary | {"coverage_factor": 2.4})
    assert "take 1.20 times every U (Student's t)" in page_one(document(few))
    assert "Student" not in page_one(document(every["offsets"]))


def test_an_offset_is_given_with_either_sign(every: dict[str, Results]) -> None:
    offsets = tables(document(every["offsets"]))["Constant offset of each joint, ± U (k = 2)."]
    assert [cell.text for cell in offsets.rows[0]] == ["1", "–", "–"]
    for row in offsets.rows[1:5]:
        error, add = (float(cell.text.split(" ± ")[0].replace("−", "-")) for cell in row[1:3])
        assert error == -add
    stated = every["offsets"].summary["offsets"][1]
    expected = with_uncertainty(stated["error_deg"], 2 * stated["standard_uncertainty_deg"])
    assert offsets.rows[1][1].text == expected


def test_every_picture_is_there(every: dict[str, Results]) -> None:
    names = {"identified_residuals", "identified_angles", "parameter_correlation"}
    lengths = {"identified_lengths"}
    for name, own in (("geometry", lengths), ("offsets", set()), ("positions", lengths)):
        assert set(collect_figures(document(every[name]))) == names | own, name
    assert not collect_figures(document(every["bare"]))
    assert render_pdf(every["geometry"]).startswith(b"%PDF")
    for one in every.values():
        assert "<html" in render_html(one)


def test_outlying_poses_and_sessions_that_judge_have_tables_of_their_own(
    every: dict[str, Results],
) -> None:
    caption = "Residuals of other sessions, registered again with each robot file."
    found = tables(document(every["geometry"]))
    assert [cell.text for cell in found["Outlying poses."].rows[0]][:2] == ["monday", "7"]
    table = found[caption]
    assert table.notes[0] == "tuesday, 60 poses"
    before, after = (float(row[1].text) for row in table.rows)
    assert after < before
    assert caption not in tables(document(every["offsets"]))
