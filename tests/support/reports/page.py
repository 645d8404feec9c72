"""A document's parts, as tests look them up."""

from functools import cache
from html.parser import HTMLParser
from typing import Any

from plotly.offline import get_plotlyjs

import reports
from reports.document import charts
from reports.document.blocks import Document, Table
from reports.format import pdf as pdf_format
from reports.session.document import document
from tests.support.reports import made


def tables(of: Document) -> dict[str, Table]:
    """Its tables by their captions."""
    return {
        block.caption: block
        for section in of.sections
        for block in section.blocks
        if isinstance(block, Table)
    }


LIBRARY = get_plotlyjs()  # left out of what is tested: five million letters
html_of = cache(lambda name: reports.render_html(made.EVERY[name]()).replace(LIBRARY, ""))
files_of = cache(lambda name: pdf_format.typst_files(document(made.EVERY[name]())))
pdf_of = cache(lambda name: pdf_format.typeset(files_of(name)))
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
        return charts.PALETTE[value.removeprefix("role:")][0][:7]
    return value
