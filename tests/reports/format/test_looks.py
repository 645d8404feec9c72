"""Reports as a reader sees them: on a phone, on a desk, by day and by night."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import reports
from reports.results import Results
from tests.support.devices.chromium import Browser, Tab
from tests.support.reports import looks
from tests.support.reports.page import made_of, pdf_of

PHONE = {"width": 390, "height": 844}
DESK = {"width": 1300, "height": 900}
MORE_PAGES = 2  # that a browser may print than the PDF has
MAX_BYTES = 3_000_000  # of a page
QUICK = ("good", "fleet", "grab")

pytestmark = pytest.mark.browser


@contextmanager
def opened(browser: Browser, folder: Path, results: Results, size: dict[str, int]) -> Iterator[Tab]:
    page = folder / "report.html"
    page.write_text(reports.render_html(results), encoding="utf-8")
    assert page.stat().st_size < MAX_BYTES
    with browser.open(page.as_uri(), **size) as tab:
        looks.wait_for_plots(tab)
        tab.page.set_default_timeout(looks.LIMIT_MS)
        yield tab
        assert tab.complaints == []


@pytest.mark.parametrize(
    "name",
    [n if n in QUICK else pytest.param(n, marks=pytest.mark.long) for n in looks.KINDS],
)
def test_a_page_can_be_read_on_a_phone_and_on_a_desk_by_day_and_night(
    browser: Browser, tmp_path: Path, name: str
) -> None:
    with opened(browser, tmp_path, made_of(name), PHONE) as tab:
        looks.show_all(tab)
        assert tab.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
        assert looks.small(tab) == []
        assert tab.evaluate(looks.CLIPPED) == []
        assert tab.evaluate(looks.TOUCHING) == []
        assert tab.evaluate(looks.CROWDED) == []
        tab.page.set_viewport_size(DESK)
        for scheme in ("light", "dark"):
            tab.page.emulate_media(color_scheme=scheme)
            tab.page.wait_for_timeout(400)  # ms: plots are drawn again
            assert tab.evaluate("document.documentElement.scrollWidth") == DESK["width"]
            assert looks.small(tab) == []
            assert tab.evaluate(looks.CLIPPED) == []
            assert looks.faint(tab) == []


def test_strips_zoom_together_terms_answer_to_keys_and_paper_has_the_pages_of_the_pdf(
    browser: Browser, tmp_path: Path
) -> None:
    with opened(browser, tmp_path, made_of("nonconforming"), DESK) as tab:
        tab.evaluate("Plotly.relayout('plot-joint_errors', {'xaxis3.range': [2, 3]})")
        for plot in ("joint_errors", "pose_errors"):
            shown = f"document.getElementById('plot-{plot}')._fullLayout.xaxis2.range"
            tab.until(f"Math.abs({shown}[0] - 2) + Math.abs({shown}[1] - 3) < 1e-9")
        tab.page.locator(".term", has_text="Tolerance").first.focus()
        meaning = tab.page.locator("#term-tolerance")
        assert not meaning.is_visible()
        tab.press("Enter")
        assert meaning.inner_text() == "tolerance: the largest error allowed, at every pose"
        tab.press("Escape")
        assert not meaning.is_visible()
        contents = "document.querySelector('nav.top').getBoundingClientRect().top"
        tab.evaluate("scrollTo({ top: 1500, behavior: 'instant' })")
        tab.until(f"{contents} === 0")
        paper = tab.page.pdf(prefer_css_page_size=True)
    own = len(looks.printed_pages(pdf_of("nonconforming"), tmp_path))
    found = len(re.findall(rb"/Type\s*/Page\b", paper))
    assert 0 < found <= own + MORE_PAGES


def test_the_certificate_s_rows_put_the_verdict_first_on_a_phone(
    browser: Browser, tmp_path: Path
) -> None:
    with opened(browser, tmp_path, made_of("nonconforming"), PHONE) as tab:
        row = "document.querySelector('#verdict tbody tr:nth-child(2)')"
        places = tab.evaluate(f"[...{row}.cells].map((cell) => cell.getBoundingClientRect().top)")
        assert len(set(places)) == len(places) == 5  # one below the other
        assert sorted(places).index(places[-1]) == 1  # behind the joint's number
