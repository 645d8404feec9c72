"""The first page of a report as a picture, from the folder that its command wrote."""

from collections.abc import Callable
from pathlib import Path
from typing import cast

import typst

from reports import Results
from reports.document.blocks import Document
from reports.format import pdf
from reports.render import DOCUMENTS
from verify.io.results import read_results

_compile = cast("Callable[..., bytes | list[bytes]]", typst.compile)  # as in reports/format/pdf.py


def document(results: Results) -> Document:
    """Lay a report of any kind out."""
    return DOCUMENTS[str(results.summary.get("kind", "run"))](results)


def first_page(laid_out: Document, pixels_per_inch: float) -> bytes:
    """Set a report and draw its first page, PNG."""
    files = pdf.typst_files(laid_out)
    pages = _compile(files, format="png", ppi=pixels_per_inch, timestamp=0, **pdf.FONTS)
    return pages[0] if isinstance(pages, list) else pages


def first_page_of(out: Path, pixels_per_inch: float) -> bytes:
    """Draw the first page of the report in a folder, PNG."""
    return first_page(document(read_results(out)), pixels_per_inch)
