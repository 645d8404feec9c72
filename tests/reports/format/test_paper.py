"""Reports on paper: pages that are full, and nothing beyond their margins."""

from pathlib import Path

import pytest

from tests.support.reports import looks
from tests.support.reports.page import pdf_of

MARGIN = 19 / 210  # of an A4 page, 20 mm less a millimetre for letters that lean out
RUNS = ("nonconforming", "undecided", "conforming")
MIN_PAGES = 5  # of a run's report

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", [*RUNS, *looks.KINDS])
def test_no_page_on_paper_is_half_empty_and_nothing_leaves_the_margins(
    tmp_path: Path, name: str
) -> None:
    pages = looks.printed_pages(pdf_of(name), tmp_path)
    assert len(pages) > (MIN_PAGES if name in RUNS else 0)
    assert looks.half_empty(pages) == []
    assert looks.beyond_margin(pages, MARGIN) == []
