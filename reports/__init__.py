"""Reports: results in, `report.html`, `report.pdf` and a results folder out.

A leaf: it knows tables, words and pages, and nothing of cameras, robots or `verify`.
"""

from reports import html, pdf
from reports.errors import ReportError
from reports.outline import document
from reports.results import Results, read, write

__all__ = ["ReportError", "Results", "read", "render_html", "render_pdf", "write"]


def render_html(results: Results) -> str:
    """Render results as one page that opens offline; the same results give the same text."""
    return html.page(document(results))


def render_pdf(results: Results) -> bytes:
    """Render results as a PDF; the same results give the same bytes."""
    return pdf.pages(document(results))
