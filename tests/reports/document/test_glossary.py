"""Terms in headings: those of docs/glossary.md, found where a heading writes them."""

import re
from pathlib import Path

import pytest

from reports.document.glossary import TERMS, find_term, terms_of
from tests.support.reports.page import Page, document_of, html_of

GLOSSARY = Path(__file__).parents[3] / "docs" / "glossary.md"


def test_reports_explain_terms_as_the_glossary_does() -> None:
    """But for the links that lead from there to other documents."""
    rows = re.findall(r"^\| (.+?) \| (.+) \|$", GLOSSARY.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [(term, re.sub(r" \(\[.*?\]\(.*?\)\)|`", "", meaning)) for term, meaning in rows]
    assert dict(plain[1:]) == TERMS  # the first row is the head


@pytest.mark.parametrize(
    ("heading", "words", "term"),
    [
        ("Mean error ± U [°]", "Mean error", "mean error"),
        ("Correction ± U", "U", "expanded uncertainty, U"),
        ("Median u [px]", "u", "standard uncertainty, u"),
        ("Largest ê ± U [°]", "ê", "resolved error"),
        ("Pairs rejected, and why", "Pairs", "pair"),
        ("P(conform)", "conform", "conform"),
        ("Visible, new offset", "Visible", "visible share"),
        ("Unit", "", ""),
        ("Pan [°]", "Pan", "pan"),
        ("Panel", "", ""),
    ],
)
def test_a_heading_s_first_term_is_found(heading: str, words: str, term: str) -> None:
    found = find_term(heading)
    assert (("", "") if found is None else (heading[found[0] : found[1]], found[2])) == (
        words,
        term,
    )


def test_every_term_of_a_heading_has_its_meaning_on_the_page() -> None:
    page = Page(html_of("nonconforming"))
    places = {attributes["id"] for _, attributes in page.tags if "popover" in attributes}
    buttons = [a for tag, a in page.tags if tag == "button"]
    assert len(buttons) > 10
    for button in buttons:
        assert button["popovertarget"] in places
        assert button["title"] in TERMS.values()
    assert len(places) == len(terms_of(document_of("nonconforming")))
    assert not [a for tag, a in Page(html_of("fleet")).tags if tag == "button" and "term" in str(a)
                and a.get("class") != "term"]  # fmt: skip
