"""Pages of every kind of report."""

import re
from dataclasses import replace
from html import unescape

import pytest

import reports
from reports.document.blocks import to_template_data, unbroken
from reports.document.charts import PALETTE
from reports.session.document import ANSWERS, APPENDIX
from tests.support.reports import session as made
from tests.support.reports.page import (
    EVERY,
    LIBRARY,
    Page,
    document_of,
    html_of,
    luminance,
    made_of,
    page_of,
    strings,
)

LOCAL = r"#|data:image/png;base64,|sessions/\d+/report.html$"
FETCHING = {"src", "href", "data", "action", "poster", "srcset", "formaction", "background"}


@pytest.mark.parametrize("name", sorted(EVERY))
def test_every_text_of_the_document_is_on_the_page_in_its_sections(name: str) -> None:
    page = Page(html_of(name))
    assert page.open == []
    text = "".join(page.text)
    for part in strings(to_template_data(document_of(name), unbroken)):
        assert part in text
    titles = [section.title for section in document_of(name).sections]
    heads = re.findall(r"<h2[^>]*>.*?</span> (.*?)</h2>", html_of(name))
    found = [unescape(re.sub(r"</?button[^>]*>", "", head)) for head in heads]
    assert found == titles


def test_only_repeated_poses_have_no_section_in_results_of_before_they_were_sought() -> None:
    names = [section.name for section in document_of("nothing").sections]
    assert ("performance" in names, len(names)) == (False, len(ANSWERS + APPENDIX) - 1)


@pytest.mark.parametrize("name", ["nonconforming", "hostile", "fleet"])
def test_the_page_fetches_nothing(name: str) -> None:
    page = Page(html_of(name))
    for _, attributes in page.tags:
        for key in FETCHING & attributes.keys():
            assert re.match(LOCAL, attributes[key] or "#")
    policy = [a["content"] for t, a in page.tags if t == "meta" and "http-equiv" in a]
    assert policy
    assert "default-src 'none'" in str(policy[0])


def test_markup_in_names_is_shown_and_never_run() -> None:
    benign, hostile = Page(html_of("nonconforming")), Page(html_of("hostile"))
    assert [t for t, _ in benign.tags] == [t for t, _ in hostile.tags]
    assert "<script>alert(1)</script>" in "".join(hostile.text)
    assert "{{ 7*7 }}" in "".join(hostile.text)
    assert "\x1b" not in html_of("hostile")
    assert "\u202e" not in html_of("hostile")
    html_of("hostile").encode()  # half a surrogate would refuse


@pytest.mark.parametrize("name", ["good", "motion"])
def test_markup_in_a_calibration_is_shown_and_never_run(name: str) -> None:
    given, evil = made_of(name), '<script>alert(1)</script> {{ 7*7 }} #panic("x")'
    summary = given.summary | {
        "source": {"path": evil, "description": evil}, "warnings": [evil], "decisions": [evil],
        "robot": evil, "inputs": {evil: evil},
    }  # fmt: skip
    hostile = replace(given, summary=summary)
    page = Page(page_of(hostile))
    assert sum(tag == "script" for tag, _ in page.tags) == 3  # library, figures, what draws them
    assert evil in "".join(page.text)
    assert reports.render_pdf(hostile).startswith(b"%PDF")


@pytest.mark.parametrize("name", ["nonconforming", "good", "motion", "fleet"])
def test_the_same_results_give_the_same_page_with_the_plotting_library_once(name: str) -> None:
    page = reports.render_html(EVERY[name]())
    assert page.replace(LIBRARY, "") == html_of(name)
    assert page.count(LIBRARY) == 1
    assert LIBRARY not in reports.render_html(made.nothing())
    assert "</script" not in LIBRARY


def test_every_picture_has_alternative_text_and_every_table_headers() -> None:
    page = Page(html_of("nonconforming"))
    for tag, attributes in page.tags:
        if tag == "img":
            assert attributes["alt"]
        if "plot" in (attributes.get("class") or "").split():
            assert attributes["aria-label"]
        if tag == "th":
            assert attributes["scope"] in ("col", "row")
    tables = sum(tag == "table" for tag, _ in page.tags)
    assert sum(tag == "thead" for tag, _ in page.tags) == tables > 8


@pytest.mark.parametrize("name", ["nulls", "nothing", "uncalibrated", "bare", "unchecked"])
def test_an_unknown_value_is_a_dash(name: str) -> None:
    text = "".join(Page(html_of(name)).text)
    assert "–" in text
    assert not re.search(r"\b(None|nan|NaN|null|inf)\b", text)


@pytest.mark.parametrize("scheme", [0, 1])
def test_text_and_lines_have_the_contrast_that_wcag_asks_for(scheme: int) -> None:
    paper = luminance(PALETTE["paper"][scheme])
    for role, least in {"ink": 7, "muted": 4.5, "measured": 4.5, "encoder": 3, "resolved": 3,
                        "tolerance": 4.5}.items():  # fmt: skip
        own = luminance(PALETTE[role][scheme])
        assert (max(own, paper) + 0.05) / (min(own, paper) + 0.05) >= least, role
