"""A report as pages, set by typst. The template is fixed; what varies reaches it as data."""

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import typst

from reports import drawing
from reports.blocks import Document, as_data, figures

TEMPLATES = Path(__file__).with_name("templates")
FONTS: dict[str, Any] = {
    "ignore_system_fonts": True,
    "font_paths": [str(Path(mpl.get_data_path()) / "fonts" / "ttf")],
}
_compile = cast("Callable[..., bytes]", typst.compile)  # its types leave out files in memory


def pages(document: Document) -> bytes:
    """Render a document as PDF; the same document gives the same bytes.

    Only fonts that typst and matplotlib bring along are used, no font of the machine.
    """
    return typeset(sources(document))


def typeset(files: dict[str, bytes]) -> bytes:
    """Let typst set the files that `sources` made."""
    return _compile(files, format="pdf", timestamp=0, **FONTS)


def sources(document: Document) -> dict[str, bytes]:
    """Make the files that typst reads: the template, the text as JSON, the drawings."""
    drawn = {}
    files = {"main.typ": (TEMPLATES / "report.typ").read_bytes()}
    for name, content in figures(document).items():
        if isinstance(content, bytes):
            drawn[name] = {"file": f"{name}.svg", "width": 1.0}
            files[f"{name}.svg"] = _framed(content)
        else:
            drawn[name] = {"file": f"{name}.svg", "width": drawing.width(content)}
            files[f"{name}.svg"] = drawing.svg(content)
    data = {"document": as_data(document), "figures": drawn}
    files["report.json"] = json.dumps(data).encode()
    return files


def _framed(png: bytes) -> bytes:
    """Wrap a PNG in an SVG: typst's files in memory must be text."""
    width, height = struct.unpack(">II", png[16:24])  # IHDR, the first chunk of every PNG
    size = f'width="{width}" height="{height}"'
    picture = base64.b64encode(png).decode()
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
        f'<image {size} href="data:image/png;base64,{picture}"/></svg>'
    ).encode()
