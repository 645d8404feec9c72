"""Page one of a fleet report: which arm and joint, how far off, since when, what to do."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import records
from reports.fleet import charts as fleet_charts
from reports.fleet import names
from reports.results import Results
from reports.session import phrases

MAX_NAMED = 4  # sessions or changes in the headline; the appendix has all
MAX_ROWS = 8  # of the table; those that do not conform or changed come first
MAX_PANELS = 4  # arms, or changed joints, that the picture shows


def certificate(results: Results) -> doc.Section:
    """Say all that a reader needs who reads one page."""
    blocks = (
        headline(results),
        doc.Facts(tuple(_identification(results)), columns=2),
        _picture(results),
        *_table(results),
        doc.remedies(_actions(results), _unchecked(results)),
    )
    return doc.Section("verdict", "State of the fleet", blocks)


def headline(results: Results) -> doc.Verdict:
    """Say what does not conform and what changed; else how far that was tested."""
    verdicts = results.summary.get("verdicts") or {}
    found, failing = records(results.table("changes")), nonconforming_sessions(results, short=True)
    held = results.summary.get("sessions") or {}
    remarks = [
        f"{counted(count, 'session')} {what}."
        for key, what in (
            ("failed", "could not be measured"),
            ("copies", "not counted: the same recording as another"),
        )
        if (count := int(held.get(key) or 0))
    ]
    remarks = [*several_arms(results), *remarks]
    if exact := results.summary.get("uncounted"):
        remarks.append(
            f"The figures hold on the condition that {fmt.join_words(exact)} are exact: some "
            "sessions do not state their uncertainty."
        )
    if found:
        remarks = [f"Beyond tolerance: {_list_few(failing)}.", *remarks] if failing else remarks
        return _changed(results, found, (*remarks, fleet_charts.false_alarm_text(results.summary)))
    tested = change_text(results)
    remarks.insert(0, tested)
    if judged_joints(results):
        remarks.append(fleet_charts.false_alarm_text(results.summary))
    measured = fmt.count((results.summary.get("sessions") or {}).get("measured"))
    for word, verb in (("nonconform", ("does not conform", "do not conform")),
                       ("undecided", ("is undecided", "are undecided"))):  # fmt: skip
        if count := int(verdicts.get(word) or 0):
            label = f"{fmt.count(count)} of {measured} sessions {verb[count > 1]}"
            sentence = f"{_list_few(failing)}." if failing else _largest_text(results)
            return doc.Verdict(word, label, sentence, tuple(remarks))
    if verdicts.get("conform"):
        label = f"{fmt.count(verdicts['conform'])} of {measured} sessions conform"
        return doc.Verdict("conform", label, _largest_text(results), tuple(remarks))
    tone, label = ("conform", "No change") if judged_joints(results) else ("none", "No verdict")
    if _scattered(results):
        tone, label = "undecided", "Scatter not explained"
    sentence = tested if judged_joints(results) else f"No tolerance was given. {tested}"
    remarks[0] = _largest_text(results)
    return doc.Verdict(tone, label, sentence, tuple(remarks))


def judged_joints(results: Results) -> int:
    """Count the joints that have sessions enough to be followed over time."""
    table = results.table("joints")
    return int((table["state"] != "unknown").sum()) if len(table) else 0


def change_text(results: Results) -> str:
    """Say of a fleet without a change how far changes were sought."""
    judged = judged_joints(results)
    if judged:
        verb = "shows a step or a drift" if _scattered(results) else "changed over time"
        scatter = _scatter_text(results)
        return f"None of the {fmt.count(judged)} joints that can be followed {verb}.{scatter}"
    fewest = fmt.count(results.summary.get("fewest_sessions"))
    return f"Changes over time were not tested: no joint has {fewest} dated sessions with a figure."


def _changed(
    results: Results, found: list[dict[str, Any]], remarks: tuple[str, ...]
) -> doc.Verdict:
    judged, accused = judged_joints(results), len({(one["arm"], one["joint"]) for one in found})
    label = f"{fmt.count(accused)} of {fmt.count(judged)} joints changed"
    texts = [fleet_charts.change_text(one) for one in found[:MAX_NAMED]]
    if len(found) > MAX_NAMED:
        texts.append(f"{fmt.count(len(found) - MAX_NAMED)} further changes are in the appendix")
    steady = judged - accused - len(_scattered(results))
    rest = f" The other {counted(steady, 'joint')} show no change." if steady else ""
    sentence = f"{fmt.capitalise('; '.join(texts))}.{_scatter_text(results)}{rest}"
    return doc.Verdict("nonconform", label, sentence, remarks)


def several_arms(results: Results) -> list[str]:
    """Say of each arm whose sessions look like those of several which of them differ."""
    held: dict[str, dict[str, Any]] = {}
    differences = [one for one in records(results.table("contrasts")) if one["shown"] is True]
    # of each arm the largest; folders before calibrations
    for one in sorted(
        differences, key=lambda one: (one["question"] == "folder", abs(one["difference_deg"]))
    ):
        if one["question"] in ("folder", "calibration"):
            held[str(one["arm"])] = one
    told = []
    for one in held.values():
        size = fmt.with_uncertainty(one["difference_deg"], 2 * one["difference_u_deg"], "°")
        which, advice = f"in {one['second']}", "--by folder follows each by itself"
        if one["question"] == "calibration":
            which, advice = "of one calibration", "state serial_number in session.toml"
        told.append(
            f"{fmt.text_or_dash(one['arm'])}: the {fmt.count(one['second_sessions'])} sessions "
            f"{which} differ in joint {one['joint']} by {size} (k = 2) from those between them. "
            f"They may be of several arms: {advice}."
        )
    return told


def _scattered(results: Results) -> list[dict[str, Any]]:
    """Joints whose sessions scatter more than they state, and show no change by that scatter."""
    states = ("scattered", "unclear")
    return [one for one in records(results.table("joints")) if one["state"] in states]


def _scatter_text(results: Results) -> str:
    found = _scattered(results)
    told = [
        f"{fmt.text_or_dash(one['arm'])}, joint {one['joint']} by {fmt.number(one['excess'], 1)} "
        "times"
        for one in found
    ]
    return (
        f" Sessions scatter beyond what they state, unexplained: {_list_few(told)}." if told else ""
    )


def nonconforming_sessions(results: Results, *, short: bool = False) -> list[str]:
    """Say of each session that does not conform which joint is off most, and by how much.

    `short`: without the folders that all sessions share.
    """
    shorten = names.shortener(results) if short else fmt.text_or_dash
    return [
        f"{_excess(one)} ({shorten(one.get('session'))})"
        for one in records(results.table("worst"))
        if one.get("verdict") == "nonconform" and fmt.finite(one.get("worst_error_deg")) is not None
    ]


def _excess(one: dict[str, Any]) -> str:
    """What of a session is beyond its tolerance: a joint, else the flange's pose."""
    arm, tolerance = fmt.text_or_dash(one.get("arm")), fmt.finite(one.get("tolerance_deg"))
    if one.get("joint_verdict") != "nonconform" and one.get("pose"):
        return f"{arm}, the flange's {one['pose']} is beyond its tolerance"
    mean = fmt.finite(one.get("mean_error_deg"))
    upto, key = "", "mean_error"
    if mean is None or tolerance is None or abs(mean) <= tolerance:
        upto, key = "up to ", "worst_error"
    error, k = float(one[f"{key}_deg"]), one.get("coverage_factor")
    spread = expanded(one, f"{key}_u_deg", "coverage_factor")
    amount = fmt.with_uncertainty(abs(error), spread, "°", signed=False)
    bound = "" if tolerance is None else f", tolerance ±{fmt.exact_number(tolerance)}°"
    way, joint = "high" if error > 0 else "low", fmt.joint_names([one.get("joint")])
    return f"{arm}, {joint} reads {upto}{amount} ({fmt.coverage_text(k)}) too {way}{bound}"


def _list_few(lines: list[str]) -> str:
    more = len(lines) - MAX_NAMED
    rest = f"; {fmt.count(more)} more are in the appendix" if more > 0 else ""
    return "; ".join(lines[:MAX_NAMED]) + rest


def _largest_text(results: Results) -> str:
    """Name the joint with the largest present error."""
    errors = [(abs(value), one) for one in records(results.table("joints"))
              if (value := present_error(one)[0]) is not None]  # fmt: skip
    if not errors:
        return "No joint has a figure."
    one = max(errors, key=lambda pair: pair[0])[1]
    value, u = present_error(one)
    return (
        f"Largest present error: {fmt.text_or_dash(one.get('arm'))}, joint {one.get('joint')}, "
        f"{fmt.with_uncertainty(value, u, '°')} ({fmt.coverage_text(_present_factor(one))})."
    )


def present_error(one: dict[str, Any]) -> tuple[float | None, float | None]:
    """A joint's error and U, °: the level of its sessions (k = 2), else that of the latest one."""
    level = fmt.finite(one.get("error_deg"))
    if level is not None:
        return level, fmt.expanded(one.get("error_u_deg"))
    spread = expanded(one, "latest_error_u_deg", "latest_coverage_factor")
    return fmt.finite(one.get("latest_error_deg")), spread


def _present_factor(one: dict[str, Any]) -> Any:
    """The coverage factor of `present_error`: of a level 2."""
    known = fmt.finite(one.get("error_deg")) is not None
    return None if known else one.get("latest_coverage_factor")


def expanded(one: dict[str, Any], u_key: str, k_key: str) -> float | None:
    """U of an entry by its own coverage factor; k = 2 where it has none."""
    u, k = fmt.finite(one.get(u_key)), fmt.finite(one.get(k_key))
    return fmt.expanded(u) if u is None or k is None else k * u


def _identification(results: Results) -> list[tuple[str, str]]:
    summary = results.summary
    held = summary.get("sessions") or {}
    pairs = (fmt.count(held.get(f"pairs_{name}")) for name in ("measured", "recorded"))
    days = [fmt.text_or_dash(held.get(end)) for end in ("first", "last")]
    items = [
        ("Arms", fmt.count(len(summary.get("arms") or []))),
        ("Sessions measured", fmt.count(held.get("measured"))),
        ("Sessions that failed", fmt.count(held.get("failed"))),
        ("Dates", days[0] if days[0] == days[1] else " to ".join(days)),
        ("Stereo pairs", " measured of ".join(pairs)),
    ]
    if folder := names.common_folder(results):
        items.append(("Sessions below", folder))
    return items


def _picture(results: Results) -> doc.Block:
    """The changed joints over time, else the present error of every joint."""
    if len(results.table("changes")):
        figure = doc.Figure(
            "changed_joints",
            "Mean error of the joints that changed, a dot a session (bar: ± 2u), and the level "
            "that the sessions show. Dashed: a step.",
            "Strips over time, one a changed joint: mean error in degrees.",
        )
        drawing = fleet_charts.changed_joints(results, MAX_PANELS)
    else:
        young = [] if judged_joints(results) else records(results.table("recent"))
        present = [_present_factor(one) for one in records(results.table("joints"))]
        factors = fmt.coverage_text(*present, *(one.get("coverage_factor") for one in young))
        figure = doc.Figure(
            "present_errors",
            f"Mean error of each joint with U ({factors}), and the tolerance: the level that its "
            "sessions show; where they are too few for that, each session, the latest apart.",
            "Panels, one an arm: mean error of each joint in degrees, with its uncertainty.",
        )
        drawing = fleet_charts.present_errors(results, _ranked_arms(results)[:MAX_PANELS])
    return doc.block_or_paragraph(figure, drawing, "No joint has a figure that could be drawn.")


def _ranked_arms(results: Results) -> list[str]:
    """All arms: those with sessions that do not conform first, then those that changed."""
    changed = set(results.table("changes")["arm"]) if len(results.table("changes")) else set()
    entries = records(results.table("arms"))
    entries.sort(key=lambda e: (-int(e["nonconform"]), e["arm"] not in changed, str(e["arm"])))
    return [str(entry["arm"]) for entry in entries]


def _table(results: Results) -> tuple[doc.Table, ...]:
    """The arms; while none can be followed over time, their sessions."""
    if not judged_joints(results):
        return session_table(results, MAX_ROWS)
    ranked = _ranked_arms(results)
    if not ranked:
        return ()
    joints = records(results.table("joints"))
    entries = [
        next(one for one in records(results.table("arms")) if one["arm"] == arm)
        | {"own": [joint for joint in joints if joint["arm"] == arm]}
        for arm in ranked[:MAX_ROWS]
    ]
    columns = (
        doc.Column("Arm", "l", doc.field("arm")),
        doc.Column("Sessions", "r", doc.field("sessions", fmt.count)),
        doc.Column("Conform / undecided / not", "r", verdict_counts),
        doc.Column("Joint", "r", lambda e: fmt.text_or_dash(_largest(e["own"]).get("joint"))),
        doc.Column("Largest present error ± U [°]", "r", _largest_error),
        doc.Column("Change over time", "l", _change_cell, wide=True),
    )
    caption = "Each arm: its sessions, the largest present error of a joint, k = 2, and changes."
    more = len(ranked) - MAX_ROWS
    notes = [f"{counted(more, 'arm')} more: in the appendix."] if more > 0 else []
    return (doc.tabulate(caption, columns, entries, *notes),)


def session_table(results: Results, most: int) -> tuple[doc.Table, ...]:
    """List the sessions with the largest errors, with links to their own reports."""
    entries = records(results.table("worst"))
    if not entries:
        return ()
    shorten = names.shortener(results)

    def linked(one: dict[str, Any]) -> doc.Cell:
        place = f"{one['kept_in']}/report.html" if one["reported"] is True else ""
        return doc.Cell(shorten(one["session"]), link=place)

    columns = (
        doc.Column("Session", "l", linked, wide=True),
        doc.Column("Started", "l", doc.field("started")),
        doc.Column("Arm", "l", doc.field("arm")),
        doc.Column("Joint", "r", doc.field("joint", str)),
        doc.Column(
            "Largest error ± U [°]",
            "r",
            doc.uncertain_field(
                "worst_error_deg", "worst_error_u_deg", k=2, k_key="coverage_factor"
            ),
        ),
        doc.Column("Verdict", "l", _session_verdict),
    )
    factors = fmt.coverage_text(*(one.get("coverage_factor") for one in entries[:most]))
    caption = f"Sessions with the largest errors, {factors}; those that do not conform first."
    return (doc.tabulate(caption, columns, entries[:most]),)


def _session_verdict(one: dict[str, Any]) -> doc.Cell:
    """A session's verdict, with the flange's pose where that, and not the joint, makes it."""
    cell = phrases.verdict_cell({"verdict": one["verdict"]})
    if one.get("pose") and one.get("joint_verdict") != one["verdict"]:
        return replace(cell, text=f"{cell.text}: {one['pose']}")
    return cell


def verdict_counts(one: dict[str, Any]) -> str:
    """Write how many sessions conform, are undecided, and do not conform."""
    counts = [one["conform"], one["undecided"], one["nonconform"]]
    return " / ".join(fmt.count(n) for n in counts) if any(counts) else fmt.DASH


def _largest(joints: Iterable[dict[str, Any]]) -> dict[str, Any]:
    return max(joints, key=lambda one: abs(present_error(one)[0] or 0.0), default={})


def _largest_error(entry: dict[str, Any]) -> str:
    return fmt.with_uncertainty(*present_error(_largest(entry["own"])))


def _change_cell(entry: dict[str, Any]) -> doc.Cell:
    states: dict[str, list[Any]] = {}
    for joint in entry["own"]:
        states.setdefault(str(joint["state"]), []).append(joint["joint"])
    told = [f"{fmt.joint_names(joints)}: {fleet_charts.STATES.get(state, state)}"
            for state, joints in states.items() if state not in ("steady", "unknown")]  # fmt: skip
    if told:
        changed = states.keys() - {"steady", "unknown", "scattered", "unclear"}
        return doc.Cell("; ".join(told), "nonconform" if changed else "undecided")
    if "steady" in states:
        return doc.Cell("none", "conform")
    return doc.Cell("not tested: too few sessions", "undecided")


def _actions(results: Results) -> list[str]:
    """List what to do, what is worst first."""
    actions = []
    if (results.summary.get("verdicts") or {}).get("nonconform"):
        listed = results.table("worst")
        missing = " (run the batch with --reports)" * (not listed["reported"].all())
        actions.append(
            f"Read the reports of the sessions that do not conform{missing}: they name the cause "
            "and the correction."
        )
    if len(results.table("changes")):
        actions.append(
            "Find out what happened to the changed joints at their dates, then correct or repair "
            "them and measure again."
        )
    if (results.summary.get("verdicts") or {}).get("undecided"):
        actions.append("Reduce the uncertainty of the undecided sessions: their reports say how.")
    if not judged_joints(results):
        fewest = fmt.count(results.summary.get("fewest_sessions"))
        actions.append(f"To follow changes, measure each arm on at least {fewest} dates.")
    return actions or ["Go on measuring: nothing needs to be done."]


def _unchecked(results: Results) -> list[str]:
    """List what the fleet's sessions could not show."""
    held, joints = results.summary.get("sessions") or {}, records(results.table("joints"))
    sentences = []
    hidden = [one for one in joints if is_hidden(one.get("visible"))]
    for arm in list(dict.fromkeys(one["arm"] for one in hidden))[:MAX_NAMED]:
        own = [one["joint"] for one in hidden if one["arm"] == arm]
        sentences.append(
            f"{fmt.text_or_dash(arm)}: an offset of {fmt.joint_names(own)} that was there at "
            "registration."
        )
    young = sum(one["state"] == "unknown" for one in joints)
    if young:
        sentences.append(
            f"Changes over time of {fmt.count(young)} of {counted(len(joints), 'joint')}: too few "
            "sessions."
        )
    if held.get("undated"):
        sentences.append(f"{counted(int(held['undated']), 'session')} without a date: in no chart.")
    sentences.append("Poses, directions and speeds that no session shows.")
    return sentences


def is_hidden(share: Any) -> bool:
    """Tell whether nothing of an offset shows."""
    figure = fmt.finite(share)
    return figure is not None and figure < phrases.MAX_HIDDEN_SHARE


def counted(number: int, noun: str) -> str:
    """Write a number of things."""
    return f"{fmt.count(number)} {noun}{'' if number == 1 else 's'}"
