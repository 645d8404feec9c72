"""Documents of every kind, rendered once, and their parts."""

import base64
import shutil
import subprocess
import zlib
from collections.abc import Callable
from functools import cache, partial
from html.parser import HTMLParser
from typing import Any

import pytest
from plotly.offline import get_plotlyjs

import reports
from reports.document import charts
from reports.document.blocks import Document, Table, collect_figures, to_template_data
from reports.document.charts import Chart, Path
from reports.format import pdf as pdf_format
from reports.render import DOCUMENTS
from reports.results import Results
from tests.support.reports import calibration, fleet, grasp, identification, plan, session


def tables(of: Document) -> dict[str, Table]:
    """Its tables by their captions."""
    return {
        block.caption: block
        for section in of.sections
        for block in section.blocks
        if isinstance(block, Table)
    }


# left out of what is tested: two million letters
LIBRARY = base64.b64encode(zlib.compress(get_plotlyjs().encode(), 4)).decode()
EVERY: dict[str, Callable[[], Results]] = {
    **session.EVERY,
    "good": calibration.good, "doubtful": calibration.doubtful,
    "uncalibrated": partial(Results, {"kind": "calibration"}, {}, {}),
    "motion": calibration.motion, "fixture": calibration.fixture,
    "bare": partial(Results, {"kind": "registration"}, {}, {}),
    "held": calibration.held, "not_held": calibration.not_held, "board": calibration.board,
    "unchecked": partial(Results, {"kind": "calibration", "method": "check"}, {}, {}),
    "fleet": fleet.changed,
    "grab": grasp.filmed, "identification": partial(identification.made, 1.0, outlying=True),
    "plan": plan.planned,
}  # fmt: skip
made_of = cache(lambda name: EVERY[name]())
html_of = cache(lambda name: page_of(made_of(name)))
files_of = cache(lambda name: pdf_format.typst_files(document_of(name)))
pdf_of = cache(lambda name: pdf_format.typeset(files_of(name)))


@cache
def document_of(name: str) -> Document:
    results = made_of(name)
    return DOCUMENTS[results.summary.get("kind", "run")](results)


def page_one(of: Document) -> str:
    """What page one says: the text of all that stands before the evidence, drawings apart."""
    answer = [section for section in of.sections if section.part == "page"]
    return " ".join(strings(to_template_data(tuple(answer))))


def drawing_of(name: str, figure: str) -> Chart | Path:
    """A chart of a report."""
    drawing = collect_figures(document_of(name))[figure]
    assert isinstance(drawing, Chart | Path)
    return drawing


def chart_of(name: str, figure: str) -> Chart:
    """A chart of a report, in a plane."""
    drawing = drawing_of(name, figure)
    assert isinstance(drawing, Chart)
    return drawing


def page_of(results: Results) -> str:
    """The page of results without the plotting library."""
    return reports.render_html(results).replace(LIBRARY, "")


def pdf_text_of(name: str) -> str:
    """The text of the PDF of that name."""
    return pdf_text(pdf_of(name))


def pdf_text(pdf: bytes) -> str:
    """The text of a PDF as a reader copies it; skip without pdftotext."""
    tool = shutil.which("pdftotext")
    if tool is None:
        pytest.skip("pdftotext is not installed (poppler-utils)")
    command = [tool, "-layout", "-", "-"]
    return subprocess.run(command, check=True, capture_output=True, input=pdf).stdout.decode()


VOID = {"meta", "br", "img", "link", "input", "hr"}


class Page(HTMLParser):
    """What a browser would see: text outside scripts, elements, attributes that fetch."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.text: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"{tag} closes another element"

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.text.append(data)


def strings(value: Any) -> list[str]:
    if isinstance(value, str):
        return [value]
    if isinstance(value, dict):
        return [s for key, item in value.items() if key in SHOWN for s in strings(item)]
    return [s for item in value for s in strings(item)] if isinstance(value, list) else []


SHOWN = {"title", "subtitle", "footer", "sections", "blocks", "label", "sentence", "remarks",
         "text", "items", "caption", "head", "rows", "notes"}  # fmt: skip


def luminance(colour: str) -> float:
    channels = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def coloured(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: coloured(item) for key, item in value.items()}
    if isinstance(value, list):
        return [coloured(item) for item in value]
    if isinstance(value, str) and value.startswith("role:"):
        return charts.PALETTE[value.removeprefix("role:").partition("|")[0]][0][:7]
    return value
