"""A report as one page that opens without a network: tables, plots that zoom, a style for print."""

import base64
import json
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import plotly.offline

from reports import charts, plotting
from reports.blocks import Document, as_data, figures

TEMPLATES = Path(__file__).with_name("templates")


def page(document: Document) -> str:
    """Render a document as HTML; the same document gives the same text."""
    drawings = figures(document)
    plots = {
        name: plotting.specification(drawing)
        for name, drawing in drawings.items()
        if not isinstance(drawing, bytes)
    }
    pictures = {
        name: base64.b64encode(drawing).decode()
        for name, drawing in drawings.items()
        if isinstance(drawing, bytes)
    }
    return _template().render(
        document=as_data(document),
        palette={role: {"light": a, "dark": b} for role, (a, b) in charts.PALETTE.items()},
        plots=_for_script({"palette": charts.PALETTE, "plots": plots}),
        pictures=pictures,
        plotly=_plotly() if plots else "",
        style=_text("report.css"),
        script=_text("report.js"),
    )


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("report.html.j2")


@cache
def _plotly() -> str:
    library: str = plotly.offline.get_plotlyjs()
    return library


def _text(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def _for_script(value: Any) -> str:
    """Write JSON that no parser of HTML can take for markup."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
