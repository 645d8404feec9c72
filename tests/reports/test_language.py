"""Languages: every text of every report has its German, and what is no sentence stays."""

import re
from dataclasses import replace
from datetime import date
from pathlib import Path

import pytest

import reports
from reports import calibration, fleet, grab, identification, outline, registration
from reports.blocks import Document, Facts, Paragraph, Section, Table, figures, row
from reports.charts import Chart
from reports.charts import Path as Way
from reports.language import ENGLISH, LONGEST, PAGE, Language
from reports.language_file import language
from reports.results import Results
from tests.reports import (
    made,
    made_calibration,
    made_fleet,
    made_grab,
    test_calibration_check_report,
    test_identification_report,
)
from tests.reports import test_calibration_report as calibrations
from verify.calibration.results import results as worded

OUTLINES = {
    "run": outline.document,
    "calibration": calibration.document,
    "registration": registration.document,
    "fleet": fleet.document,
    "grab": grab.document,
    "identification": identification.document,
}
USERS_OWN = {  # names, descriptions and sources that somebody chose; none of them is the report's
    "all joints moving, one at fault", "dowel hole of the flange", "paper, table 1", "boards",
    "conform: |ê| + 1.645 u ≤ tolerance at every pair (95 %)", "furlong", "session", "held",
    "monday",
    "frames.csv: column temperature is not known and was left alone.", "novel kind of joint 1",
    "ambiguous, one of: something said in words; constant offset of joint 6, +0.100°",
    "4 LEDs move together.", "lab/bad: has no frames.csv.", "frames.csv: no pan.",
    "K3 is held at zero: with it the fit gets better by less than it costs.",
}  # fmt: skip
ENGLISH_WORDS = re.compile(
    r"\b(the|The|An|of|and|is|are|were|each|from|with|not|pair|pairs|joint|joints|left|right|"
    r"error|camera|table|figure|page)\b",
)


def german() -> Language:
    return language("de")


def every() -> dict[str, Results]:
    found = {f"run, {name}": make for name, make in made.EVERY.items() if name != "hostile"}
    found |= {f"calibration, {name}": make for name, make in calibrations.EVERY.items()}
    found |= {f"check, {n}": make for n, make in test_calibration_check_report.EVERY.items()}
    found |= {f"fleet, {make.__name__}": make for make in (made_fleet.quiet, made_fleet.young)}
    found["fleet, changed"] = lambda: made_fleet.changed(date(2025, 6, 10))
    found["grab"] = made_grab.whole
    found["grab, nothing seen"] = lambda: Results({"kind": "grab", "state": "idle"}, {}, {})
    found["identification, geometry"] = lambda: test_identification_report.made(1.0, outlying=True)
    found["identification, bare"] = lambda: Results({"kind": "identification"}, {}, {})
    found["run, long"] = lambda: made.long(12_000)
    found["calibration, one flat board after the other"] = flat
    return {name: make() for name, make in found.items()}


def flat() -> Results:
    """Boards that lie on each other in the middle of the picture: nothing is covered."""
    return worded(made_calibration.calibration(count=5, tilt_deg=2.0), source="boards")


@pytest.fixture(scope="module")
def documents() -> dict[str, Document]:
    return {
        name: OUTLINES[str(results.summary.get("kind", "run"))](results)
        for name, results in every().items()
    }


def test_no_text_of_any_report_stays_english(documents: dict[str, Document]) -> None:
    for name, document in documents.items():
        assert set(german().missing(document)) <= USERS_OWN, name


def test_no_english_word_is_left_in_what_is_called_translated(
    documents: dict[str, Document],
) -> None:
    for name, document in documents.items():
        for text in _said(german().document(document)):
            if text not in USERS_OWN and "something said in words" not in text:
                assert not ENGLISH_WORDS.findall(text), (name, text)


def _said(document: Document) -> list[str]:
    """Texts of paragraphs, tables, captions, alternatives and axes, each on its own."""
    found = [document.title]
    for section in document.sections:
        found.append(section.title)
        for block in section.blocks:
            names = ("sentence", "label", "text", "caption", "alt")
            found += [getattr(block, name, "") for name in names]
            for name in ("remarks", "head", "notes"):
                found += getattr(block, name, ())
            if isinstance(block, Table):
                found += [cell.text for cells in block.rows for cell in cells]
            if isinstance(block, Facts):
                found += [label for label, _ in block.items]
    for drawing in figures(document).values():
        if isinstance(drawing, Chart):
            for panel in drawing.panels:
                found += [panel.title, panel.x_label, panel.y_label]
                found += [str(getattr(mark, "name", "")) for mark in panel.marks]
        elif isinstance(drawing, Way):
            found += [name for _, _, name in drawing.lines] + list(drawing.labels)
    return [re.sub(r"\S*[_/]\S*|\S+\.(toml|csv)\S*|`[^`]*`|left\.\S+|right\.\S+", "", t)
            for t in found]  # fmt: skip


def test_numbers_tones_names_and_order_stay_as_they_are(documents: dict[str, Document]) -> None:
    for name, document in documents.items():
        other = german().document(document)
        for old, new in zip(document.sections, other.sections, strict=True):
            assert [b.kind for b in old.blocks] == [b.kind for b in new.blocks]
            assert old.name == new.name
            for one, two in zip(old.blocks, new.blocks, strict=True):
                assert getattr(one, "tone", "") == getattr(two, "tone", "")
                if isinstance(one, Table) and isinstance(two, Table):
                    cells = zip(sum(one.rows, ()), sum(two.rows, ()), strict=True)
                    for a, b in cells:
                        assert a.tone == b.tone
                        assert sorted(_numbers(a.text)) == sorted(_numbers(b.text)), name
                if isinstance(one, Paragraph) and isinstance(two, Paragraph):
                    assert sorted(_numbers(one.text)) == sorted(_numbers(two.text)), name


def _numbers(text: str) -> list[str]:
    return re.findall(r"[−+-]?\d+(?:\.\d+)?", text)


@pytest.mark.parametrize(
    ("english", "other"),
    [
        (
            "Joint 3 reads 0.400° ± 0.015° (k = 2) too high: add −0.400° to its reading.",
            "Gelenk 3 zeigt 0.400° ± 0.015° (k = 2) zu viel an: −0.400° zur Anzeige addieren.",
        ),
        (
            ("Joint 2's a2 differs by +0.84 ± 0.20 mm: correct a2 in the robot file by +0.84 mm; "
            "joint 4 has 0.31° of backlash, its encoder on the joint's side: take up the play, or "
            "approach from one side only."),
            ("Der Parameter a2 von Gelenk 2 weicht um +0.84 ± 0.20 mm ab: a2 in der Roboterdatei "
            "um +0.84 mm berichtigen; Gelenk 4 hat 0.31° Umkehrspiel, sein Drehgeber sitzt auf der "
            "Gelenkseite: das Spiel beseitigen oder nur von einer Seite anfahren."),
        ),
        (
            ("Joints 1, 2 and 6 exceed their tolerances (worst: +0.4° ± 0.1°, 1σ); the data do not "
            "say whether by constant offset of joint 3 or backlash of joint 4: record a motion "
            "that tells these apart (verify plan proposes one)."),
            ("Die Gelenke 1, 2 und 6 überschreiten ihre Toleranzen (größte Abweichung: +0.4° ± "
            "0.1°, 1σ); die Daten entscheiden nicht zwischen den Ursachen konstanter Versatz von "
            "Gelenk 3 oder Umkehrspiel von Gelenk 4: eine Bewegung aufzeichnen, die sie "
            "unterscheidet (verify plan schlägt eine vor)."),
        ),
        (
            "Of an offset of joints 2, 3 and 5, 8.0 % to 16 % shows.",
            "Von einem Versatz der Gelenke 2, 3 und 5 sind 8.0 % bis 16 % sichtbar.",
        ),
        (
            ("The instrument cannot tell whether joint 3 stays within ±0.02°; what would have to "
            "improve first is LED positions, which alone makes 0.02° of joint 3's standard "
            "uncertainty."),
            ("Das Messsystem kann nicht entscheiden, ob Gelenk 3 innerhalb von ±0.02° bleibt; "
            "zuerst zu verbessern ist der Beitrag „LED-Positionen“, der allein 0.02° zur "
            "Standardunsicherheit von Gelenk 3 beiträgt."),
        ),
        (
            ("A constant offset of joints 1 and 6 cannot show here: the robot base and the LED "
             "positions were found through the same encoders."),
            ("Ein konstanter Versatz der Gelenke 1 und 6 kann sich hier nicht zeigen: Roboterbasis "
             "und LED-Positionen wurden über dieselben Drehgeber bestimmt."),
        ),
        (
            ("A constant offset of joint 4 cannot show here: near a singularity only the sum q4+q6 "
            "is determined."),
            ("Ein konstanter Versatz von Gelenk 4 kann sich hier nicht zeigen: Nahe einer "
            "Singularität ist nur die Summe q4+q6 bestimmt."),
        ),
        ("undecided: errors follow no known curve",
         "unentschieden: Abweichungen folgen keiner bekannten Kurve"),
        ("time since 1763000000.000 s [s]", "Zeit seit 1763000000.000 s [s]"),
    ],
)  # fmt: skip
def test_sentences_are_put_together_as_in_english(english: str, other: str) -> None:
    assert german().text(english) == other


@pytest.mark.parametrize(
    "text",
    [
        "My arm at the left of the table", "lab/left.mkv", "sha256:00ab", "–", "", " ", "3.14 mm",
        "and", "joint", "arm and table", "{robot}", "reads too high: add", "漢字 سلام",
    ],
)  # fmt: skip
def test_what_is_no_sentence_of_the_file_stays_english(text: str) -> None:
    alone = Language("xx", {}, german().sentences)
    assert alone.text(text) == text


def test_a_robots_name_is_no_sentence() -> None:
    title = "Encoder verification of left and right"
    assert german().text(title) == "Prüfung der Drehgeber von left and right"


def test_english_changes_nothing() -> None:
    document = outline.document(made.nonconforming())
    assert ENGLISH.document(document) is document
    assert ENGLISH.page_words() == PAGE


def test_every_word_of_the_templates_has_its_german() -> None:
    assert german().page.keys() == set(PAGE.values())
    assert german().page_words()["page"] == "Seite"


def test_the_same_text_is_the_same_whatever_was_translated_before() -> None:
    text = "Joint 4: errors follow no known curve."
    fresh = replace(german(), _known={})
    nested = "; ".join([": ".join(["Joint 4"] * 9), text])
    fresh.text(nested)
    assert fresh.text(text) == replace(german(), _known={}).text(text)


def test_hostile_words_are_left_alone_and_take_no_time() -> None:
    document = outline.document(made.hostile())
    translated = german().document(document)
    assert "{{ 7*7 }}" in translated.title
    long = "xa; xb: xc, xd and xe. " * 160
    assert len(long) < LONGEST
    assert german().text(long) == long
    assert german().text("joint " * 10_000) == "joint " * 10_000


def test_a_report_in_german_is_german_in_both_formats() -> None:
    look = reports.look(language="de")
    page = reports.render_html(made.nothing(), look)
    assert '<html lang="de">' in page
    assert "<b>Tabelle 1.</b>" in page
    assert "Kein Urteil" in page
    assert reports.render_html(made.nothing(), look) == page
    assert reports.render_pdf(made.nothing(), look)[:5] == b"%PDF-"


def test_a_language_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "fr.toml"
    path.write_text(
        'code = "fr"\nkeep = ["RMS"]\n[page]\n"page" = "page"\n[mine]\n'
        '"joint {joint} reads {amount} too high: {remedy}" = '
        '"l\'axe {joint} indique {amount} de trop : {remedy}"\n'
        '"add {amount} to its reading" = "ajouter {amount}"\n'
        '"and" = "et"\n"left" = "gauche"\n"right" = "droite"\n',
        encoding="utf-8",
    )
    own = language(str(path))
    said = own.text("Joint 3 reads 0.4° too high: add −0.4° to its reading.")
    assert said == "L'axe 3 indique 0.4° de trop : ajouter −0.4°."
    assert own.text("left and right") == "gauche et droite"
    table = Table("left", "l", ("right",), (row("RMS"),), number=1)
    document = Document("right", "nowhere", "1", (Section("a", "left", (table,)),))
    assert own.missing(document) == ["nowhere"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("code = ", "is no TOML"),
        ("[a]\n", "code: is None"),
        ('code = "../x"\n', "code: is '../x'"),
        ('code = "de"\nkeep = 3\n', "keep: is no list of words"),
        ('code = "de"\nkey = "x"\n', "key: is no table"),
        ('code = "de"\n[a]\n"b" = 3\n', '[a] "b": is no text'),
        ('code = "de"\n[a]\n"b {c}" = "{d}"\n', "its translation has d"),
        ('code = "de"\n[a]\n"b {c}" = "{c} {"\n', "an open brace"),
        ('code = "de"\n[a]\n"{b}{c}" = "{b}"\n', "cannot be told apart"),
        ('code = "de"\n[a]\n"{b}" = "{b}"\n', "is a placeholder alone"),
    ],
)
def test_a_broken_language_file_is_refused_with_its_place(
    tmp_path: Path, text: str, said: str
) -> None:
    path = tmp_path / "own.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(reports.ReportError, match=re.escape(said)) as problem:
        language(str(path))
    assert str(problem.value).startswith(str(path))
    assert "\n" not in str(problem.value)


def test_an_unknown_language_and_a_missing_or_binary_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(reports.ReportError, match=r'there is no "kl".*en, de ship'):
        language("kl")
    with pytest.raises(reports.ReportError, match="cannot be read"):
        language(str(tmp_path / "none.toml"))
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(reports.ReportError, match="no text in UTF-8"):
        language(str(tmp_path / "b.toml"))
