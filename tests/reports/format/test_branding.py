"""Logos, owners and templates of the user's own: shown well, refused in one line, same bytes."""

import io
import re
import struct
import zlib
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import reports
from reports.format import pdf
from reports.format.branding import DEFAULT_BRANDING, MAX_HEIGHT_MM, MAX_WIDTH_MM, read_logo
from reports.session.document import document
from tests.support.reports import session as made
from tests.support.reports.page import LIBRARY, Page

ROOT = Path(__file__).parents[3]
HEAD = '<svg xmlns="http://www.w3.org/2000/svg" '
SVG = HEAD + 'viewBox="0 0 200 50"><rect width="200" height="50" fill="#036"/></svg>'


def png(width: int, height: int) -> bytes:
    buffer = io.BytesIO()
    matplotlib.image.imsave(buffer, np.full((height, width, 3), 120, dtype=np.uint8), format="png")
    return buffer.getvalue()


def kept(folder: Path, name: str, content: bytes | str) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def html(look: reports.Look) -> str:
    return reports.render_html(made.nothing(), look).replace(LIBRARY, "")


@pytest.mark.parametrize(
    ("name", "content", "size"),
    [
        ("wide.svg", SVG, (MAX_WIDTH_MM, MAX_WIDTH_MM / 4)),
        ("inches.svg", HEAD + 'width="2in" height="2in"/>', (MAX_HEIGHT_MM, MAX_HEIGHT_MM)),
        ("a.png", png(60, 60), (MAX_HEIGHT_MM, MAX_HEIGHT_MM)),
        ("b.png", png(900, 60), (MAX_WIDTH_MM, MAX_WIDTH_MM / 15)),
        ("upright.png", png(30, 90), (MAX_HEIGHT_MM / 3, MAX_HEIGHT_MM)),
    ],
)
def test_a_logo_fits_the_room_for_it_and_keeps_its_shape(
    tmp_path: Path, name: str, content: bytes | str, size: tuple[float, float]
) -> None:
    found = read_logo(kept(tmp_path, name, content))
    assert (found.width_mm, found.height_mm) == pytest.approx(size, abs=0.01)


@pytest.mark.parametrize(("name", "content"), [("a.svg", SVG), ("a.png", png(80, 40))])
def test_logo_and_owner_stand_above_the_title_in_both_formats(
    tmp_path: Path, name: str, content: bytes | str
) -> None:
    look = reports.look(logo=kept(tmp_path, name, content), owner='Lab <b>"A"</b> & Co')
    page = Page(html(look))
    pictures = [a for tag, a in page.tags if tag == "img"]
    assert len(pictures) == 1
    assert str(pictures[0]["src"]).startswith(f"data:image/{'svg+xml' if 'svg' in name else 'png'}")
    text = "".join(page.text)
    assert text.index('Lab <b>"A"</b> & Co') < text.index("Encoder verification of –\n")
    assert html(look) == html(look)
    first, again = (reports.render_pdf(made.nothing(), look) for _ in range(2))
    assert hash(first) == hash(again)
    assert len(first) > len(reports.render_pdf(made.nothing()))


def test_without_branding_the_report_is_unchanged() -> None:
    assert html(DEFAULT_BRANDING) == html(reports.look())
    page = html(DEFAULT_BRANDING)
    assert "owner" not in page
    assert "<img" not in page
    assert '<html lang="en">' in page
    assert "setPlotConfig" not in reports.render_html(made.nonconforming()).replace(LIBRARY, "")


FLOOD = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)  # fills the memory
FLOOD = struct.pack(">I", 13) + FLOOD + struct.pack(">I", zlib.crc32(FLOOD))
BOMB = HEAD.replace("<svg", '<!DOCTYPE svg [<!ENTITY a "aaaa">]><svg') + 'viewBox="0 0 1 1"/>'


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.png", b"not a picture", "is neither"),
        ("a.svg", "<html><body>svg</body></html>", "is neither"),
        ("a.jpg", b"\xff\xd8\xff\xe0 jpeg", "is neither"),
        ("empty.png", b"", "is neither"),
        ("cut.png", png(200, 100)[:80], "is a damaged PNG"),
        ("short.png", png(2, 2)[:12], "is a damaged PNG"),
        ("large.png", b"\x89PNG\r\n\x1a\n" + b"0" * 2_100_000, "has 2.1 MB"),
        ("thin.png", png(400, 4), "at most 20 to 1"),
        ("cut.svg", SVG[:-9], "is a damaged SVG"),
        ("bomb.png", b"\x89PNG\r\n\x1a\n" + FLOOD, "60000 x 60000 px"),
        ("bomb.svg", BOMB, "defines entities"),
        ("script.svg", HEAD + 'viewBox="0 0 2 1"><script>alert(1)</script></svg>', "a <script>"),
        ("on.svg", HEAD + 'viewBox="0 0 2 1" onload="alert(1)"/>', "runs something (onload)"),
        ("f.svg", HEAD + 'viewBox="0 0 2 1"><foreignObject/></svg>', "a <foreignObject>"),
        ("net.svg", HEAD + 'viewBox="0 0 2 1"><image href="http://x/y.png"/></svg>', "fetches"),
        ("js.svg", HEAD + 'viewBox="0 0 2 1"><a href=" javascript:alert(1)"/></svg>', "fetches"),
        ("file.svg", HEAD + 'viewBox="0 0 2 1"><image href="../secret.png"/></svg>', "fetches"),
        ("css.svg", HEAD + 'viewBox="0 0 2 1"><style>@import "x";</style></svg>', "by its style"),
        ("url.svg", HEAD + "viewBox='0 0 2 1' style='fill: url( \"http://x\")'/>", "by its style"),
        ("none.svg", HEAD + "/>", "no viewBox"),
        ("zero.svg", HEAD + 'viewBox="0 0 2 0"/>', "is 2 x 0"),
        ("nan.svg", HEAD + 'viewBox="0 0 nan inf"/>', "no viewBox"),
    ],
)
def test_an_unsafe_or_damaged_logo_is_refused_in_one_line(
    tmp_path: Path, name: str, content: bytes | str, message: str
) -> None:
    path = kept(tmp_path, name, content)
    with pytest.raises(reports.ReportError, match=re.escape(message)) as problem:
        read_logo(path)
    assert str(problem.value).startswith(str(path))
    assert "\n" not in str(problem.value)


def test_a_plain_svg_with_gradients_and_pictures_of_its_own_is_taken(tmp_path: Path) -> None:
    inner = '<linearGradient id="g"/><rect fill="url(#g)"/><use href="#g"/>'
    inner += '<style>rect { fill: url("#g") }</style><image href="data:image/png;base64,AAAA"/>'
    assert read_logo(kept(tmp_path, "a.svg", f'{HEAD}viewBox="0 0 2 1">{inner}</svg>')).is_svg
    declared = f'<?xml version="1.0"?>\n<!DOCTYPE svg>\n{SVG}'
    assert read_logo(kept(tmp_path, "b.svg", declared)).is_svg


@pytest.mark.parametrize("text", ["", "  ", "a\nb", "x" * 81, "\x1b[31m"])
def test_an_owner_that_is_no_line_is_refused(text: str) -> None:
    with pytest.raises(reports.ReportError, match="--owner: is"):
        reports.look(owner=text)


def examples() -> dict[str, str]:
    """The templates that docs/reports.md shows, by the name it gives them."""
    text = (ROOT / "docs" / "reports.md").read_text(encoding="utf-8")
    return dict(re.findall(r"`(report\.[a-z0-9.]+)`:\n\n```[a-z]*\n(.*?)```", text, re.DOTALL))


def test_the_templates_of_the_documentation_work(tmp_path: Path) -> None:
    shown = examples()
    assert set(shown) == {"report.html.j2", "report.css", "report.typ"}
    for name, content in shown.items():
        kept(tmp_path, name, content)
    look = reports.look(templates=tmp_path)
    page = html(look)
    assert "Internal use only" in page
    assert shown["report.css"].strip() in page
    assert "<h1>Encoder verification" not in page
    own, plain = (reports.render_pdf(made.nothing(), each) for each in (look, DEFAULT_BRANDING))
    assert own[:5] == b"%PDF-"
    assert hash(own) != hash(plain)
    for name in ("report.html.j2", "report.typ"):  # what is missing falls back to the default
        (tmp_path / name).unlink()
    kept(tmp_path, "report.css", "h1 { color: teal; }")
    look = reports.look(templates=tmp_path)
    assert html(look).replace("h1 { color: teal; }\n", "") == html(DEFAULT_BRANDING)
    assert hash(reports.render_pdf(made.nothing(), look)) == hash(plain)


PAGE_ERRORS = [
    ("a\n{% if %}", "line 2: Expected an expression"),
    ("a\n\n{{ document.titel }}", "line 3: 'dict object' has no attribute 'titel'"),
    ("{{ nothing_such }}", "line 1: 'nothing_such' is undefined"),
    ("{{ 1 / 0 }}", "line 1: division by zero"),
    ("x\n{% include 'other.j2' %}", "line 2"),
    ("{% extends '../report.html.j2' %}", "line 1"),
    ("{{ ''.__class__.__mro__ }}", "unsafe"),
    ("{{ document.update({}) }}", "is unsafe"),
]
TYPST_ERRORS = [
    ("= A\n#nothing()", "line 2: unknown variable: nothing"),
    ('#let doc = json("report.json")\n\n#doc.nothing', "line 3"),
    ('#import "shipped.typ": nothing', "line 1: unresolved import"),
    ('= A\n\n#read("/../../../etc/passwd")', "line 3"),
    ("#(", "line 1: unclosed delimiter"),
]


@pytest.mark.parametrize(
    ("name", "template", "message"),
    [("report.html.j2", *case) for case in PAGE_ERRORS]
    + [("report.typ", *case) for case in TYPST_ERRORS],
)
def test_a_template_error_names_its_line(
    tmp_path: Path, name: str, template: str, message: str
) -> None:
    path = kept(tmp_path, name, template)
    render = reports.render_pdf if name == "report.typ" else reports.render_html
    with pytest.raises(reports.ReportError, match=re.escape(message)) as problem:
        render(made.nothing(), reports.look(templates=tmp_path))
    assert str(problem.value).startswith(str(path))
    assert "\n" not in str(problem.value)


def test_a_typst_template_may_use_files_of_its_folder(tmp_path: Path) -> None:
    kept(tmp_path, "own.typ", '#let stamp = "STAMP"')
    kept(tmp_path, "a.png", png(20, 10))
    kept(tmp_path, "report.typ", '#import "own.typ": stamp\n#image("a.png")\n#stamp')
    look = reports.look(templates=tmp_path)
    assert pdf.pages(document(made.nothing()), look)[:5] == b"%PDF-"


def test_a_place_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    for logo in (tmp_path / "none.png", tmp_path):
        with pytest.raises(reports.ReportError, match="cannot be read"):
            read_logo(logo)
    with pytest.raises(reports.ReportError, match="holds none of them"):
        reports.look(templates=tmp_path)
    with pytest.raises(reports.ReportError, match="is no folder"):
        reports.look(templates=tmp_path / "none")


def test_a_style_sheet_that_would_end_the_style_is_refused(tmp_path: Path) -> None:
    kept(tmp_path, "report.css", "</style><script>alert(1)</script>")
    with pytest.raises(reports.ReportError, match=r'report\.css: holds "</"'):
        html(reports.look(templates=tmp_path))
