"""Documents rendered once: a PDF takes seconds."""

import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import plotly.offline
import pytest

import reports
from reports.format import pdf as pdf_format
from reports.session.document import document
from tests.support.reports import made

LIBRARY = plotly.offline.get_plotlyjs()  # left out of what is tested: five million letters
html_of = cache(lambda name: reports.render_html(made.EVERY[name]()).replace(LIBRARY, ""))
files_of = cache(lambda name: pdf_format.typst_files(document(made.EVERY[name]())))
pdf_of = cache(lambda name: pdf_format.typeset(files_of(name)))


@pytest.fixture
def html() -> Callable[[str], str]:
    return html_of


@pytest.fixture
def pdf() -> Callable[[str], bytes]:
    return pdf_of


@pytest.fixture
def pdf_text(tmp_path: Path) -> Callable[[str], str]:
    tool = shutil.which("pdftotext")
    if tool is None:
        pytest.skip("pdftotext is not installed (poppler-utils)")

    def extract(name: str) -> str:
        page = tmp_path / "report.pdf"
        page.write_bytes(pdf_of(name))
        command = [tool, "-layout", str(page), "-"]
        return subprocess.run(command, check=True, capture_output=True).stdout.decode()

    return extract
