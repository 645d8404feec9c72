"""Page one of a run's report: what was checked, the verdict, and all that follows from it."""

from functools import partial
from pathlib import PurePath
from typing import Any

import numpy as np

from reports.document import blocks as doc
from reports.document import charts
from reports.document import formatting as fmt
from reports.document.charts import records
from reports.results import Results
from reports.session import causes, phrases
from reports.session.figures import motion
from reports.session.headline import (
    MAX_CAUSES,
    contradiction_text,
    headline,
    lost_pairs_text,
)

MAX_ALARMS = 4  # listed, the first; alarms.csv has all
ALARM_NOTE = (
    "At: when the alarm was raised, from the first pair, shortly after its cause. alarms.csv lists "
    "every alarm."
)
OFFSET = 0.14  # of two marks of a joint from its place on the axis
TOLERANCE_ROOM = 1.3  # times the tolerance that the scale spans at least
FIELDS = (
    ("maker", "Maker"), ("model", "Model"), ("serial_number", "Serial number"),
    ("owner", "Owner"), ("place", "Place"), ("operator", "Operator"),
)  # fmt: skip


def certificate(results: Results) -> doc.Section:
    """Say all that a reader needs who reads one page."""
    joints = results.summary.get("joints") or []
    limits = ", and the tolerance" if _has_tolerance(results.summary) else ""
    overview = doc.Figure(
        "overview",
        f"Mean and largest error of each joint with U ({phrases.coverage(joints)}){limits}.",
        "One place a joint: mean and largest error in degrees with their uncertainties, between "
        "the limits of the tolerance.",
    )
    otherwise = "No joint has an error that could be drawn."
    blocks: tuple[doc.Block, ...] = (
        headline(results),
        doc.Facts(tuple(_identification(results)), columns=2),
        doc.block_or_paragraph(overview, overview_chart(joints), otherwise),
        _joint_table(joints),
        *_pose_table(results),
        _causes(results.summary),
        *_alarm_blocks(results),
    )
    return doc.Section("verdict", "Verdict", blocks, part="page")


def _has_tolerance(summary: dict[str, Any]) -> bool:
    """Tell whether a tolerance of any joint was given."""
    limits = [joint.get("tolerance_deg") for joint in summary.get("joints") or []]
    return any(fmt.finite(limit) is not None for limit in limits)


def _identification(results: Results) -> list[tuple[str, str]]:
    """What was checked, by whom, with what, and when; empty where nobody has said it."""
    session, pairs = results.summary.get("session") or {}, results.summary.get("pairs") or {}
    stated, robot = session.get("certificate") or {}, results.setup.get("robot") or {}
    posed = session.get("instrument")
    instrument = str(stated.get("instrument") or posed or "stereo rig with LEDs")
    if stated.get("calibrated"):
        instrument += f", calibrated {stated['calibrated']}"
    measured = f"{fmt.count(pairs.get('measured'))} of {fmt.count(pairs.get('recorded'))}"
    return [
        ("Robot", fmt.text_or_dash(robot.get("name") or session.get("robot"))),
        ("Session", fmt.text_or_dash(PurePath(session.get("path") or "").name)),
        *((label, str(stated.get(key) or "")) for key, label in FIELDS),
        ("Instrument", instrument),
        ("Poses measured" if posed else "Pairs measured", measured),
        ("Date of measurement", _moment(str(session.get("started") or ""))),
        ("Date of issue", str(stated.get("issued") or "")),
        ("Software", doc.software(results.summary)),
        ("Signature", ""),
    ]


def _moment(started: str) -> str:
    """Write an instant of ISO 8601 as a person reads it; a date stays a date."""
    date, time, zone = started[:10], started[11:19], started[19:]
    return f"{date}, {time} UTC" if time and zone in ("Z", "+00:00") else date


def overview_chart(joints: list[dict[str, Any]]) -> charts.Chart | None:
    """All joints on one scale: mean and largest error with U, between their tolerances."""
    place = np.arange(len(joints), dtype=float)
    names = (
        "mean_error_deg", "standard_uncertainty_deg", "worst_error_deg",
        "worst_error_standard_uncertainty_deg", "tolerance_deg", "coverage_factor",
    )  # fmt: skip
    columns = [np.array([fmt.finite(j.get(n)) for j in joints], dtype=float) for n in names]
    mean, u, worst, u_worst, tolerance, factor = columns
    u, u_worst = (np.nan_to_num(np.nan_to_num(factor, nan=2.0) * s) for s in (u, u_worst))
    if not np.isfinite(mean).any():
        return None
    marks: list[charts.Mark] = [charts.Level(0.0, "muted")]
    for x, limit in zip(place, tolerance, strict=True):
        for side in (-limit, limit) if np.isfinite(limit) else ():
            ends = np.array([x - 0.42, x + 0.42]), np.array([side, side])
            marks.append(charts.Line(*ends, "tolerance", "tolerance"))
    for shift, error, spread, role, name in (
        (-OFFSET, mean, u, "error", "mean error ± U"),
        (OFFSET, worst, u_worst, "resolved", "largest error ± U"),
    ):
        for x, e, s in zip(place + shift, error, spread, strict=True):
            at, low, high = np.array([x]), np.array([e - s]), np.array([e + s])
            marks.append(charts.Band(at, low, high, f"{role}_band"))
        marks.append(charts.Points(place + shift, error, role, name, 3.0))
    largest = np.nanmax([np.abs(mean) + u, np.abs(worst) + u_worst], initial=0.0)
    reach = max(float(largest) * 1.1, TOLERANCE_ROOM * float(np.nanmax(tolerance, initial=0.0)))
    ticks = tuple((float(x), f"joint {j.get('joint')}") for x, j in zip(place, joints, strict=True))
    panel = charts.Panel(
        tuple(marks), "error [°]", x_ticks=ticks, unit="°",
        x_range=(-0.5, len(joints) - 0.5), y_range=(-reach or -1.0, reach or 1.0),
    )  # fmt: skip
    return charts.Chart((panel,), row_height=1.5)


def _joint_table(joints: list[dict[str, Any]]) -> doc.Table:
    mean = phrases.with_expanded("mean_error_deg", "standard_uncertainty_deg")
    columns = (
        doc.Column("Joint", "c", doc.field("joint")),
        doc.Column("Mean error ± U [°]", "r", mean),
        doc.Column("Largest error ± U [°]", "r", phrases.worst_error()),
        doc.Column("Tolerance [°]", "r", lambda j: phrases.tolerance(j.get("tolerance_deg"))),
        doc.Column("Verdict", "l", phrases.verdict_cell, wide=True),
    )
    title = f"Error of each joint: reading less true angle, {phrases.coverage(joints)}."
    return doc.tabulate(title, columns, joints)


def _pose_table(results: Results) -> list[doc.Table]:
    rows = []
    for name, unit in (("position", "mm"), ("orientation", "deg")):
        entry = results.summary.get(name) or {}
        if entry:
            u = f"worst_error_standard_uncertainty_{unit}"
            largest = doc.uncertain_field(f"worst_error_{unit}", u, signed=False, k=2)
            limit = fmt.exact_number(entry.get(f"tolerance_{unit}"))
            rms = fmt.number(entry.get(f"rms_error_{unit}"))
            label = f"{name} [{fmt.UNITS[unit]}]"
            place = motion.place_of_largest(results, f"{name}_resolved_{unit}")
            rows.append(
                doc.row(label, rms, largest(entry), place, limit, phrases.verdict_cell(entry))
            )
    head = ("Error of the flange", "RMS", "Largest ± U", "Place", "Tolerance", "Verdict")
    caption = (
        "Error of the flange's pose: RMS of single pairs, noise included; largest resolved error, "
        "k = 2, its place in the base."
    )
    return [doc.Table(caption, "lrrlrl", head, tuple(rows), wide=(5,))] if rows else []


def _causes(summary: dict[str, Any]) -> doc.Facts:
    """The causes found, and what to do about them."""
    every = summary.get("diagnosis") or []
    entries, more = every[:MAX_CAUSES], len(every) - MAX_CAUSES
    named = [
        f"one of {causes.rivals(entry, ' or ')}"
        if entry.get("kind") == "ambiguous"
        else causes.candidate(entry)
        for entry in entries
    ]
    if more > 0:
        named.append(f"{fmt.count(more)} more in the diagnosis")
    items = [("Cause", "; ".join(named) or "the data single out no cause")]
    if remedies := _remedies(summary, entries):
        items.append(("What to do", "; ".join(dict.fromkeys(remedies))))
    return doc.Facts(tuple(items))


def _remedies(summary: dict[str, Any], entries: list[dict[str, Any]]) -> list[str]:
    """What to do: first about pictures that contradict the files, as causes may come from that."""
    found = []
    pictures = summary.get("pictures") or {}
    if led := pictures.get("displaced_led"):
        found.append(f"measure the place of LED {led.get('name')} again")
    elif pictures.get("led_shifts"):
        found.append("measure the places of the LEDs again")
    elif contradiction_text(summary):
        found.append("find out why the pictures contradict rig.toml or marker.toml")
    found += [_remedy_of(entry, len(entries) > 1) for entry in entries]
    if not _has_tolerance(summary):
        found.append("give a tolerance (--tolerance, or session.toml) to get a verdict")
    if lost_pairs_text(summary):
        found.append("find out why so many pairs are not counted")
    return found or (["nothing"] if summary.get("verdict") == "conform" else [])


def _remedy_of(entry: dict[str, Any], one_of_several: bool) -> str:
    """What to do about one cause; beside others, of which joint it is said."""
    text, joint = causes.remedy(entry), entry.get("joint")
    return f"joint {joint}: {text}" if one_of_several and joint is not None else text


def _alarm_blocks(results: Results) -> tuple[doc.Block, ...]:
    """List the alarms of a watched run, and the cause that the diagnosis found for each."""
    if "alarms" not in results.tables:
        return ()
    alarms = records(results.table("alarms").astype({"joint": float}))
    if not alarms:
        return (doc.Paragraph("The robot was watched, and no alarm was raised."),)
    columns = (
        doc.Column("No.", "l", doc.field("alarm", fmt.count)),
        doc.Column("At [s]", "r", doc.field("t_s", fmt.number, 1)),
        doc.Column("Alarm text", "l", doc.field("text"), wide=True),
        doc.Column("Explained by", "l", partial(_explanation, results.summary)),
    )
    return (
        doc.tabulate(
            f"Alarms while the robot was watched: {fmt.count(len(alarms))}.",
            columns,
            alarms[:MAX_ALARMS],
            ALARM_NOTE,
        ),
    )


def _explanation(summary: dict[str, Any], alarm: dict[str, Any]) -> str:
    """The causes of an alarm's joint, and common ones, that had begun when it was raised."""
    joint, raised = fmt.finite(alarm.get("joint")), fmt.finite(alarm.get("t_s"))
    if joint is None or raised is None:
        return fmt.DASH
    named = [
        causes.cause_name(one)
        for one in summary.get("diagnosis") or []
        if one.get("kind") != "ambiguous" and one.get("joint") in (None, int(joint))
        and (fmt.finite(one.get("t_s")) or raised) <= raised
    ]  # fmt: skip
    return "; ".join(named) or "no cause found"
