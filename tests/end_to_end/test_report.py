"""`verify report` as a user types it: logo, owner, templates; what it refuses."""

import shutil
from pathlib import Path

import pytest

import reports
from tests.support.command import sample_results, verify

SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 4 1"><rect width="4" height="1"/></svg>'


@pytest.fixture(scope="module")
def analysed() -> reports.Results:
    return sample_results("multi_joint_fault_6r")


@pytest.fixture
def out(analysed: reports.Results, tmp_path: Path) -> Path:
    """A results folder with reports that stand there already."""
    folder = tmp_path / "out"
    reports.write(analysed, folder / "results")
    for name in ("report.html", "report.pdf"):
        (folder / name).write_text("as it was")
    return folder


def test_a_report_is_built_again_with_a_logo_and_an_owner(out: Path, tmp_path: Path) -> None:
    (tmp_path / "logo.svg").write_text(SVG)
    wish = ("--logo", tmp_path / "logo.svg", "--owner", "Prüflabor, Halle 3")
    message = verify("report", out, *wish)
    assert (message.status, message.err) == (0, "")
    page, pdf = ((out / f"report.{kind}").read_bytes() for kind in ("html", "pdf"))
    text = page.decode()
    assert "The robot does not conform" in text
    assert "Prüflabor, Halle 3" in text
    assert text.index("data:image/svg+xml") < text.index("<h1>")
    assert pdf[:5] == b"%PDF-"


@pytest.mark.parametrize(
    ("option", "name", "content", "message"),
    [
        ("--logo", "x.png", "no picture", "x.png: is neither"),
        ("--owner", "", None, "--owner: is empty"),
        ("--template", "t/report.html.j2", "{{ x }}", "line 1: 'x' is undefined"),
        ("--template", "t/report.typ", "#x", "line 1: unknown variable: x"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_leaves_the_reports_as_they_were(
    out: Path, tmp_path: Path, option: str, name: str, content: str | None, message: str
) -> None:
    given = tmp_path / name
    if content is not None:
        given.parent.mkdir(exist_ok=True)
        given.write_text(content)
        given = given.parent if option == "--template" else given
    outcome = verify("report", out, option, name if option == "--owner" else given)
    assert message in outcome.refusal
    assert {(out / n).read_text() for n in ("report.html", "report.pdf")} == {"as it was"}


def test_a_template_changes_the_page_and_a_folder_moved_is_no_obstacle(
    out: Path, tmp_path: Path
) -> None:
    own = tmp_path / "templates of mine"
    own.mkdir()
    (own / "report.html.j2").write_text("<p>{{ document.title }} | {{ words.page }}</p>")
    moved = tmp_path / "moved here"
    shutil.move(out, moved)
    assert verify("report", moved, "--template", own).status == 0
    page = (moved / "report.html").read_text(encoding="utf-8")
    assert page == "<p>Encoder verification of iust_6r | page</p>"


def test_a_file_or_nothing_in_place_of_a_report_s_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("<html>")
    assert (
        "report.html: is a file; the folder of a report"
        in verify("report", tmp_path / "report.html").refusal
    )
    assert "lost: does not exist; the folder" in verify("report", tmp_path / "lost").refusal
