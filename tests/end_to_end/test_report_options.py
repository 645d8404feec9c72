"""`verify report` as a user types it: languages, logo, owner, templates; what it refuses."""

import re
import shutil
from pathlib import Path

import pytest

import reports
from reports.outline import document
from tests.end_to_end.command import SAMPLES, verify
from verify import analyse, open_session

NAMES = ("quarter_circle_6r", "multi_joint_fault_6r", "multi_joint_rv_3sd")
CHOSEN = re.compile(  # descriptions that the sessions and robots bring along
    r"quarter circle about joint 1, both bases following the arm"
    r"|all joints in motion, (one encoder at fault|healthy encoders)|smooth motion of all joints"
)
SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 4 1"><rect width="4" height="1"/></svg>'


@pytest.fixture(scope="module")
def analysed() -> dict[str, reports.Results]:
    return {name: analyse(open_session(SAMPLES / name)) for name in NAMES}


@pytest.fixture
def out(analysed: dict[str, reports.Results], tmp_path: Path) -> Path:
    """A results folder with reports that stand there already."""
    folder = tmp_path / "out"
    reports.write(analysed["multi_joint_fault_6r"], folder / "results")
    for name in ("report.html", "report.pdf"):
        (folder / name).write_text("as it was")
    return folder


def test_the_samples_reports_are_german_in_every_text(
    analysed: dict[str, reports.Results],
) -> None:
    german = reports.look(language="de").language
    for name, results in analysed.items():
        left = [t for t in german.missing(document(results)) if not CHOSEN.fullmatch(t)]
        assert left == [], name


def test_a_report_is_built_again_in_german_with_a_logo_and_an_owner(
    out: Path, tmp_path: Path
) -> None:
    (tmp_path / "logo.svg").write_text(SVG)
    wish = ("--language", "de", "--logo", tmp_path / "logo.svg", "--owner", "Prüflabor, Halle 3")
    said = verify("report", out, *wish)
    assert (said.status, said.err) == (0, "")
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Der Roboter ist nicht konform" in page
    assert "zu viel an: " in page
    assert "Prüflabor, Halle 3" in page
    assert page.index("data:image/svg+xml") < page.index("<h1>")
    assert (out / "report.pdf").read_bytes()[:5] == b"%PDF-"
    before = hash((out / "report.pdf").read_bytes()), hash(page)
    verify("report", out, *wish)
    again = (out / "report.html").read_text(encoding="utf-8")
    assert (hash((out / "report.pdf").read_bytes()), hash(again)) == before


def test_without_options_a_report_is_what_the_library_gives(
    out: Path, analysed: dict[str, reports.Results]
) -> None:
    assert verify("report", out).status == 0
    plain = reports.render_html(analysed["multi_joint_fault_6r"])
    assert hash((out / "report.html").read_text(encoding="utf-8")) == hash(plain)


def test_verbose_lists_what_stays_english(out: Path, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text('code = "nl"\n[a]\n"Verdict" = "Oordeel"\n')
    said = verify("--verbose", "report", out, "--language", tmp_path / "own.toml")
    assert said.status == 0
    lines = said.out.splitlines()
    assert "stays English: Uncertainty budget" in lines
    assert "stays English: Verdict" not in lines
    assert "Oordeel" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("option", "name", "content", "said"),
    [
        ("--language", "kl", None, '--language: there is no "kl"; en, de ship'),
        ("--language", "x.toml", "code = ", "x.toml: is no TOML"),
        ("--logo", "x.png", "no picture", "x.png: is neither"),
        ("--logo", "none.png", None, "none.png: cannot be read"),
        ("--owner", "", None, "--owner: is ''"),
        ("--template", "t", None, "t: is no folder"),
        ("--template", "t/report.html.j2", "{{ x }}", "line 1: 'x' is undefined"),
        ("--template", "t/report.typ", "#x", "line 1: unknown variable: x"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_leaves_the_reports_as_they_were(
    out: Path, tmp_path: Path, option: str, name: str, content: str | None, said: str
) -> None:
    given: str | Path = name
    if option != "--owner" and name != "kl":
        given = tmp_path / name
        if content is not None:
            given.parent.mkdir(exist_ok=True)
            given.write_text(content)
            given = given.parent if option == "--template" else given
    outcome = verify("report", out, option, given)
    assert outcome.status == 2
    assert said in outcome.err
    assert outcome.err.count("\n") == 1
    assert {(out / n).read_text() for n in ("report.html", "report.pdf")} == {"as it was"}


def test_a_template_changes_the_page_and_a_folder_moved_is_no_obstacle(
    out: Path, tmp_path: Path
) -> None:
    own = tmp_path / "templates of mine"
    own.mkdir()
    (own / "report.html.j2").write_text("<p>{{ document.title }} | {{ words.page }}</p>")
    moved = tmp_path / "moved here"
    shutil.move(out, moved)
    assert verify("report", moved, "--template", own, "--language", "de").status == 0
    page = (moved / "report.html").read_text(encoding="utf-8")
    assert page == "<p>Prüfung der Drehgeber von iust_6r | Seite</p>"
