"""Remake the README's figure, a report's first page: `python -m tests.support.figures`."""

from collections.abc import Callable
from pathlib import Path
from typing import cast

import typst

from reports import Results
from reports.format import pdf
from reports.session import document
from verify import analyse, open_session

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "sample_sessions" / "multi_joint_fault_6r"
FIGURE = ROOT / "docs" / "report.png"
PIXELS_PER_INCH = 110  # an A4 page a little wider than a README's column: its small print is read
_compile = cast("Callable[..., bytes | list[bytes]]", typst.compile)  # as in reports/format/pdf.py


def first_page(results: Results) -> bytes:
    """Set a report and draw its first page, PNG."""
    files = pdf.typst_files(document.document(results))
    pages = _compile(files, format="png", ppi=PIXELS_PER_INCH, timestamp=0, **pdf.FONTS)
    return pages[0] if isinstance(pages, list) else pages


def remake() -> None:
    """Measure the sample and draw the page."""
    FIGURE.write_bytes(first_page(analyse(open_session(SAMPLE))))
    print(FIGURE.relative_to(ROOT))


if __name__ == "__main__":
    remake()
