import re
from collections.abc import Callable

import pytest

import reports
from reports.document.blocks import to_template_data
from reports.document.charts import PALETTE
from reports.session.document import SECTIONS, document
from tests.support.reports import made
from tests.support.reports.page import LIBRARY, Page, luminance, strings

FETCHING = {"src", "href", "data", "action", "poster", "srcset", "formaction", "background"}


@pytest.mark.parametrize("name", sorted(made.EVERY))
def test_all_that_the_outline_says_stands_on_the_page(
    name: str, html: Callable[[str], str]
) -> None:
    page = Page(html(name))
    assert page.open == []
    text = "".join(page.text)
    for said in strings(to_template_data(document(made.EVERY[name]()))):
        assert said in text


def test_the_sections_stand_in_the_order_of_the_outline(html: Callable[[str], str]) -> None:
    titles = [section.title for section in document(made.nonconforming()).sections]
    found = re.findall(r"<h2[^>]*>.*?</span> (.*?)</h2>", html("nonconforming"))
    assert found == titles
    assert len(titles) == len(SECTIONS) - 1  # nothing is said of repeated poses


@pytest.mark.parametrize("name", ["nonconforming", "hostile"])
def test_the_page_fetches_nothing(name: str, html: Callable[[str], str]) -> None:
    page = Page(html(name))
    for _, attributes in page.tags:
        for key in FETCHING & attributes.keys():
            assert re.match(r"#|data:image/png;base64,", attributes[key] or "#")
    policy = [a["content"] for t, a in page.tags if t == "meta" and "http-equiv" in a]
    assert policy
    assert "default-src 'none'" in str(policy[0])


def test_hostile_words_are_shown_and_never_run(html: Callable[[str], str]) -> None:
    benign, hostile = Page(html("nonconforming")), Page(html("hostile"))
    assert [t for t, _ in benign.tags] == [t for t, _ in hostile.tags]
    assert "<script>alert(1)</script>" in "".join(hostile.text)
    assert "{{ 7*7 }}" in "".join(hostile.text)
    assert "\x1b" not in html("hostile")
    assert "\u202e" not in html("hostile")
    html("hostile").encode()  # half a surrogate would refuse


def test_the_same_results_give_the_same_page(html: Callable[[str], str]) -> None:
    again = reports.render_html(made.nonconforming())
    assert again.replace(LIBRARY, "") == html("nonconforming")


def test_the_plotting_library_is_there_once_and_only_where_needed() -> None:
    assert reports.render_html(made.nonconforming()).count(LIBRARY) == 1
    assert LIBRARY not in reports.render_html(made.nothing())


def test_the_plotting_library_cannot_end_the_element_it_stands_in() -> None:
    assert "</script" not in LIBRARY


def test_every_picture_has_words_and_every_table_headers(html: Callable[[str], str]) -> None:
    page = Page(html("nonconforming"))
    for tag, attributes in page.tags:
        if tag == "img":
            assert attributes["alt"]
        if "plot" in (attributes.get("class") or "").split():
            assert attributes["aria-label"]
        if tag == "th":
            assert attributes["scope"] in ("col", "row")
    tables = sum(tag == "table" for tag, _ in page.tags)
    assert sum(tag == "thead" for tag, _ in page.tags) == tables > 8


def test_what_is_unknown_is_a_dash_and_not_a_word_of_the_program(
    html: Callable[[str], str],
) -> None:
    for name in ("nulls", "nothing"):
        text = "".join(Page(html(name)).text)
        assert "–" in text
        assert not re.search(r"\b(None|nan|NaN|null|inf)\b", text)


@pytest.mark.parametrize("scheme", [0, 1])
def test_text_and_lines_stand_out_from_the_paper_as_wcag_asks(scheme: int) -> None:
    paper = luminance(PALETTE["paper"][scheme])
    for role, least in {"ink": 7, "muted": 4.5, "measured": 4.5, "encoder": 3, "resolved": 3,
                        "tolerance": 4.5}.items():  # fmt: skip
        own = luminance(PALETTE[role][scheme])
        assert (max(own, paper) + 0.05) / (min(own, paper) + 0.05) >= least, role
