import json
import re
from collections.abc import Callable

import pytest
import typst

import reports
from reports.document.blocks import Table
from reports.format import pdf as pdf_format
from reports.session.document import document
from tests.support.reports import made
from tests.support.reports.page import files_of


def test_the_same_results_give_the_same_pdf(pdf: Callable[[str], bytes]) -> None:
    assert reports.render_pdf(made.nonconforming()) == pdf("nonconforming")


def test_nothing_in_the_pdf_tells_when_it_was_made(pdf: Callable[[str], bytes]) -> None:
    assert b"CreationDate" not in pdf("nonconforming")
    assert b"ModDate" not in pdf("nonconforming")


@pytest.mark.parametrize("name", ["nothing", "nulls", "hostile"])
def test_the_sections_stand_in_the_order_of_the_outline(name: str) -> None:
    results = made.EVERY[name]()
    found = json.loads(typst.query(files_of(name), "heading", field="body", **pdf_format.FONTS))
    titles = [section.title for section in document(results).sections]
    assert [heading["text"] for heading in found] == titles


def test_every_number_of_every_table_can_be_read_out(pdf_text: Callable[[str], str]) -> None:
    text = re.sub(r"\s+", "", pdf_text("nonconforming"))
    for section in document(made.nonconforming()).sections:
        for block in section.blocks:
            if isinstance(block, Table):
                for row in block.rows:
                    for cell in row:
                        if re.fullmatch(r"[-+−±<>0-9. %]+", cell.text):
                            assert re.sub(r"\s+", "", cell.text) in text


def test_the_verdict_stands_on_the_first_page(pdf_text: Callable[[str], str]) -> None:
    first = pdf_text("nonconforming").split("\f")[0]
    assert "add −0.400° to its reading" in first
    assert "The robot does not conform" in first


def test_what_is_unknown_is_a_dash(pdf_text: Callable[[str], str]) -> None:
    for name in ("nulls", "nothing"):
        text = pdf_text(name)
        assert "–" in text
        assert not re.search(r"\b(None|none|nan|NaN|null|inf)\b", text.replace("A dash: none", ""))


def test_hostile_words_are_set_as_they_are(pdf_text: Callable[[str], str]) -> None:
    text = pdf_text("hostile")
    assert "<script>alert(1)</script>" in text
    assert "*a*" in text
    assert "{{ 7*7 }}" in text


def test_a_hash_can_be_copied_whole(pdf_text: Callable[[str], str]) -> None:
    assert "sha256:" + "3f" * 32 in pdf_text("nonconforming")
