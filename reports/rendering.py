"""Results to pages: `report.html` and `report.pdf`, in the look that the user asks for."""

from collections.abc import Callable
from pathlib import Path

from reports import (
    branding,
    calibration,
    fleet,
    grab,
    html,
    identification,
    outline,
    pdf,
    plan,
    registration,
)
from reports.blocks import Document
from reports.branding import PLAIN, Look
from reports.errors import ReportError
from reports.results import Results

OUTLINES: dict[str, Callable[[Results], Document]] = {
    "run": outline.document,
    "calibration": calibration.document,
    "registration": registration.document,
    "fleet": fleet.document,
    "grab": grab.document,
    "identification": identification.document,
    "plan": plan.document,
}


def look(
    *,
    logo: Path | None = None,
    owner: str | None = None,
    templates: Path | None = None,
) -> Look:
    """Read how a report is to look; nothing given is the usual look.

    Args:
        logo: a PNG or SVG.
        owner: a line at the top: whose report it is.
        templates: a folder with report.html.j2, report.css or report.typ.

    Raises:
        ReportError: one of them cannot be used.
    """
    return Look(
        logo=None if logo is None else branding.logo(logo),
        owner="" if owner is None else branding.owner(owner),
        templates=None if templates is None else branding.templates(templates),
    )


def render_html(results: Results, look: Look = PLAIN) -> str:
    """Render results as one page that opens offline; the same results give the same text.

    Raises:
        ReportError: results of a kind that this version does not know; a template of the user's
            own with an error.
    """
    return html.page(_document(results), look)


def render_pdf(results: Results, look: Look = PLAIN) -> bytes:
    """Render results as a PDF; the same results give the same bytes.

    Raises:
        ReportError: as of `render_html`.
    """
    return pdf.pages(_document(results), look)


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
