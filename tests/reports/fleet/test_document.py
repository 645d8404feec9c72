"""The fleet report: verdict, tables, charts, markup in names."""

import json
import re
from dataclasses import replace
from datetime import date
from typing import Any

import numpy as np
import pytest

from reports import render_html, render_pdf
from reports.document.blocks import Verdict
from reports.document.charts import Level, Line, Points, isolated_points
from reports.document.formatting import DASH, with_uncertainty
from reports.fleet.charts import MAX_TICKS, arm_chart, format_day, month_ticks, present_errors
from reports.fleet.document import document
from reports.fleet.names import common_folder
from reports.results import Results
from tests.support.fleets import NO_FAILURES, rows
from tests.support.reports import fleet as made_fleet
from tests.support.reports.page import page_one
from verify.fleet.trends.assess import TrendRequest, assess

HOSTILE = '</script><b>x</b>&"\n, y'


def verdict_of(results: Results) -> Verdict:
    blocks = [b for section in document(results).sections for b in section.blocks]
    return next(b for b in blocks if isinstance(b, Verdict))


def section(results: Results, name: str) -> list[Any]:
    return [b for s in document(results).sections if s.name == name for b in s.blocks]


def test_it_opens_with_what_changed_and_since_when() -> None:
    verdict = verdict_of(made_fleet.changed())
    assert verdict.tone == "nonconform"
    assert verdict.label == "2 of 18 joints changed"
    step = format_day(made_fleet.changed().table("changes")["t_days"].iloc[1])
    amount = r"[+−]0\.\d+ ± 0\.\d+°"
    for words in (
        rf"The reading of joint 3 of arm_a drifts by {amount} a month \(k = 2\)",
        rf"the reading of joint 5 of arm_b changed by {amount} \(k = 2\) on {step}",
    ):
        assert re.search(words, verdict.sentence)
    assert "The other 16 joints show no change" in verdict.sentence
    assert "at most 1 %" in verdict.remarks[-1]
    assert verdict.remarks[0].startswith("Beyond tolerance: arm_b, joint 5 reads up to ")


def test_scatter_that_nothing_explains_is_no_steady_joint() -> None:
    for results, label in (
        (made_fleet.changed(), "2 of 18 joints changed"),
        (made_fleet.quiet(), "Scatter not explained"),
    ):
        joints = results.table("joints").copy()
        first = joints.index[joints["state"] == "steady"][0]
        joints.loc[first, ["state", "excess"]] = ["scattered", 8.2]
        results = replace(results, tables=results.tables | {"joints": joints})
        verdict = verdict_of(results)
        assert verdict.label == label
        name = f"{joints['arm'][first]}, joint {joints['joint'][first]} by 8.2 times"
        text = " ".join([verdict.sentence, *verdict.remarks])
        assert f"Sessions scatter beyond what they state, unexplained: {name}." in text
        assert "The other 15 joints show no change" in text or label.startswith("Scatter")
        assert "scatter 8.2 times what is stated: not explained" in render_html(results)


def test_sessions_that_do_not_conform_are_the_headline_where_nothing_changed() -> None:
    young = made_fleet.young()
    table = young.table("worst").iloc[:2].assign(verdict=["nonconform", "conform"])
    table = table.assign(
        session=["lab/a", "lab/b"], arm="iust_6r", joint=2, mean_error_deg=-0.349,
        mean_error_u_deg=0.0015, worst_error_deg=-0.351, worst_error_u_deg=0.004,
        tolerance_deg=0.2, joint_verdict="nonconform", pose="",
    )  # fmt: skip
    failing = replace(
        young, tables=young.tables | {"worst": table},
        summary=young.summary | {"verdicts": {"nonconform": 1, "conform": 5}, "uncounted": ["rig"]},
    )  # fmt: skip
    verdict = verdict_of(failing)
    assert (verdict.tone, verdict.label) == ("nonconform", "1 of 6 sessions does not conform")
    amount = "0.3490° ± 0.0030° (k = 2)"
    assert verdict.sentence == f"iust_6r, joint 2 reads {amount} too low, tolerance ±0.2° (a)."
    assert "on the condition that rig are exact" in " ".join(verdict.remarks)
    table = table.assign(mean_error_deg=0.0)  # the error is a wave, and no offset
    wave = verdict_of(replace(failing, tables=failing.tables | {"worst": table}))
    assert "joint 2 reads up to 0.3510° ± 0.0080°" in wave.sentence
    table = table.assign(joint_verdict="conform", pose="position")
    moved = verdict_of(replace(failing, tables=failing.tables | {"worst": table}))
    assert "iust_6r, the flange's position is beyond its tolerance" in moved.sentence
    (worst,) = section(replace(failing, tables=failing.tables | {"worst": table}), "worst")
    assert [row[-1].text for row in worst.rows] == ["does not conform: position", "conforms"]
    first = page_one(document(failing))
    for words in (
        "What to do Read the reports",
        "Not checked",
        "of 18 joints: too few sessions",
    ):
        assert words in first
    for reported in (False, True):
        worst = table.assign(reported=reported)
        first = page_one(document(replace(failing, tables=failing.tables | {"worst": worst})))
        assert ("run the batch with --reports" in first) != reported


def test_a_quiet_fleet_is_called_that_and_one_too_young_is_not() -> None:
    quiet, young = verdict_of(made_fleet.quiet()), verdict_of(made_fleet.young())
    assert (quiet.tone, quiet.label) == ("conform", "No change")
    assert (young.tone, young.label) == ("none", "No verdict")
    assert "Changes over time were not tested" in young.sentence
    (latest,) = section(made_fleet.young(), "joints")
    assert len(latest.rows) == 18
    assert all(row[2].text != DASH for row in latest.rows)
    assert "6 dated sessions" in young.sentence
    assert not section(made_fleet.young(), "charts")
    assert render_pdf(made_fleet.young()).startswith(b"%PDF-")


def test_changed_joints_stand_first_and_every_joint_has_a_row() -> None:
    (table,) = section(made_fleet.changed(), "joints")
    assert [(r[0].text, r[1].text) for r in table.rows[:2]] == [("arm_a", "3"), ("arm_b", "5")]
    assert "getting worse" in table.rows[0][2].text
    assert len(table.rows) == 18


def test_a_change_has_its_session_its_range_and_its_size() -> None:
    table = section(made_fleet.changed(), "changes")[0]
    rows = [cell.text for cells in table.rows for cell in cells]
    found = made_fleet.changed().table("changes")
    at, before = (format_day(found[key][1]) for key in ("t_days", "before_t_days"))
    assert f"from {format_day(found['t_days'][0])} on" in rows
    assert f"{at} (last before: {before})" in rows
    assert found["session"][1].removeprefix("lab/") in rows
    assert ("Sessions below", "lab") in section(made_fleet.changed(), "verdict")[1].items
    assert f"{with_uncertainty(found['size'][1], 2 * found['size_u'][1])}°" in rows


def test_a_step_on_a_new_calibration_and_undetectable_offsets_are_stated() -> None:
    results = made_fleet.changed()
    found = results.table("changes").assign(recalibrated=[False, True])
    joints = results.table("joints").copy()
    joints.loc[0, "visible"] = 0.0
    results = replace(results, tables={**results.tables, "changes": found, "joints": joints})
    (warning,) = section(results, "changes")[1:]
    assert warning.tone == "warning"
    message = " ".join(section(results, "unseen")[0].items)
    assert "arm_a: an offset of joint 1 that was there at registration shows in none" in message


def test_every_joint_has_a_strip_with_its_sessions_and_its_step() -> None:
    results = made_fleet.changed()
    points, found = results.table("points"), results.table("changes")
    drawn = arm_chart(points[points["arm"] == "arm_b"], found[found["arm"] == "arm_b"])
    assert len(drawn.panels) == 6
    marks = drawn.panels[4].marks
    (step,) = (m for m in marks if isinstance(m, Level) and m.name == "step")
    zero = float(points[points["arm"] == "arm_b"]["t_days"].min() // 1)
    change = found[found["arm"] == "arm_b"].iloc[0]
    assert zero + step.value == pytest.approx((change["t_days"] + change["before_t_days"]) / 2)
    ordinary, odd = (m for m in marks if isinstance(m, Points))
    assert (len(ordinary.x), len(odd.x)) == (99, 1)


@pytest.mark.parametrize("days", [0.0, 0.5, 20.0, 45.0, 400.0, 5000.0])
def test_the_time_axis_has_a_few_marks_inside_its_range(days: float) -> None:
    first = 20_091.0  # 2025-01-03
    marks = month_ticks(first, first + days)
    assert 1 <= len(marks) <= MAX_TICKS
    assert all(first <= place <= first + days for place, _ in marks)


def test_links_lead_to_sessions_that_have_a_report_and_tables_sort_and_filter() -> None:
    results = made_fleet.changed()
    page = render_html(results)
    assert f'href="{results.table("worst")["kept_in"][0]}/report.html"' in page
    assert page.count("/report.html") == 1
    assert "aria-sort" in page
    assert 'type = "search"' in page
    worst = section(made_fleet.quiet(), "worst")[0]  # sessions without a tolerance
    assert "--reports" in worst.notes[-1]
    assert {row[worst.head.index("Verdict")].text for row in worst.rows} == {DASH}


def test_before_and_after_is_shown_on_request() -> None:
    assert not section(made_fleet.quiet(), "contrasts")
    (table,) = section(made_fleet.changed(since=date(2025, 6, 12)), "contrasts")
    assert "before 2025-06-12, since 2025-06-12" in table.caption
    assert table.rows[0][-1].text == "changed"
    assert table.head[2:4] == ("before 2025-06-12 [°]", "since 2025-06-12 [°]")
    sessions = rows(1, sessions=6)
    sessions["robot"] = sessions["robot"].replace("arm_b", "arm_a")
    request = TrendRequest(compare=("lab/arm_a", "lab/arm_b"))
    (table,) = section(assess(sessions, NO_FAILURES, request, ()), "contrasts")
    assert table.head[2:4] == ("arm_a [°]", "arm_b [°]")
    assert {row[-1].text for row in table.rows} == {"no difference shown"}


def test_the_common_folder_is_that_of_all_sessions_not_only_of_the_worst() -> None:
    results = made_fleet.changed()
    worst = results.table("worst").assign(session="lab/arm_b/007")
    none = worst.iloc[:0]
    tables = results.tables | {"worst": worst, "changes": none, "failures": none}
    joints = results.table("joints").assign(latest_session="lab/arm_b/007")
    assert common_folder(replace(results, tables=tables | {"joints": joints})) == "lab"


def test_one_uncertain_session_and_many_calibrations_do_not_hide_the_others() -> None:
    results = made_fleet.quiet()
    points = results.table("points").query("arm == 'arm_a'").copy()
    far = points["session"] == points["session"].iloc[4]
    points.loc[far, ["u_deg", "low_deg", "high_deg"]] = [5.0, -40.0, 40.0]
    points["calibration"] = points.groupby("joint").cumcount()
    chart = arm_chart(points, results.table("changes"))
    assert chart is not None
    for panel in chart.panels:
        assert panel.y_range is not None
        assert max(map(abs, panel.y_range)) < 1.0
        assert not [m for m in panel.marks if isinstance(m, Level) and m.name == "new calibration"]
    figure, *_ = section(replace(results, tables=results.tables | {"points": points}), "charts")
    assert "leave the frame" in figure.caption
    assert "too many to be marked" in figure.caption


def test_markup_in_names_is_shown_and_never_run() -> None:
    results = made_fleet.changed(arm=HOSTILE)
    page = render_html(results)
    assert "</script><b>" not in page
    plots = re.search(r'id="plots">(.*?)</script>', page, flags=re.DOTALL)
    json.loads(plots[1])
    assert render_pdf(results).startswith(b"%PDF-")


def test_below_six_sessions_each_of_them_is_drawn_the_latest_apart() -> None:
    results = made_fleet.young()
    drawn = present_errors(results, ["arm_a"])
    assert drawn is not None
    points = {m.name: m for m in drawn.panels[0].marks if isinstance(m, Points)}
    recent = results.table("recent").query("arm == 'arm_a'")
    for name, order in (("latest", 0), ("earlier", 1)):
        own = recent[recent["order"] == order]
        assert points[name].y.tolist() == own["error_deg"].tolist()
    assert recent[recent["order"] == 0]["session"].unique().tolist() == ["lab/arm_a/001"]


def test_a_session_has_the_coverage_factor_of_its_own_report() -> None:
    sessions = rows(1, sessions=2).query("robot == 'arm_a'").copy()
    last = sessions["session"] == "lab/arm_a/001"  # measured in two pairs
    sessions.loc[last, [f"q{j}_coverage_factor" for j in range(1, 7)]] = 13.97
    results = assess(sessions, NO_FAILURES, TrendRequest(), ())
    own = sessions[last].iloc[0]
    (latest,) = section(results, "joints")
    for joint, row in enumerate(latest.rows, start=1):
        u = 13.97 * own[f"q{joint}_standard_uncertainty_deg"]
        assert row[2].text == with_uncertainty(own[f"q{joint}_mean_error_deg"], u)
    assert latest.caption.endswith("k = 13.97.")
    (worst,) = section(results, "worst")
    row = next(row for row in worst.rows if row[0].text == "001")
    joint = int(row[3].text)
    u = 13.97 * own[f"q{joint}_worst_error_standard_uncertainty_deg"]
    assert row[4].text == with_uncertainty(own[f"q{joint}_worst_error_deg"], u)
    assert "k = 2 to 13.97" in worst.caption
    assert re.search(r"Largest present error: .* \(k = 13\.97\)", page_one(document(results)))
    assert "with U (k = 2 to 13.97)" in page_one(document(results))
    drawn = present_errors(results, ["arm_a"])
    assert drawn is not None
    bars = [m for m in drawn.panels[0].marks if isinstance(m, Line) and m.role == "error"]
    widest = max(float(np.nanmax(m.y) - np.nanmin(m.y)) for m in bars)
    assert widest > 2 * 13.97 * own["q1_standard_uncertainty_deg"]


def test_where_every_session_has_its_own_calibration_levels_are_dashes_behind_the_sessions() -> (
    None
):
    results = made_fleet.changed()
    points = results.table("points")
    points = points[points["arm"] == points["arm"].iloc[0]].copy()
    points["calibration"] = points.groupby("joint").cumcount()
    chart = arm_chart(points, results.table("changes").iloc[:0])
    assert chart is not None
    for panel in chart.panels:
        lines = [mark for mark in panel.marks if isinstance(mark, Line)]
        assert not any(isolated_points(mark.x, mark.y).any() for mark in lines)
        assert isinstance(panel.marks[-1], Points)
