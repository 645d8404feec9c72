"""A report as pages, set by typst. The template is fixed; what varies reaches it as data."""

import base64
import json
import os
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import typst

from reports.document.blocks import Document, collect_figures, to_template_data, unbroken
from reports.format import svg
from reports.format.branding import DEFAULT_BRANDING, LANGUAGE, WORDS, Look
from reports.format.lettering import FONTS as FONTS_FOLDER
from reports.format.pictures import compact
from reports.results import ReportError

TEMPLATES = Path(__file__).with_name("templates")
TEMPLATE_FILE = "report.typ"
LINE_WIDTH_MM, MAX_PICTURE_HEIGHT_MM = 170.0, 85.0  # a third of a page: words fit beside it
FONTS: dict[str, Any] = {
    "ignore_system_fonts": True,
    "font_paths": [str(FONTS_FOLDER)],
}
_compile = cast("Callable[..., bytes]", typst.compile)  # its types leave out files in memory


def pages(document: Document, look: Look = DEFAULT_BRANDING) -> bytes:
    """Render a document as PDF, the same bytes each time: no font of the machine is used.

    ReportError: a template of the user's own has an error.
    """
    files = typst_files(document, look)
    own = look.templates if look.templates and (look.templates / TEMPLATE_FILE).is_file() else None
    return typeset(files) if own is None else _typeset_custom(own, files)


def typeset(files: dict[str, bytes]) -> bytes:
    """Let typst set the files that `typst_files` made."""
    return _compile(files, format="pdf", timestamp=0, **FONTS)


def _typeset_custom(folder: Path, files: dict[str, bytes]) -> bytes:
    """Let typst set a template of the user's own; it reads files of its folder, and no others."""
    own = files | {"shipped.typ": files["main.typ"], "main.typ": _read_file(folder / TEMPLATE_FILE)}
    try:
        return _compile(own, format="pdf", timestamp=0, root=str(folder), **FONTS)
    except (typst.TypstError, RuntimeError) as problem:
        place = _diagnostic_place(folder, str(getattr(problem, "diagnostic", "")))
        remedy = "Correct it: docs/reports.md lists the data that it gets."
        raise ReportError(place, str(problem), "a typst template is expected", remedy) from None


def _diagnostic_place(folder: Path, diagnostic: str) -> str:
    """Name the file and line that typst complains of, in the user's own names."""
    found = re.search(r"─ (.+?):(\d+):\d+\n", diagnostic)
    if found is None:
        return str(folder / TEMPLATE_FILE)
    name = os.path.relpath(found[1], folder)
    return f"{folder / (TEMPLATE_FILE if name == 'main.typ' else name)}, line {found[2]}"


def _read_file(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as problem:
        found = f"cannot be read ({problem.strerror})"
        raise ReportError(path, found, "a typst template is expected", "") from None


def typst_files(document: Document, look: Look = DEFAULT_BRANDING) -> dict[str, bytes]:
    """Make the files that typst reads: the template, the text as JSON, the drawings."""
    drawn = {}
    files = {"main.typ": (TEMPLATES / TEMPLATE_FILE).read_bytes()}
    for name, content in collect_figures(document).items():
        if isinstance(content, bytes):
            drawn[name] = {"file": f"{name}.svg", "width": _picture_width(content)}
            files[f"{name}.svg"] = _png_in_svg(content)
        else:
            drawn[name] = {"file": f"{name}.svg", "width": svg.relative_width(content)}
            files[f"{name}.svg"] = svg.svg(content)
    if look.logo is not None:
        files["logo.svg"] = (
            look.logo.content if look.logo.is_svg else _png_in_svg(look.logo.content)
        )
    data = {
        "document": to_template_data(document, unbroken),
        "figures": drawn,
        "words": WORDS,
        "language": LANGUAGE,
        "logo": look.logo and {"file": "logo.svg", **look.logo.size},
        "owner": look.owner,
    }
    files["report.json"] = json.dumps(data).encode()
    return files


def _picture_width(png: bytes) -> float:
    """What share of the line a picture takes: all, unless it were too high then."""
    width, height = struct.unpack(">II", png[16:24])  # IHDR, the first chunk of every PNG
    return min(1.0, MAX_PICTURE_HEIGHT_MM / LINE_WIDTH_MM * float(width) / max(float(height), 1.0))


def _png_in_svg(png: bytes) -> bytes:
    """Wrap a PNG in an SVG: typst's files in memory must be text."""
    width, height = struct.unpack(">II", png[16:24])  # IHDR, the first chunk of every PNG
    size = f'width="{width}" height="{height}"'
    kind, content = compact(png)
    picture = base64.b64encode(content).decode()
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
        f'<image {size} href="data:{kind};base64,{picture}"/></svg>'
    ).encode()
