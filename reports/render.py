"""Results to pages: `report.html` and `report.pdf`, in the look that the user asks for."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from reports.calibration import document
from reports.document.blocks import Document, collect_figures
from reports.document.charts import Chart
from reports.document.charts import Path as SpacePath
from reports.fleet import document as fleet_document
from reports.format import branding, html, pdf
from reports.format.branding import DEFAULT_BRANDING, Look
from reports.grasp import document as grasp_document
from reports.identification import document as identification_document
from reports.plan import document as plan_document
from reports.registration import document as registration_document
from reports.results import ReportError, Results
from reports.session import document as session_document

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOCUMENTS: dict[str, Callable[[Results], Document]] = {
    "run": session_document.document,
    "calibration": document.document,
    "registration": registration_document.document,
    "fleet": fleet_document.document,
    "grab": grasp_document.document,
    "identification": identification_document.document,
    "plan": plan_document.document,
}


def look(
    *, logo: Path | None = None, owner: str | None = None, templates: Path | None = None
) -> Look:
    """How a report is to look; nothing given is the usual look; ReportError: one cannot be used.

    `logo`: a PNG or SVG; `owner`: a line at the top, whose report it is; `templates`: a folder with
    report.html.j2, report.css or report.typ.
    """
    return Look(
        logo=None if logo is None else branding.read_logo(logo),
        owner="" if owner is None else branding.check_owner(owner),
        templates=None if templates is None else branding.check_templates(templates),
    )


def render_html(results: Results, look: Look = DEFAULT_BRANDING) -> str:
    """Render results as one page that opens offline; the same results give the same text.

    Raises:
        ReportError: a kind that this version does not know; an error in the user's own template.
    """
    return html.page(_document(results), look)


def render_pdf(results: Results, look: Look = DEFAULT_BRANDING) -> bytes:
    """Render results as a PDF, the same bytes each time; raises ReportError as `render_html`."""
    return pdf.pages(_document(results), look)


def render_report(results: Results, look: Look = DEFAULT_BRANDING) -> tuple[str, bytes]:
    """Render results as a page and as a PDF at once, from one layout; as the two above do each."""
    document = _document(results)
    with ThreadPoolExecutor(1) as typesetter:  # typst and zlib let other threads run
        pages = typesetter.submit(pdf.pages, document, look)
        return html.page(document, look), pages.result()


def charts(results: Results) -> dict[str, Chart | SpacePath]:
    """Collect what the report of some results draws, by name; recorded pictures apart."""
    figures = collect_figures(_document(results))
    return {name: one for name, one in figures.items() if not isinstance(one, bytes)}


def draw(chart: Chart | SpacePath) -> "Figure":
    """Draw a chart as a matplotlib figure."""
    from reports.format import matplotlib  # late: no report needs it

    return matplotlib.figure(chart)


def _document(results: Results) -> Document:
    kind = str(results.summary.get("kind", "run"))
    if kind not in DOCUMENTS:
        raise ReportError(
            "results.json",
            f'its kind is "{kind}"',
            f"this version reports {', '.join(DOCUMENTS)}",
            "Use the version of verify that wrote it.",
        )
    return DOCUMENTS[kind](results)
