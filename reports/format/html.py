"""A report as one page that opens without a network: tables, plots that zoom, a style for print."""

import base64
import json
import traceback
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import plotly.offline
from jinja2.sandbox import ImmutableSandboxedEnvironment
from markupsafe import Markup

from reports.document import charts, glossary
from reports.document.blocks import (
    Document,
    collect_figures,
    collect_films,
    to_template_data,
    unbroken,
)
from reports.format import plotly as format_plotly
from reports.format.branding import DEFAULT_BRANDING, LANGUAGE, WORDS, Look
from reports.format.pictures import compact
from reports.results import ReportError

TEMPLATES = Path(__file__).with_name("templates")
PAGE, STYLE = "report.html.j2", "report.css"
MAX_PAGE_BYTES = 3_000_000  # of a page with films in it: more is slow to send and to open


def page(document: Document, look: Look = DEFAULT_BRANDING) -> str:
    """HTML of a document, the same each time; ReportError: an error in the user's own template."""
    drawings = collect_figures(document)
    plots = {
        name: format_plotly.specification(drawing)
        for name, drawing in drawings.items()
        if not isinstance(drawing, bytes)
    }
    compacted = {n: compact(png) for n, png in drawings.items() if isinstance(png, bytes)}
    data = {
        "document": to_template_data(document, unbroken),
        "palette": {role: {"light": a, "dark": b} for role, (a, b) in charts.PALETTE.items()},
        "plots": _for_script({"palette": charts.PALETTE, "plots": plots}),
        "pictures": {name: _base64(picture) for name, (_, picture) in compacted.items()},
        "picture_types": {name: kind for name, (kind, _) in compacted.items()},
        "films": {name: _base64(film) for name, film in collect_films(document).items()},
        "plotly": plotly.offline.get_plotlyjs() if plots else "",
        "library": _packed_plotly() if plots else "",
        "terms": [
            {"anchor": glossary.anchor(term), "term": term, "meaning": meaning}
            for term, meaning in glossary.terms_of(document).items()
        ],
        "style": _read_template(STYLE),
        "own_style": _custom_style(look),
        "script": _read_template("report.js"),
        "tables": _read_template("fleet.js") if document.sortable else "",
        "words": WORDS,
        "language": LANGUAGE,
        "logo": look.logo and {"address": look.logo.address, **look.logo.size},
        "owner": look.owner,
    }  # fmt: skip
    text = _render(data, look)
    if data["films"] and len(text.encode()) > MAX_PAGE_BYTES:
        text = _render(data | {"films": {}}, look)  # it names the file instead
    return text


def _render(data: dict[str, Any], look: Look) -> str:
    if look.templates is None or not (look.templates / PAGE).is_file():
        return _template().render(data)
    return _render_custom(look.templates, data)


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


@cache
def _template() -> jinja2.Template:
    return _environment(jinja2.FileSystemLoader(TEMPLATES)).get_template(PAGE)


def _environment(loader: jinja2.BaseLoader) -> jinja2.Environment:
    environment = ImmutableSandboxedEnvironment(  # a user's template sees data only
        loader=loader,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["with_term"] = _with_term
    return environment


@cache
def _packed_plotly() -> str:
    """Pack the plotting library: deflated and as base64 it takes two fifths of its text."""
    packed = zlib.compress(plotly.offline.get_plotlyjs().encode(), 4)  # more takes twice as long
    return base64.b64encode(packed).decode()


def _with_term(text: str) -> Markup:
    """Make the first term of a heading a button that shows its meaning."""
    found = glossary.find_term(text)
    if found is None:
        return Markup.escape(text)
    start, end, term = found
    button = '<button type="button" class="term" popovertarget="{}" title="{}">{}</button>'
    inner = Markup(button).format(glossary.anchor(term), glossary.TERMS[term], text[start:end])
    return Markup.escape(text[:start]) + inner + Markup.escape(text[end:])


def _render_custom(folder: Path, data: dict[str, Any]) -> str:
    """Render a template of the user's own, which may extend `shipped/report.html.j2`."""
    own = jinja2.FileSystemLoader(folder)
    ours = jinja2.PrefixLoader({"shipped": jinja2.FileSystemLoader(TEMPLATES)})
    environment = _environment(jinja2.ChoiceLoader([own, ours]))
    try:
        return environment.get_template(PAGE).render(data)
    except jinja2.TemplateSyntaxError as problem:
        place = f"{problem.filename or folder / PAGE}, line {problem.lineno}"
        raise _template_error(place, problem) from None
    except Exception as problem:  # whatever an expression in it can raise
        raise _template_error(_template_line(problem, folder), problem) from None


def _template_line(problem: Exception, folder: Path) -> str:
    """Name the template's line in which something went wrong."""
    lines = [
        f"{frame.filename}, line {frame.lineno}"
        for frame in traceback.extract_tb(problem.__traceback__)
        if Path(frame.filename).is_relative_to(folder)
    ]
    return lines[-1] if lines else str(folder / PAGE)


def _template_error(place: str, problem: Exception) -> ReportError:
    found = f"{problem}".rstrip(".") or type(problem).__name__
    expected = "a Jinja2 template is expected"
    return ReportError(
        place, found, expected, "Correct it: docs/reports.md lists the data that it gets."
    )


def _custom_style(look: Look) -> str:
    """Give the user's own styles, which come after ours and so prevail."""
    path = look.templates / STYLE if look.templates is not None else None
    if path is None or not path.is_file():
        return ""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        expected, remedy = "a style sheet is expected", "Save it again as UTF-8."
        raise ReportError(path, "cannot be read as text", expected, remedy) from None
    if "</" in text:
        raise ReportError(path, 'holds "</"', "a style sheet has no markup", "Take it out.")
    return text


def _read_template(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def _for_script(value: Any) -> str:
    """Write JSON that no parser of HTML can take for markup."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
