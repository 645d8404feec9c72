"""PDFs of every kind of report."""

import json
import re
from dataclasses import replace

import pytest
import typst

import reports
from reports.document import blocks
from reports.format import pdf as pdf_format
from reports.session.certificate import certificate
from tests.support.reports.page import (
    EVERY,
    document_of,
    files_of,
    made_of,
    pdf_of,
    pdf_text,
    pdf_text_of,
    tables,
)


@pytest.mark.parametrize(
    "name",
    [
        "nonconforming",
        "motion",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("good", "fleet")),
    ],
)
def test_the_same_results_give_the_same_pdf(name: str) -> None:
    assert (reports.render_pdf(EVERY[name]()) == pdf_of(name)) is True
    assert not re.search(rb"CreationDate|ModDate", pdf_of(name))


@pytest.mark.parametrize(
    "name", sorted(EVERY.keys() - {"conforming", "no_tolerance", "undecided", "visits", "one_pair"})
)
def test_sections_are_in_the_order_of_the_document(name: str) -> None:
    found = json.loads(typst.query(files_of(name), "heading", field="body", **pdf_format.FONTS))
    titles = [section.title for section in document_of(name).sections]
    assert [heading["text"] for heading in found] == titles


def test_every_number_of_every_table_and_a_hash_can_be_copied_whole() -> None:
    text = re.sub(r"\s+", "", pdf_text_of("nonconforming"))
    every = tables(document_of("nonconforming")).values()
    for cell in (cell for table in every for row in table.rows for cell in row):
        if re.fullmatch(r"[-+−±<>0-9. %]+", cell.text):
            assert re.sub(r"\s+", "", cell.text) in text
    assert made_of("nonconforming").summary["inputs"]["rig.toml"] in text


@pytest.mark.parametrize(
    ("name", "verdict"),
    [
        ("nonconforming", "add −0.3487° to its reading"),
        ("nonconforming", "The robot does not conform"),
        ("good", "The rig is calibrated"),
        ("motion", "cannot show"),
        ("fixture", "It hides nothing"),
    ],
)
def test_the_verdict_is_on_the_first_page(name: str, verdict: str) -> None:
    assert verdict in pdf_text_of(name).split("\f")[0]


@pytest.mark.parametrize("name", ["nulls", "nothing"])
def test_an_unknown_value_is_a_dash(name: str) -> None:
    text = pdf_text_of(name)
    assert "–" in text
    assert not re.search(r"\b(None|none|nan|NaN|null|inf)\b", text)


def test_markup_in_names_is_set_as_text() -> None:
    for words in ("<script>alert(1)</script>", "*a*", "{{ 7*7 }}"):
        assert words in pdf_text_of("hostile")


def test_page_one_is_the_certificate_whole_and_what_nobody_stated_is_a_line_to_fill_in() -> None:
    first, second, *_ = pdf_text_of("nonconforming").split("\f")
    for words in ("Serial number", "Tolerance", "Error of the flange", "What to do"):
        assert words in first
    assert "Errors over time" in second
    results = made_of("nonconforming")
    stated = {"serial_number": "B3-0471", "calibrated": "2026-10-02", "issued": "2026-11-25"}
    session = results.summary["session"] | {"certificate": stated}
    facts = dict(
        certificate(replace(results, summary=results.summary | {"session": session}))
        .blocks[1]
        .items
    )
    assert (facts["Serial number"], facts["Date of issue"]) == ("B3-0471", "2026-11-25")
    assert facts["Instrument"] == "stereo rig with LEDs, calibrated 2026-10-02"
    assert facts["Owner"] == ""


@pytest.mark.parametrize("lines_before", range(28, 52))
def test_no_row_of_a_table_stands_alone_on_a_page(lines_before: int) -> None:
    rows = tuple(blocks.row(f"row{i}", "1.0") for i in range(12))
    table = blocks.Table("Rows.", "lr", ("Name", "Size"), rows)
    filled = tuple(blocks.Paragraph("above") for _ in range(lines_before))
    section = blocks.Section("one", "One", (*filled, table))
    pages = pdf_text(pdf_format.pages(blocks.lay_out("T", "S", "F", [section]))).split("\f")
    counts = [len(re.findall(r"\brow\d", page)) for page in pages]
    assert sum(counts) == 12
    assert 1 not in counts


@pytest.mark.parametrize(
    "text", ["at 1.0 s", "±0.3 mm apart", "within 5 % of it", "U (k = 2)", "3 °/h"]
)
def test_no_line_breaks_between_a_figure_and_its_unit(text: str) -> None:
    said = blocks.unbroken(text)
    assert said.replace("\N{NO-BREAK SPACE}", " ") == text
    assert not re.search(r"[\d=] | =", said)


def test_other_spaces_let_a_line_break() -> None:
    text = "20 markers of 5 sizes in 2026 say so"
    assert blocks.unbroken(text) == text
