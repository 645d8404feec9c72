"""Reports: results in, `report.html`, `report.pdf` and a results folder out.

A leaf: it knows tables, words and pages, and nothing of cameras, robots or `verify`. What a report
says follows the results' kind: a run's, a calibration's from boards, an interim check's, a robot's
registration.

What draws and lays out pages is loaded when it is first asked for: it takes half a second, and
whoever only writes a results folder needs none of it.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from reports.results import ReportError, Results, packed, read, write

if TYPE_CHECKING:
    from reports.format.branding import Look
    from reports.render import charts, draw, look, render_html, render_pdf, render_report

__all__ = [
    "Look",
    "ReportError",
    "Results",
    "charts",
    "draw",
    "look",
    "packed",
    "read",
    "render_html",
    "render_pdf",
    "render_report",
    "write",
]


def __getattr__(name: str) -> object:
    """Load what makes pages."""
    if name not in __all__:
        raise AttributeError(f"module 'reports' has no attribute '{name}'")
    return getattr(import_module("reports.render"), name)
