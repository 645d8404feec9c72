"""Control charts of a fleet: each joint's mean error over time, with limits and changes."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pandas as pd

from reports.document import formatting as fmt
from reports.document.blocks import Block, Figure, Paragraph, Section
from reports.document.charts import (
    Array,
    Band,
    Chart,
    Indices,
    Level,
    Line,
    Mark,
    Panel,
    Points,
    Ticks,
    broken,
    column,
    strips,
)
from reports.results import Results

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
STATES = {
    "steady": "no change",
    "scattered": "scatter not explained",
    "unclear": "change or scatter: too few sessions",
    "step": "stepped",
    "drift": "drifts",
    "change": "changed: step or drift",
    "several": "changed more than once",
    "unknown": "not enough sessions",
}
TONES = {"steady": "conform", "scattered": "undecided", "unclear": "undecided",
         "unknown": "undecided", "step": "nonconform", "drift": "nonconform",
         "change": "nonconform", "several": "nonconform"}  # fmt: skip
KINDS = {"step": "step", "drift": "drift", "change": "step or drift"}
VERDICTS = {"conform": "conform", "nonconform": "do not conform", "undecided": "undecided"}


def format_day(days: Any) -> str:
    """Write days since 1970 as a date."""
    figure = fmt.finite(days)
    return "–" if figure is None else (EPOCH + timedelta(days=figure)).strftime("%Y-%m-%d")


def change_date(change: dict[str, Any]) -> str:
    """Date a change to its session."""
    at = format_day(change["t_days"])
    if change["term"] == "drift":
        return f"from {at} on"
    before = format_day(change["before_t_days"])
    return f"{at} (last before: {before})"


def change_text(one: dict[str, Any]) -> str:
    """Say a change in half a sentence."""
    unit = "°" if one["unit"] == "deg" else "° a month"
    size = fmt.with_uncertainty(one["size"], 2 * float(one["size_u"])) + unit
    verb = {"step": "changed", "drift": "drifts", "change": "changed or drifts"}
    when = "since" if one["term"] == "drift" else "on"
    return (
        f"the reading of joint {one['joint']} of {fmt.text_or_dash(one['arm'])} "
        f"{verb[str(one['kind'])]} by {size} (k = 2) {when} {format_day(one['t_days'])}"
    )


def false_alarm_text(summary: dict[str, Any]) -> str:
    """State the rate of false accusations."""
    share = fmt.finite(summary.get("false_alarm"))
    percent = fmt.exact_number(None if share is None else 100 * share)
    n_arms = len(summary.get("arms") or [])
    arms = "its arm" if n_arms == 1 else f"its {fmt.count(n_arms)} arms"
    return (
        f"In a fleet without any change, the chance that this report names one, in any joint of "
        f"{arms}, is at most {percent} %."
    )


MAX_ARMS = 12  # charts of that many arms; of more, those with a change, then the others
MAX_TICKS = 7
DASH_SHARE = 0.3  # of the time from one session to the next: half the level of one session alone
GROUP_SHIFT = 0.14  # of a joint's latest session from its place, beside those before it
TICK_STEPS = (1, 2, 3, 6, 12, 24, 60)  # months between two marks of the time axis
CAPTION = (
    "Mean error of each joint of {arm}, a dot a session, with its own uncertainty (bar: ± 2u). "
    "Line: the level that the sessions show. Dotted: control limits about the level before any "
    "change; without one, a session of any chart lies beyond them in {share} % of such fleets. "
    "Dashed: a step. Grey: a new calibration, with which level and limits move as far as the "
    "calibrations' uncertainties allow."
)


MAX_CALIBRATION_MARKS = 12  # of a strip: more hide its sessions
MAX_OVERREACH = 3.0  # times the span of sessions and usual limits: what lies farther is cut
CUT_NOTE = "Bars and limits of the most uncertain sessions leave the frame."
UNMARKED_NOTE = "Calibrations are too many to be marked."


def charts(results: Results) -> Section | None:
    """One figure an arm, a strip a joint."""
    points = results.table("points")
    if not len(points):
        return None
    found = results.table("changes")
    changed = list(dict.fromkeys(found["arm"])) if len(found) else []
    arms = [*changed, *(a for a in dict.fromkeys(points["arm"]) if a not in changed)]
    blocks: list[Block] = []
    for number, arm in enumerate(arms[:MAX_ARMS], start=1):
        own = points[points["arm"] == arm]
        name = fmt.text_or_dash(arm)
        accused = sorted({int(j) for j in found[found["arm"] == arm]["joint"]})
        outcome = f"{fmt.joint_names(list(accused), capital=True)} changed."
        if not accused:
            outcome = "No joint changed."
        share = 100 * float(results.summary.get("false_alarm") or 0)
        notes = [
            note
            for note, applies in ((CUT_NOTE, _cut_range), (UNMARKED_NOTE, _has_many_calibrations))
            if any(applies(strip) for _, strip in own.groupby("joint"))
        ]
        blocks.append(
            Figure(
                f"chart_{number}",
                " ".join([CAPTION.format(arm=name, share=f"{share:g}"), *notes]),
                f"Control charts of {name}, one strip a joint over time. {outcome}",
                arm_chart(own, found[found["arm"] == arm]),
            )
        )
    if len(arms) > MAX_ARMS:
        text = (
            f"Charts of {fmt.count(len(arms) - MAX_ARMS)} further arms are left out; "
            "none of their joints is left out of the tables."
        )
        blocks.append(Paragraph(text, "note"))
    return Section("charts", "Control charts", tuple(blocks))


def arm_chart(points: pd.DataFrame, changes: pd.DataFrame) -> Chart | None:
    """Draw one arm."""
    t = column(points, "t_days")
    zero = float(np.floor(t.min()))
    ticks = month_ticks(float(t.min()), float(t.max()))
    numbers = sorted(int(joint) for joint in set(points["joint"]))
    panels = [
        _panel(points[points["joint"] == joint], changes[changes["joint"] == joint], zero, ticks)
        for joint in numbers
    ]
    return strips(panels, f"date; days are counted from {format_day(zero)}", row_height=0.86)


def changed_joints(results: Results, most: int) -> Chart | None:
    """A strip over time for each of the first `most` joints that changed."""
    points, found = results.table("points"), results.table("changes")
    chosen = found.drop_duplicates(["arm", "joint"])[["arm", "joint"]].head(most)
    if not len(chosen) or not len(points):
        return None
    t = column(points.merge(chosen, on=["arm", "joint"]), "t_days")
    zero, ticks = float(np.floor(t.min())), month_ticks(float(t.min()), float(t.max()))
    ends = float(t.min()) - zero - 3, float(t.max()) - zero + 3  # days
    panels = []
    for arm, joint in chosen.itertuples(index=False):
        own, changes = (table[(table["arm"] == arm) & (table["joint"] == joint)]
                        for table in (points, found))  # fmt: skip
        panel = _panel(own, changes, zero, ticks)
        title = f"{fmt.text_or_dash(arm)}, joint {joint}"
        panels.append(replace(panel, title=title, y_label="error [°]", x_range=ends))
    return strips(panels, f"date; days are counted from {format_day(zero)}", row_height=1.25)


def present_errors(results: Results, arms: list[str]) -> Chart | None:
    """A panel an arm: the present error of each joint with U, and its tolerance.

    Of a joint that has no level yet all its sessions are shown, the latest one apart.
    """
    table, recent = results.table("joints"), results.table("recent")
    panels = []
    for arm in arms:
        own = table[table["arm"] == arm]
        joints = column(own, "joint")
        level = column(own, "error_deg")
        groups = [("level", "resolved", joints, level, 2 * column(own, "error_u_deg"))]
        young = recent[recent["arm"] == arm] if len(recent) else recent
        young = young[young["joint"].isin(joints[~np.isfinite(level)])] if len(young) else young
        for name, role, chosen in (
            ("earlier", "muted", young[young["order"] > 0] if len(young) else young),
            ("latest", "error", young[young["order"] == 0] if len(young) else young),
        ):
            place, error, u, k = (
                column(chosen, key) for key in ("joint", "error_deg", "u_deg", "coverage_factor")
            )
            groups.append((name, role, place, error, np.where(np.isfinite(k), k, 2.0) * u))
        if any(np.isfinite(group[3]).any() for group in groups):
            panels.append(_error_panel(arm, own, groups))
    if not panels:
        return None
    # lower where there are several rows: page one is to hold them, and what to do below
    return Chart(tuple(panels), min(2, len(panels)), row_height=1.9 if len(panels) < 3 else 1.45)


Group = tuple[str, str, Array, Array, Array]  # name, role, joints, mean errors and their U, degrees


def _error_panel(arm: str, own: pd.DataFrame, groups: list[Group]) -> Panel:
    joints, limits = column(own, "joint"), column(own, "latest_tolerance_deg")
    marks: list[Mark] = [Level(0.0, "muted")]
    for x, limit in zip(joints, limits, strict=True):
        for side in (-limit, limit) if np.isfinite(limit) else ():
            ends = np.array([x - 0.42, x + 0.42]), np.array([side, side])
            marks.append(Line(*ends, "tolerance", "tolerance"))
    reach = float(np.nanmax(np.append(limits, 0.0)))
    for name, role, place, error, u in groups:
        known = np.isfinite(error)
        if not known.any():
            continue
        x, y, half = place[known], error[known], np.nan_to_num(u[known])
        x = x + GROUP_SHIFT * (role != "muted")
        bars = np.stack([y - half, y + half, np.full(len(y), np.nan)], axis=1).ravel()
        marks += [Line(np.repeat(x, 3), bars, role), Points(x, y, role, name, size=3.0)]
        reach = max(reach, float(np.max(np.abs(y) + half)))
    return Panel(
        tuple(marks),
        "error [°]",
        title=fmt.text_or_dash(arm),
        x_ticks=tuple((x, f"{x:.0f}") for x in joints.tolist()),
        x_label="joint",
        x_range=(float(joints.min()) - 0.6, float(joints.max()) + 0.6),
        y_range=(-1.1 * reach or -1.0, 1.1 * reach or 1.0),
        unit="°",
    )


def _panel(own: pd.DataFrame, changes: pd.DataFrame, zero: float, ticks: Ticks) -> Panel:
    t, error, u = column(own, "t_days") - zero, column(own, "error_deg"), column(own, "u_deg")
    odd = own["odd"].to_numpy(dtype=bool)
    low, high = column(own, "low_deg"), column(own, "high_deg")
    marks: list[Mark] = [
        _error_bars(t, error - 2 * u, error + 2 * u),
        Line(*_break_at_calibrations(own, t, low), "tolerance", "control limits"),
        Line(*_break_at_calibrations(own, t, high), "tolerance"),
        *_fitted_course(own, t, changes, zero),
    ]
    marks += [
        Level(place, "muted", "new calibration", upright=True)
        for place in _calibration_changes(own, t)
        if not _has_many_calibrations(own)
    ]
    steps = changes[changes["term"] == "step"]
    marks += [  # in front of a new calibration at the same place
        Level((float(a) + float(b)) / 2 - zero, "encoder", "step", upright=True)
        for a, b in zip(steps["t_days"], steps["before_t_days"], strict=True)
    ]
    marks.append(Points(t[~odd], error[~odd], "error", "session", size=1.6))
    if odd.any():
        marks.append(Points(t[odd], error[odd], "series_2", "odd session", size=2.0))
    return Panel(
        tuple(marks),
        y_label=f"q{int(own['joint'].iloc[0])} [°]",
        y_range=_cut_range(own),
        x_range=(float(t.min()) - 3, float(t.max()) + 3),
        x_ticks=tuple((place - zero, text) for place, text in ticks),
        unit="°",
    )


def _has_many_calibrations(own: pd.DataFrame) -> bool:
    return len(_calibration_changes(own, column(own, "t_days"))) > MAX_CALIBRATION_MARKS


def _cut_range(own: pd.DataFrame) -> tuple[float, float] | None:
    """The range of sessions and usual limits, where single bars or limits would dwarf them."""
    error, u, low, high = (
        column(own, key) for key in ("error_deg", "u_deg", "low_deg", "high_deg")
    )
    whole = np.concatenate([error - 2 * u, error + 2 * u, low, high])
    usual = np.concatenate([error, [np.median(low), np.median(high)]])
    if np.ptp(whole) <= MAX_OVERREACH * np.ptp(usual):
        return None
    margin = 0.08 * float(np.ptp(usual))
    return float(usual.min()) - margin, float(usual.max()) + margin


def _break_at_calibrations(own: pd.DataFrame, t: Array, values: Array) -> tuple[Array, Array]:
    return _pieces(t, values, np.searchsorted(t, _calibration_changes(own, t)))


def _pieces(t: Array, values: Array, cuts: Indices) -> tuple[Array, Array]:
    """Cut a line before some of its points; a piece of one point is a short dash, no dot."""
    half = DASH_SHARE * float(np.diff(np.unique(t)).min(initial=1.0))
    x, y = [np.empty(0)], [np.empty(0)]
    for part in np.split(np.arange(len(t)), cuts):
        if len(part) == 1:
            x.append(t[part] + np.array([-half, half]))
            y.append(np.repeat(values[part], 2))
        else:
            x.append(t[part])
            y.append(values[part])
        x.append(np.array([np.nan]))
        y.append(np.array([np.nan]))
    return np.concatenate(x), np.concatenate(y)


def _error_bars(t: Array, low: Array, high: Array) -> Band:
    """Upright bars: pieces of one point, parted by NaN."""
    x, below, above = (broken(values, np.arange(len(t))) for values in (t, low, high))
    return Band(x, below, above, "error_band", "± 2u")


def _calibration_changes(own: pd.DataFrame, t: Array) -> list[float]:
    """Between which sessions the calibration changed: halfway."""
    at = np.flatnonzero(np.diff(column(own, "calibration"))) + 1
    return [(float(t[i - 1]) + float(t[i])) / 2 for i in at]


def _fitted_course(own: pd.DataFrame, t: Array, changes: pd.DataFrame, zero: float) -> list[Mark]:
    """Break the level at steps: nothing is known in between."""
    fitted = column(own, "fitted_deg")
    valid = np.isfinite(fitted)
    t, fitted = t[valid], fitted[valid]
    places = [float(d) - zero for d in changes[changes["term"] == "step"]["t_days"]]
    places += _calibration_changes(own, column(own, "t_days") - zero)
    cuts = np.searchsorted(t, sorted(place - 1e-9 for place in places))
    return [Line(*_pieces(t, fitted, cuts), "resolved", "level")]


def month_ticks(first: float, last: float) -> Ticks:
    """Mark the beginnings of months, no more than a few: (days since 1970, text)."""
    ends = np.floor([first, last]).astype(np.int64).astype("datetime64[D]").astype("datetime64[M]")
    months = np.arange(ends[0], ends[1] + 1)  # numbered from 1970 on
    places = months.astype("datetime64[D]").astype(float)
    for step in TICK_STEPS:
        shown = (places >= first) & (places <= last) & (months.astype(int) % step == 0)
        if shown.sum() <= MAX_TICKS:
            break
    if shown.sum() < 2:  # within a month or two: the ends themselves
        return tuple((e, format_day(e)) for e in ((first, last) if last - first >= 1 else (first,)))
    return tuple(zip(places[shown].tolist(), months[shown].astype(str).tolist(), strict=True))
