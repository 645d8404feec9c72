"""The reports of a calibration and of a registration: what they say, and that both formats do."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go
import pytest
import typst
from matplotlib.colors import to_hex, to_rgb

import reports
from reports.calibration import document as calibration_document
from reports.calibration.figures import CALIBRATION_FIGURES, arrows
from reports.document import charts
from reports.document.blocks import Bullets, Figure, Table, to_template_data
from reports.document.charts import Chart, Line
from reports.format import matplotlib, pdf, plotly
from reports.registration import document as registration
from reports.registration.evidence import REGISTRATION_FIGURES
from reports.results import Results
from tests.reports.conftest import LIBRARY
from tests.reports.format.test_html import Page, _luminance, _strings
from tests.reports.session.test_figures import _coloured
from tests.support.reports import made_calibration as made
from verify.calibration.quality.results import calibration_results


def good() -> Results:
    """Everything covered; the cameras turned on their bases."""
    found = made.calibration(count=24)
    return calibration_results(
        replace(found, turning=True), picture=made.pictures(found), source="boards"
    )


def doubtful() -> Results:
    """Few boards, flat ones, one view that stands out, and inputs to list."""
    found = made.with_poor_view(made.calibration(count=9, tilt_deg=8.0))
    return calibration_results(
        found, source="boards", inputs=made.INPUTS, warnings=("frames.csv: no pan.",)
    )


def nothing() -> Results:
    """A calibration of which nothing was kept."""
    return Results({"kind": "calibration"}, {}, {})


def motion() -> Results:
    """Joints 1 and 6 hidden, one swept joint."""
    random = np.random.default_rng(4)
    rows = [
        {"frame": f, "camera": camera, "led": "A", "x_px": 400 + 8.0 * f, "y_px": 300.0 + f,
         "residual_x_px": random.normal(0, 0.1), "residual_y_px": random.normal(0, 0.1),
         "used": f != 7}
        for f in range(40) for camera in ("left", "right")
    ]  # fmt: skip
    q = np.linspace(-20, 20, 30)
    three = [0.1, 0.2, 0.3]
    summary = {
        "kind": "registration", "method": "motion", "robot": "iust_6r",
        "source": {"path": "session"}, "registration": "sha256:" + "5c" * 32,
        "pairs": {"used": 40, "left_out": {"too few LEDs told apart": 2}},
        "base": {"position_mm": [91.0, 662.0, 1181.0], "standard_uncertainty_mm": three,
                 "rotation_vector_deg": [44.9, 104.7, -93.5], "standard_uncertainty_deg": three,
                 "held": False},
        "leds": [{"name": "A", "x_mm": 61.8, "y_mm": 3.1, "z_mm": 18.0,
                  "u_x_mm": 0.13, "u_y_mm": 0.1, "u_z_mm": None}],
        "leds_held": False,
        "clock": {"offset_s": 0.1372, "standard_uncertainty_s": 0.0002},
        "skew": {"offset_s": 0.0, "standard_uncertainty_s": None},
        "joints": [{"joint": j + 1, "visible_fraction": v}
                   for j, v in enumerate([0.0, 0.04, 0.09, 0.5, 0.95, 0.0])],
        "fit": {"rms_px": 0.14, "fit_rms_px": 0.13, "held_out_rms_px": 0.15, "misfit": 1.2},
        "decisions": ["4 LEDs move together."], "warnings": [],
    }  # fmt: skip
    axes = pd.DataFrame(
        [{"joints": "1 and 2", "angle_deg": 90.1, "angle_table_deg": 90.0, "angle_u_deg": 0.1,
          "distance_mm": 40.3, "distance_table_mm": 40.0, "distance_u_mm": 0.4, "agrees": True},
         {"joints": "2 and 3", "angle_deg": 0.5, "angle_table_deg": 0.0, "angle_u_deg": 0.1,
          "distance_mm": 250.0, "distance_table_mm": 250.0, "distance_u_mm": 0.3, "agrees": False}]
    )  # fmt: skip
    gears = pd.DataFrame([{"joint": 2, "span_deg": 40.0, "gear": 1.001, "gear_u": 0.0004}])
    sweeps = pd.DataFrame(
        {"joint": 2, "frame": range(30), "reading_deg": q, "nonlinearity_deg": 0.01 * np.sin(q)}
    )
    tables = {"residuals": pd.DataFrame(rows), "axes": axes, "gears": gears, "sweeps": sweeps}
    return Results(summary, {"image_size_px": [1280, 720]}, tables)


def fixture() -> Results:
    """A board on the base: nothing is hidden."""
    given = motion()
    pairs = pd.DataFrame(
        [{"frame": f, "x_mm": 0.01, "y_mm": 0.0, "z_mm": -0.02, "rx_deg": 0.001, "ry_deg": 0.0,
          "rz_deg": 0.0, "chi2": 5.2} for f in range(4)]
    )  # fmt: skip
    keep = {k: given.summary[k] for k in ("kind", "robot", "source", "base", "registration")}
    summary = {**keep, "method": "fixture", "pairs": {"used": 4}, "fit": {"rms_px": 0.05}}
    return Results(summary, given.setup, {"pairs": pairs})


def bare() -> Results:
    """A registration of which nothing was kept."""
    return Results({"kind": "registration"}, {}, {})


EVERY: dict[str, Callable[[], Results]] = {
    "good": good, "doubtful": doubtful, "nothing": nothing,
    "motion": motion, "fixture": fixture, "bare": bare,
}  # fmt: skip
OUTLINES = {"calibration": calibration_document, "registration": registration}
made_of = cache(lambda name: EVERY[name]())
html_of = cache(lambda name: reports.render_html(made_of(name)).replace(LIBRARY, ""))
pdf_of = cache(lambda name: reports.render_pdf(made_of(name)))


def outline(name: str) -> Any:
    return OUTLINES[made_of(name).summary["kind"]]


def words(name: str) -> str:
    return " ".join(_strings(to_template_data(outline(name).document(made_of(name)))))


@pytest.mark.parametrize("name", sorted(EVERY))
def test_all_that_the_outline_says_stands_on_the_page(name: str) -> None:
    page = Page(html_of(name))
    assert page.open == []
    text = "".join(page.text)
    for said in _strings(to_template_data(outline(name).document(made_of(name)))):
        assert said in text


@pytest.mark.parametrize("name", sorted(EVERY))
def test_both_formats_have_the_sections_of_the_outline_in_order(name: str) -> None:
    titles = [section(made_of(name)).title for section in outline(name).SECTIONS]
    assert re.findall(r"<h2[^>]*>.*?</span> (.*?)</h2>", html_of(name)) == titles
    files = pdf.typst_files(outline(name).document(made_of(name)))
    found = json.loads(typst.query(files, "heading", field="body", **pdf.FONTS))
    assert [heading["text"] for heading in found] == titles


@pytest.mark.parametrize("name", ["good", "motion"])
def test_the_same_results_give_the_same_bytes(name: str) -> None:
    again = EVERY[name]()
    assert reports.render_html(again).replace(LIBRARY, "") == html_of(name)
    assert reports.render_pdf(again) == pdf_of(name)


@pytest.mark.parametrize("name", ["doubtful", "fixture"])
def test_a_report_built_again_from_its_folder_is_the_same(name: str, tmp_path: Path) -> None:
    reports.write(made_of(name), tmp_path / "results")
    again = reports.read(tmp_path / "results")
    assert reports.render_html(again).replace(LIBRARY, "") == html_of(name)


def test_results_of_an_unknown_kind_are_refused_in_one_line() -> None:
    for render in (reports.render_html, reports.render_pdf):
        with pytest.raises(reports.ReportError, match='its kind is "moon"'):
            render(Results({"kind": "moon"}, {}, {}))


@pytest.mark.parametrize("name", ["nothing", "bare"])
def test_what_is_unknown_is_a_dash_and_not_a_word_of_the_program(name: str) -> None:
    text = "".join(Page(html_of(name)).text)
    assert "–" in text
    assert not re.search(r"\b(None|nan|NaN|null|inf)\b", text)


@pytest.mark.parametrize("figure", sorted(CALIBRATION_FIGURES))
def test_every_figure_of_a_calibration_is_drawn_or_declined(figure: str) -> None:
    draw = CALIBRATION_FIGURES[figure]
    assert draw(made_of("nothing")) is None
    for name in ("good", "doubtful"):
        chart = draw(made_of(name))
        assert chart is not None
        plot = _coloured(plotly.specification(chart))
        go.Figure(plot["data"], plot["layout"])
        go.Figure(plot["data"], plot["narrow"])
        assert matplotlib.svg(chart) == matplotlib.svg(chart)


@pytest.mark.parametrize("figure", sorted(REGISTRATION_FIGURES))
def test_every_figure_of_a_registration_is_drawn_or_declined(figure: str) -> None:
    draw = REGISTRATION_FIGURES[figure]
    assert draw(made_of("bare")) is None
    chart = draw(made_of("motion"))
    assert chart is not None
    plot = _coloured(plotly.specification(chart))
    go.Figure(plot["data"], plot["layout"])
    assert matplotlib.svg(chart) == matplotlib.svg(chart)


def test_every_axis_says_its_unit_or_what_it_counts() -> None:
    pairs = [(draw, "good") for draw in CALIBRATION_FIGURES.values()]
    pairs += [(draw, "motion") for draw in REGISTRATION_FIGURES.values()]
    for draw, name in pairs:
        chart = draw(made_of(name))
        assert chart is not None
        panels = chart.panels if isinstance(chart, Chart) else ()
        for panel in panels:
            for label in (panel.x_label, panel.y_label):
                counted = label in ("", "pair", "were they exact")
                assert counted or re.search(r"\[(s|°|mm|px|%)\]$", label), label


def test_every_table_s_column_says_its_unit_where_it_holds_measures() -> None:
    for name in ("doubtful", "motion", "fixture"):
        for section in outline(name).document(made_of(name)).sections:
            for block in section.blocks:
                if isinstance(block, Table) and any("±" in h for h in block.head):
                    unit = re.compile(r"\[(mm|°|px)\]|, in (mm|µm)|uncertainties")
                    assert unit.search(block.caption) or all(
                        unit.search(h) or "over" in h for h in block.head if "±" in h
                    )


def test_the_headline_says_what_a_point_is_worth_and_what_to_improve() -> None:
    summary = made_of("good").summary
    text = words("good")
    entry = next(
        e for e in summary["accuracy"] if e["distance_mm"] == summary["working_distance_mm"]
    )
    for part in ("depth", "lateral"):
        amount = float(f"{2 * entry[f'total_{part}_mm']:.1e}")
        assert f"±{amount:.2f} mm" in text
    assert f"Calibrated from {summary['pairs']['used']} pairs" in text
    assert summary["improve_first"]["help"] in text
    assert "The rig is calibrated, with doubts" not in text


def test_doubts_and_gaps_are_said_in_words() -> None:
    results_, text = made_of("doubtful"), words("doubtful")
    assert "The rig is calibrated, with doubts" in text
    assert results_.summary["doubts"]
    for sentence in (*results_.summary["doubts"], *results_.summary["gaps"]):
        assert sentence in text
    bullets = [
        block
        for section in calibration_document.document(results_).sections
        for block in section.blocks
        if isinstance(block, Bullets) and block.tone == "warning"
    ]
    assert tuple(results_.summary["gaps"]) in [block.items for block in bullets]
    assert "stands out: right" in text


def test_what_was_held_is_said_with_why() -> None:
    text = words("doubtful")
    assert "0 (chosen)" in text
    assert "0 (held)" in text
    assert "no picture of a board can tell it" in text
    assert "do not support this coefficient" in text
    assert "K3 is held at zero" in text


def test_a_calibration_with_standing_bases_says_so_and_one_with_turning_bases_too() -> None:
    assert "The bases stood still" in words("doubtful")
    assert "The bases were turned between pairs" in words("good")


def test_every_input_s_hash_and_every_warning_stands_in_the_report() -> None:
    text = words("doubtful")
    for name, digest in made.INPUTS.items():
        assert name in text
        assert digest in text
    assert "frames.csv: no pan." in text


def test_the_rectified_pair_is_shown_where_there_is_one() -> None:
    def shown(name: str) -> list[Figure]:
        document = calibration_document.document(made_of(name))
        every = [block for section in document.sections for block in section.blocks]
        return [block for block in every if isinstance(block, Figure) and block.name == "rectified"]

    assert len(shown("good")) == 1
    assert not shown("doubtful")
    assert "No pair was given to show rectified." in words("doubtful")


def test_arrows_point_from_where_a_corner_was_seen_along_its_residual() -> None:
    x, y = arrows(np.array([10.0]), np.array([20.0]), np.array([3.0]), np.array([-4.0]))
    assert [x[0], y[0], x[1], y[1]] == [10.0, 20.0, 13.0, 16.0]
    assert np.isnan(x[2])
    assert x[4] == 13.0  # the head's strokes meet at the tip
    assert np.isnan(x[-1])


def test_the_arrow_on_top_is_as_long_as_it_says() -> None:
    results_ = made_of("good")
    chart = CALIBRATION_FIGURES["vectors"](results_)
    assert isinstance(chart, Chart)
    lines = [m for m in chart.panels[0].marks if isinstance(m, Line)]
    note = next(m for m in chart.panels[0].marks if isinstance(m, charts.Note))
    long = float(note.text.removesuffix(" px"))
    scale = next(m for m in lines if m.role == "ink")
    table = results_.tables["residuals"].query("camera == 'left'")
    single = next(m for m in lines if m.role == "vector")
    drawn_length = single.x[1] - single.x[0]
    gain = drawn_length / table["residual_x_px"].iloc[0]
    assert scale.x[1] - scale.x[0] == pytest.approx(gain * long)


def test_counts_and_uncertainties_are_written_into_their_cells() -> None:
    results_ = made_of("good")
    chart = CALIBRATION_FIGURES["coverage"](results_)
    assert isinstance(chart, Chart)
    total = sum(
        int(text)
        for panel in chart.panels
        for mark in panel.marks
        if isinstance(mark, charts.Cells)
        for line in mark.text
        for text in line
    )
    assert total == results_.tables["coverage"]["corners"].sum()
    maps = CALIBRATION_FIGURES["accuracy"](results_)
    assert isinstance(maps, Chart)
    assert len(maps.panels) == 2 * len(results_.summary["accuracy"])


@pytest.mark.parametrize("value", [0.0, 0.4, 0.6, 0.8, 1.0])
@pytest.mark.parametrize("role", ["used", "high"])
def test_a_cell_s_letters_stand_out_from_its_colour(value: float, role: str) -> None:
    values, place = np.full((1, 1), value), np.zeros(1)
    scale = ((0.0, "paper"), (1.0, role))
    cells = charts.Cells(values, place, place, scale, 0.0, 1.0, (("88",),))
    panel = charts.Panel((cells,), x_range=(-0.5, 0.5), y_range=(-0.5, 0.5))
    svg = matplotlib.svg(Chart((panel,), row_height=1.0)).decode()
    found = re.search(r"<text style=\"[^\"]*fill: (#[0-9a-f]{6})[^\"]*\"[^>]*>88</text>", svg)
    assert found is not None
    full = np.array(to_rgb(charts.PALETTE[role][0]))
    behind = to_hex((1 - value) * np.ones(3) + value * full)
    own, other = _luminance(found[1]), _luminance(behind)
    assert (max(own, other) + 0.05) / (min(own, other) + 0.05) >= 2.5


def test_the_registration_says_what_it_hides() -> None:
    text = words("motion")
    assert "A constant offset of joints 1 and 6 cannot show." in text
    assert "A constant offset of joint 1 cannot show, however large." in text
    assert "Of an offset of joints 2 and 3, 4.0 % to 9.0 % shows." in text
    assert "Partly hidden: 50 % of an offset of joint 4 shows." in text
    assert "An offset of joint 5 shows in full." in text
    assert "held: the motion does not show it" in text
    assert "differs" in text


def test_a_fixture_hides_nothing() -> None:
    text = words("fixture")
    assert "It hides nothing." in text
    assert "The robot is registered, and blind" not in text
    assert "The robot's base was found from a board at a known place on the base" in text


def test_a_registration_that_does_not_carry_over_is_in_doubt() -> None:
    given = motion()
    given.summary["fit"]["held_out_rms_px"] = 0.5
    given.summary["joints"] = []
    section = registration.verdict(given)
    assert to_template_data(section.blocks[0])["tone"] == "undecided"
    assert "held out fit clearly worse" in str(to_template_data(section.blocks[0]))


@pytest.mark.parametrize("name", ["good", "motion"])
def test_hostile_words_are_shown_and_never_run(name: str) -> None:
    given = made_of(name)
    evil = '<script>alert(1)</script> {{ 7*7 }} #panic("x")'
    summary = given.summary | {
        "source": {"path": evil, "description": evil}, "warnings": [evil], "decisions": [evil],
        "robot": evil, "inputs": {evil: evil},
    }  # fmt: skip
    hostile = replace(given, summary=summary)
    page = Page(reports.render_html(hostile).replace(LIBRARY, ""))
    assert sum(tag == "script" for tag, _ in page.tags) == 3
    assert evil in "".join(page.text)
    assert reports.render_pdf(hostile).startswith(b"%PDF")


@pytest.mark.parametrize(
    ("name", "wanted"),
    [("good", "The rig is calibrated"), ("motion", "cannot show"), ("fixture", "It hides nothing")],
)
def test_the_verdict_stands_on_the_first_page(name: str, wanted: str, tmp_path: Path) -> None:
    tool = shutil.which("pdftotext")
    if tool is None:
        pytest.skip("pdftotext is not installed (poppler-utils)")
    (tmp_path / "report.pdf").write_bytes(pdf_of(name))
    command = [tool, "-layout", str(tmp_path / "report.pdf"), "-"]
    text = subprocess.run(command, check=True, capture_output=True).stdout.decode()
    assert wanted in text.split("\f")[0]
