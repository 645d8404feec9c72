"""The reports of a calibration, of a check and of a registration."""

import re
from functools import reduce
from operator import getitem

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb

import reports
from reports.calibration import document
from reports.calibration.figures import arrows
from reports.document import charts
from reports.document.blocks import Bullets, collect_figures, to_template_data
from reports.document.charts import Chart, Line
from reports.document.formatting import decimals_of, number, percent, with_uncertainty
from reports.format import svg
from reports.registration.certificate import certificate as registered
from reports.results import Results
from tests.support.reports import calibration as made
from tests.support.reports.page import (
    Page,
    chart_of,
    document_of,
    html_of,
    luminance,
    made_of,
    page_one,
    strings,
    tables,
)


def words(name: str) -> str:
    return " ".join(strings(to_template_data(document_of(name))))


def test_results_of_an_unknown_kind_are_refused_in_one_line() -> None:
    for render in (reports.render_html, reports.render_pdf):
        with pytest.raises(reports.ReportError, match='its kind is "moon"'):
            render(Results({"kind": "moon"}, {}, {}))


@pytest.mark.parametrize("name", ["doubtful", "motion", "fixture"])
def test_every_column_of_measures_has_a_unit(name: str) -> None:
    unit = re.compile(r"\[(mm|°|px)\]|, in (mm|µm)|uncertainties")
    for caption, table in tables(document_of(name)).items():
        measures = [head for head in table.head if "±" in head]
        assert unit.search(caption) or all(unit.search(h) or "over" in h for h in measures)


@pytest.mark.parametrize(
    ("name", "label", "keys"),
    [
        ("good", "Baseline [mm]", ("stereo", "baseline_standard_uncertainty_mm")),
        ("motion", "Base in the rig [mm]", ("base", "standard_uncertainty_mm", 0)),
        ("held", "Scale of known lengths", ("figures", 0, "standard_uncertainty_permille")),  # mm/m
    ],
)
def test_readers_get_the_summary_s_uncertainty_with_k_2(
    name: str, label: str, keys: tuple[str | int, ...]
) -> None:
    assert not re.search("k = 1|± u", words(name))
    expanded = 2 * float(reduce(getitem, keys, made_of(name).summary))  # type: ignore[arg-type]
    rows = [line for table in tables(document_of(name)).values() for line in table.rows]
    (text,) = [line[1].text for line in rows if line[0].text == label]
    assert text.split(" ± ")[1].split()[0] == number(expanded, decimals_of(expanded))


def test_the_headline_has_point_accuracy_and_what_to_improve() -> None:
    summary = made_of("good").summary
    text = words("good")
    entry = next(
        e for e in summary["accuracy"] if e["distance_mm"] == summary["working_distance_mm"]
    )
    for part in ("depth", "lateral"):
        amount = float(f"{2 * entry[f'total_{part}_mm']:.1e}")
        assert f"±{amount:.2f} mm" in text
    assert f"Pairs used {summary['pairs']['used']}" in text
    assert summary["improve_first"]["help"] in text
    assert "The rig is calibrated, with doubts" not in text


def test_doubts_gaps_hashes_of_inputs_and_warnings_are_listed() -> None:
    results_, text = made_of("doubtful"), words("doubtful")
    summary = results_.summary
    assert summary["doubts"]
    for sentence in (
        "The rig is calibrated, with doubts", "frames.csv: no pan.", "stands out: right",
        *summary["doubts"], *summary["gaps"], *made.INPUTS, *made.INPUTS.values(),
    ):  # fmt: skip
        assert sentence in text
    bullets = [
        block
        for section in document.document(results_).sections
        for block in section.blocks
        if isinstance(block, Bullets) and block.tone == "warning"
    ]
    assert tuple(summary["gaps"]) in [block.items for block in bullets]


@pytest.mark.parametrize(
    ("name", "sentences"),
    [
        ("doubtful", ["0 (chosen)", "no picture of a board determines it"]),
        ("doubtful", ["The bases stood still", "No pair was given to show rectified."]),
        ("good", ["The bases were turned between pairs"]),
        ("motion", ["A constant offset of joints 1 and 6 cannot show.",
                    "A constant offset of joint 1 cannot show, however large.",
                    "Of an offset of joints 2 and 3, 4.0 % to 9.0 % shows.",
                    "If all encoders read right, the base is known to",
                    "Partly hidden: 50 % of an offset of joint 4 shows.",
                    "An offset of joint 5 shows in full.",
                    "held: the motion does not show it", "differs"]),
        ("fixture", ["It hides nothing.",
                     "The base is known to ±0.60 mm and ±0.60°",
                     "The robot's base was found from a board at a known place on the base"]),
    ],
)  # fmt: skip
def test_what_was_held_turned_or_hidden_is_stated(name: str, sentences: list[str]) -> None:
    text = words(name)
    assert [sentence for sentence in sentences if sentence not in text] == []
    assert ("some encoder offsets stay hidden" in text) == (name == "motion")


def test_arrows_begin_at_the_corner_and_follow_its_residual() -> None:
    x, y = arrows(np.array([10.0]), np.array([20.0]), np.array([3.0]), np.array([-4.0]))
    assert [x[0], y[0], x[1], y[1]] == [10.0, 20.0, 13.0, 16.0]
    assert np.isnan(x[2])
    assert x[4] == 13.0  # the head's strokes meet at the tip
    assert np.isnan(x[-1])


def test_the_scale_arrow_has_its_stated_length() -> None:
    results_ = made_of("good")
    chart = chart_of("good", "vectors")
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
    chart = chart_of("good", "coverage")
    cells = [m for panel in chart.panels for m in panel.marks if isinstance(m, charts.Cells)]
    total = sum(int(text) for mark in cells for line in mark.text for text in line)
    assert total == results_.tables["coverage"]["corners"].sum()
    maps = chart_of("good", "accuracy")
    assert len(maps.panels) == 2 * len(results_.summary["accuracy"])


@pytest.mark.parametrize("value", [0.0, 0.4, 0.6, 0.8, 1.0])
@pytest.mark.parametrize("role", ["used", "high"])
def test_text_in_a_cell_contrasts_with_its_colour(value: float, role: str) -> None:
    values, place = np.full((1, 1), value), np.zeros(1)
    scale = ((0.0, "paper"), (1.0, role))
    cells = charts.Cells(values, place, place, scale, 0.0, 1.0, (("88",),))
    panel = charts.Panel((cells,), x_range=(-0.5, 0.5), y_range=(-0.5, 0.5))
    drawn = svg.svg(Chart((panel,), row_height=1.0)).decode()
    found = re.search(r"<text [^>]*fill=\"(#[0-9a-f]{6})\"[^>]*>88</text>", drawn)
    full = np.array(to_rgb(charts.PALETTE[role][0]))
    behind = to_hex((1 - value) * np.ones(3) + value * full)
    assert ">88</text>" in drawn
    own = luminance(found[1] if found else "#000000")  # black is what SVG does not state
    other = luminance(behind)
    assert (max(own, other) + 0.05) / (min(own, other) + 0.05) >= 4.5


def test_a_registration_that_does_not_carry_over_is_in_doubt() -> None:
    given = made.motion()
    given.summary["fit"]["held_out_rms_px"] = 0.5
    given.summary["joints"] = []
    section = registered(given)
    assert to_template_data(section.blocks[0])["tone"] == "undecided"
    assert "held out fit clearly worse" in str(to_template_data(section.blocks[0]))


def test_the_verdict_is_the_check_s_and_names_what_is_off() -> None:
    good, bad = ("".join(Page(html_of(name)).text) for name in ("held", "not_held"))
    assert "The calibration holds" in good
    assert "All 3 figures lie within what is allowed" in good
    assert "The calibration does not hold" in bad
    assert "Lengths come out too short, by" in bad
    assert "more than the uncertainty explains: calibrate again" in bad


def test_each_length_has_its_error_and_uncertainty() -> None:
    lengths = made_of("not_held").table("lengths")
    assert (lengths["error_mm"] < 0).all()  # all too short, as the yaw makes them
    np.testing.assert_allclose(
        lengths["measured_mm"] - lengths["known_mm"], lengths["error_mm"], atol=1e-12
    )
    assert (lengths["standard_uncertainty_mm"] > 0).all()


def test_one_pair_of_a_board_shows_its_square_and_no_strips() -> None:
    assert "over_pairs" not in collect_figures(document_of("board"))
    assert "Square as measured" in html_of("board")


def test_page_one_of_a_calibration_says_where_nothing_was_seen_and_what_to_do() -> None:
    results_ = made_of("doubtful")
    first = page_one(document_of("doubtful"))
    coverage = results_.table("coverage")
    for side in ("left", "right"):
        own = coverage[coverage["camera"] == side]["corners"]
        assert f"{percent(float((own == 0).mean()))} of the {side} image" in first
    distance = results_.table("boards")["distance_mm"] / 1e3
    assert f"nearer than {distance.min():.2f} m or farther than {distance.max():.2f} m" in first
    assert "What to do" in first
    assert all(sentence in first for sentence in results_.summary["gaps"])
    assert "Not checked The stated size of a square" in first


def test_a_check_is_in_one_unit_from_the_headline_to_the_sources() -> None:
    summary = made_of("not_held").summary
    scale, vertical, roll = summary["figures"]
    factors = summary["mm_per_m"]
    assert factors["scale"] == pytest.approx(1.0)
    assert factors["roll"] == pytest.approx(1e3 * np.pi / 180)
    first = page_one(document_of("not_held"))
    for entry, key in ((scale, "scale_permille"), (vertical, "vertical_px"), (roll, "roll_deg")):
        factor = factors[entry["figure"]]
        u = 2 * factor * entry[f"standard_uncertainty_{key.rpartition('_')[2]}"]
        assert with_uncertainty(factor * entry[key], u) in first
    assert not re.search("‰|[0-9]°", first)
    assert "What to do Do not measure with this rig." in first
    assert "Not checked A turn or shift of both cameras together" in first


def test_page_one_of_a_registration_says_how_well_what_is_hidden_and_what_to_do() -> None:
    given = made.motion()
    shifts = [0.0, 5.0, 8.0, 8.0, 4.0, 0.0]
    for joint, shift in zip(given.summary["joints"], shifts, strict=True):
        joint["base_shift_mm_per_deg"] = shift
    given.summary["warnings"] = ["The residuals are too large."]
    first = " ".join(strings(to_template_data(registered(given).blocks)))
    for words_ in (
        "the base is known to ±0.60 mm and ±0.60° and the 1 LED to ±0.26 mm (k = 2",
        "An offset of 0.1° of one joint moves the base by up to 0.80 mm.",
        "A constant offset of joints 1 and 6 cannot show.",
        "The residuals are too large.",
        "What to do To make such offsets visible",
        "Not checked The encoders themselves",
    ):
        assert words_ in first
