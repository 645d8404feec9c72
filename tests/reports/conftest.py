"""Documents rendered once: a PDF takes seconds."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.reports.page import html_of, pdf_of


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
