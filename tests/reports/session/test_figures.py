import base64
import io
from dataclasses import replace

import matplotlib.colors
import matplotlib.image
import numpy as np
import pytest
import typst

from reports.document import charts
from reports.document.blocks import Figure, collect_figures
from reports.document.charts import Band, Line, Path
from reports.format import pdf, plotly, svg
from reports.format.lettering import printable
from reports.session import phrases
from reports.session.document import document
from reports.session.evidence import relative_errors
from reports.session.figures import motion
from reports.session.figures.evidence import residuals
from reports.session.findings import clock_text, components, errors_over_time
from tests.support.reports import session as made
from tests.support.reports.page import chart_of, drawing_of, made_of

POSE = ["x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]


def test_each_joint_has_a_strip_with_bands_resolved_line_and_tolerance() -> None:
    chart = chart_of("seven_joints", "joint_errors")
    assert [panel.y_label for panel in chart.panels] == [f"q{n} [°]" for n in range(1, 8)]
    for panel in chart.panels:
        names = {getattr(mark, "name", "") for mark in panel.marks}
        assert {"error of a pair", "±2u of a pair", "resolved error", "±2u resolved"} <= names
        assert "tolerance" in names or "beyond this scale" in panel.title


def test_the_band_of_a_pair_is_two_standard_uncertainties_of_all_sources() -> None:
    frames = made_of("nonconforming").tables["frames"].dropna(subset=["q3_error_deg"])
    chart = chart_of("nonconforming", "joint_errors")
    band = next(m for m in chart.panels[2].marks if isinstance(m, Band))
    high = band.high[np.isfinite(band.high)]
    np.testing.assert_allclose(high, frames["q3_error_deg"] + 2 * frames["q3_error_u_deg"])


@pytest.mark.parametrize("shown", [True, False])
def test_a_caption_names_the_errors_of_pairs_only_where_the_figure_has_them(shown: bool) -> None:
    results = made_of("seven_joints")
    frames = results.tables["frames"].copy()
    if not shown:  # as of a real arm of seven joints: a pair determines six sums of them
        frames.loc[:, [f"q{n}_error_deg" for n in range(1, 8)]] = np.nan
    results = replace(results, tables={**results.tables, "frames": frames})
    captions = [getattr(block, "caption", "") for block in errors_over_time(results).blocks]
    assert any("of each pair with its ±2u band" in caption for caption in captions) == shown
    assert any("the resolved error on which the verdict rests" in c for c in captions)


def test_what_two_leds_do_not_determine_is_in_no_legend_and_no_caption() -> None:
    """The flange's pose is drawn as the encoders say, and its error as it is resolved."""
    results = made_of("nonconforming")
    frames = results.tables["frames"].copy()
    frames.loc[:, [*POSE, "position_error_mm", "orientation_error_deg"]] = np.nan
    few = replace(results, tables={**results.tables, "frames": frames})
    shown = components(few).blocks[0]
    assert isinstance(shown, Figure)
    assert isinstance(shown.drawing, charts.Chart)
    assert list(charts.legend(shown.drawing)) == ["from encoders"]
    captions = " ".join(
        getattr(block, "caption", "") for block in (shown, *errors_over_time(few).blocks)
    )
    assert "frame, computed from the encoders." in captions
    assert "error of the flange: the resolved joint errors" in captions
    every = errors_over_time(results).blocks[1]
    assert "distance and angle between the measured" in getattr(every, "caption", "")


def test_no_error_of_a_pair_leaves_its_frame() -> None:
    for name in ("nonconforming", "undecided", "seven_joints", "visits"):
        chart = chart_of(name, "joint_errors")
        for panel in chart.panels:
            for mark in panel.marks:
                if isinstance(mark, Line):
                    known = mark.y[np.isfinite(mark.y)]
                    assert panel.y_range[0] <= known.min()
                    assert known.max() <= panel.y_range[1]


def test_visits_far_apart_are_not_joined_by_lines() -> None:
    chart = chart_of("visits", "joint_errors")
    for mark in chart.panels[0].marks:
        if isinstance(mark, Line):
            steps = np.diff(mark.x)
            assert np.nanmax(steps) < 1.0  # s; visits are a minute apart


def test_visits_at_even_intervals_are_not_joined_either() -> None:
    results = made_of("nonconforming")
    tables = dict(results.tables)
    for name in ("frames", "resolved"):
        table = tables[name].copy()
        table["t_s"] = 50.0 * np.arange(len(table))
        tables[name] = table
    chart = motion.joint_errors(replace(results, tables=tables))
    assert chart is not None
    lines = [m for panel in chart.panels for m in panel.marks if isinstance(m, Line)]
    assert lines
    assert not any(np.isfinite(np.diff(line.x)).any() for line in lines)


def test_the_path_breaks_where_pairs_are_missing_and_names_no_class_that_is_not_drawn() -> None:
    results = made_of("nonconforming")
    gap = results.tables["frames"]["t_s"].between(2.0, 3.5)  # nobody recorded
    tables = {**results.tables, "frames": results.tables["frames"][~gap]}
    path = motion.flange_path(replace(results, tables=tables))
    assert path is not None
    lines = [points for points, _, _ in path.lines if len(points) > 1]
    assert all(np.isfinite(points).any() for points in lines)
    steps = [np.linalg.norm(np.diff(points, axis=0), axis=1) for points in lines]
    usual = np.nanmedian(np.concatenate(steps))
    assert all(np.nanmax(step, initial=0.0) < 5 * usual for step in steps)
    assert "error not known" not in [name for _, _, name in path.lines]


def test_a_long_session_stays_light_and_all_its_spots_are_counted() -> None:
    results = made.nonconforming(pairs=10_000)
    drawn = collect_figures(document(results)).values()
    size = sum(len(str(plotly.specification(c))) for c in drawn if not isinstance(c, bytes))
    assert size < 4_000_000  # letters; the plotting library itself has 4.8 million
    chart = residuals(results)
    cells = [m for panel in chart.panels for m in panel.marks if isinstance(m, charts.Cells)]
    counted = sum(float((10**m.values - 1).sum()) for m in cells)
    assert round(counted) == len(results.tables["spots"])


def test_the_shares_of_variance_add_up_to_all() -> None:
    chart = chart_of("nonconforming", "budget")
    bars = [m for m in chart.panels[0].marks if isinstance(m, charts.Bars)]
    np.testing.assert_allclose(sum(m.heights for m in bars), 100.0)


@pytest.mark.parametrize("figure", ["joint_errors", "pose", "path", "clock"])
def test_every_line_is_visible_in_the_image(figure: str) -> None:
    chart = drawing_of("nonconforming", figure)
    files = {"main.typ": b'#image("chart.svg")', "chart.svg": svg.svg(chart)}
    page = typst.compile(files, format="png", ppi=200.0, **pdf.FONTS)
    pixels = matplotlib.image.imread(io.BytesIO(page), format="png")[:, :, :3]
    if isinstance(chart, Path):
        names = [name for _, _, name in chart.lines]
        assert [name.partition(" mm")[2] for name in names[:2]] == [", beyond the tolerance"] * 2
        assert names[2] == "first pair"
        assert names[3].startswith("largest, 3.6")
        roles = {role for points, role, _ in chart.lines if len(points) > 1}
    else:
        roles = {m.role for p in chart.panels for m in p.marks if isinstance(m, Line)}
    for role in roles:
        distance = np.abs(pixels - matplotlib.colors.to_rgb(charts.PALETTE[role][0])).max(axis=2)
        assert (distance < 0.1).sum() > 300, role  # dots; the legend alone has fewer


def test_a_user_s_word_is_no_link_in_a_plot_and_letters_that_the_font_lacks_are_replaced() -> None:
    assert "<" not in plotly.escape_label('<a href="javascript:alert(1)">x</a>')
    assert printable("LED 漢") == "LED \ufffd"
    assert printable("LED °σ") == "LED °σ"
    assert len(printable("x" * 500)) < 50


def test_numbers_arrive_in_the_page_as_they_are_in_the_table() -> None:
    chart = drawing_of("nonconforming", "clock")
    first = plotly.specification(chart)["data"][0]
    y = np.frombuffer(base64.b64decode(first["y"]["bdata"]), dtype="<f4")
    np.testing.assert_allclose(y, made_of("nonconforming").tables["clock_curve"]["cost"], rtol=1e-6)


@pytest.mark.parametrize(
    ("error", "limit", "names"),
    [
        ([0.2, 0.4, 0.6], 1.0, ["0.20 to 0.40 mm", "0.40 to 0.60 mm"]),
        ([1.2, 1.4, 1.6], 1.0, [f"{ends} mm, beyond the tolerance" for ends in
                                ("1.20 to 1.40", "1.40 to 1.60")]),
        ([0.0, 0.7, 2.0], 1.0, ["0.0 to 0.5 mm", "0.5 to 1.0 mm",
                                "1.0 to 1.5 mm, beyond the tolerance",
                                "1.5 to 2.0 mm, beyond the tolerance"]),
        ([0.5, 0.5, 0.5], None, ["0.500 to 0.500 mm"] * 2),
    ],
)  # fmt: skip
def test_the_path_is_coloured_by_classes_that_the_tolerance_parts(
    error: list[float], limit: float | None, names: list[str]
) -> None:
    classes = motion._error_classes(np.array([*error, np.nan]), limit)
    assert [name for _, _, name in classes[:-1]] == names
    inside = np.array([own for own, _, _ in classes])
    assert inside.sum(axis=0).tolist() == [1] * 4  # each pair is in one of them
    assert classes[-1][0].tolist() == [False, False, False, True]


def test_the_timeline_cuts_no_outcome() -> None:
    assert [word for word in phrases.STATUSES.values() if printable(word) != word] == []


def test_without_a_tolerance_all_joints_have_one_scale() -> None:
    ranges = {panel.y_range for panel in chart_of("no_tolerance", "joint_errors").panels}
    assert len(ranges) == 1


def test_one_long_bar_does_not_set_the_scale_of_the_relative_motions() -> None:
    results = made_of("nonconforming")
    relative = results.tables["relative"].copy()
    usual = 2 * relative["turn_u_deg"].median()
    relative.loc[relative.index[0], "turn_u_deg"] = 100.0
    chart = relative_errors(replace(results, tables={**results.tables, "relative": relative}))
    assert chart is not None
    low, high = chart.panels[0].y_range or (-np.inf, np.inf)
    error = relative["turn_error_deg"]
    assert low < error.min() < error.max() < high
    assert high - low < np.ptp(error) + 10 * usual


def test_a_clock_offset_has_a_coverage_factor_only_beside_an_uncertainty() -> None:
    clock = {"encoder_offset_s": 0.0, "standard_uncertainty_s": None, "source": "none"}
    assert clock_text({"clock": clock}) == "0.000 s, not shown by the motion"
    known = clock | {"standard_uncertainty_s": 0.0005, "source": "given"}
    assert clock_text({"clock": known}) == "0.0000 ± 0.0010 s (k = 2), given with the session"


def test_on_a_narrow_screen_a_legend_of_several_rows_has_room_above_the_figure() -> None:
    chart = chart_of("nonconforming", "joint_errors")
    names = charts.legend(chart)
    assert len(names) == 5
    plot = plotly.specification(chart)
    wide, narrow = plot["layout"], plot["narrow"]
    assert narrow["margin"]["t"] >= wide["margin"]["t"] + 2 * 25  # px: three rows of two names
    assert narrow["height"] - narrow["margin"]["t"] == wide["height"] - wide["margin"]["t"]
