"""Reports: results in, `report.html`, `report.pdf` and a results folder out.

A leaf: it knows tables, words and pages, and nothing of cameras, robots or `verify`. What a report
says follows the results' kind: a run's, a calibration's from boards, a robot's registration.
"""

from collections.abc import Callable

from reports import calibration, html, outline, pdf, registration
from reports.blocks import Document
from reports.errors import ReportError
from reports.results import Results, read, write

__all__ = ["ReportError", "Results", "read", "render_html", "render_pdf", "write"]

OUTLINES: dict[str, Callable[[Results], Document]] = {
    "run": outline.document,
    "calibration": calibration.document,
    "registration": registration.document,
}


def render_html(results: Results) -> str:
    """Render results as one page that opens offline; the same results give the same text.

    Raises:
        ReportError: results of a kind that this version does not know.
    """
    return html.page(_document(results))


def render_pdf(results: Results) -> bytes:
    """Render results as a PDF; the same results give the same bytes.

    Raises:
        ReportError: results of a kind that this version does not know.
    """
    return pdf.pages(_document(results))


def _document(results: Results) -> Document:
    kind = str(results.summary.get("kind", "run"))
    if kind not in OUTLINES:
        raise ReportError(
            "results.json",
            f'its kind is "{kind}"',
            f"this version reports {', '.join(OUTLINES)}",
            "Use the version of verify that wrote it.",
        )
    return OUTLINES[kind](results)
