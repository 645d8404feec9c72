"""The report of an interim check: what it says, in both formats, and that it is built again."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import typst

import reports
from reports.calibration import document
from reports.check import document as check_document
from reports.check.figures import CHECK_FIGURES
from reports.document.blocks import to_template_data
from reports.format import matplotlib, pdf
from reports.results import Results
from tests.reports.conftest import LIBRARY
from tests.reports.format.test_html import Page, _strings
from tests.support.scene import make_rig
from tests.verify.analysis.test_rig_check import bumped, seen_by
from tests.verify.calibration.check.test_check import STATED, board_pairs, doubtful_rig
from tests.verify.calibration.registration.test_fixture import BOARD
from verify.calibration.check.check import check_board, check_rig
from verify.calibration.check.results import check_results


def held() -> Results:
    rig = doubtful_rig()
    return check_results(
        check_rig(seen_by((rig, STATED), (rig, STATED), 0), rig, STATED), source="a"
    )


def not_held() -> Results:
    rig, true = doubtful_rig(), bumped(make_rig())["yaw"]
    found = check_rig(seen_by((true, STATED), (rig, STATED), 1), rig, STATED)
    return check_results(found, source="b", inputs={"rig.toml": "sha256:" + "0" * 64})


def board() -> Results:
    rig, known = doubtful_rig(), replace(BOARD, square_standard_uncertainty=5e-6)
    return check_results(check_board(rig, board_pairs(rig), known))


def nothing() -> Results:
    return Results({"kind": "calibration", "method": "check"}, {}, {})


EVERY: dict[str, Callable[[], Results]] = {
    "held": held, "not_held": not_held, "board": board, "nothing": nothing,
}  # fmt: skip
made_of = cache(lambda name: EVERY[name]())
html_of = cache(lambda name: reports.render_html(made_of(name)).replace(LIBRARY, ""))


@pytest.mark.parametrize("name", sorted(EVERY))
def test_all_that_the_outline_says_stands_on_the_page_and_no_word_of_the_program(name: str) -> None:
    page = Page(html_of(name))
    assert page.open == []
    text = "".join(page.text)
    for said in _strings(to_template_data(document.document(made_of(name)))):
        assert said in text
    assert not re.search(r"\b(None|nan|NaN|null|inf)\b", text)


@pytest.mark.parametrize("name", sorted(EVERY))
def test_both_formats_have_the_sections_in_order(name: str) -> None:
    titles = [section(made_of(name)).title for section in check_document.SECTIONS]
    assert re.findall(r"<h2[^>]*>.*?</span> (.*?)</h2>", html_of(name)) == titles
    files = pdf.typst_files(document.document(made_of(name)))
    found = json.loads(typst.query(files, "heading", field="body", **pdf.FONTS))
    assert [heading["text"] for heading in found] == titles


def test_the_verdict_is_the_check_s_and_names_what_is_off() -> None:
    good, bad = ("".join(Page(html_of(name)).text) for name in ("held", "not_held"))
    assert "The calibration holds" in good
    assert "Every figure lies within its uncertainty" in good
    assert "The calibration does not hold" in bad
    assert "Scale of known lengths is off by more than the uncertainty explains" in bad


def test_each_length_is_told_with_the_error_and_uncertainty_that_were_found() -> None:
    lengths = made_of("not_held").table("lengths")
    assert (lengths["error_mm"] < 0).all()  # all too short, as the yaw makes them
    np.testing.assert_allclose(
        lengths["measured_mm"] - lengths["known_mm"], lengths["error_mm"], atol=1e-12
    )
    assert (lengths["standard_uncertainty_mm"] > 0).all()


@pytest.mark.parametrize("figure", sorted(CHECK_FIGURES))
def test_every_figure_is_drawn_or_declined(figure: str) -> None:
    draw = CHECK_FIGURES[figure]
    assert draw(made_of("nothing")) is None
    chart = draw(made_of("not_held"))
    assert chart is not None
    assert matplotlib.svg(chart) == matplotlib.svg(chart)


def test_one_pair_of_a_board_shows_its_square_and_no_strips() -> None:
    assert CHECK_FIGURES["over_pairs"](made_of("board")) is None
    assert "Square as measured" in html_of("board")


def test_a_report_built_again_from_its_folder_is_the_same(tmp_path: Path) -> None:
    reports.write(made_of("not_held"), tmp_path / "results")
    again = reports.read(tmp_path / "results")
    assert (reports.render_html(again).replace(LIBRARY, "") == html_of("not_held")) is True
