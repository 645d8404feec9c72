"""The verdict in one sentence: what was found, and what to do about it."""

from typing import Any

import numpy as np

from reports.document import formatting as fmt
from reports.document.blocks import Verdict
from reports.results import Results
from reports.session import causes as session_causes
from reports.session import phrases
from reports.session.times import from_first_pair

LABELS = {
    "conform": "The robot conforms",
    "nonconform": "The robot does not conform",
    "undecided": "Undecided",
    "none": "No verdict",
}
MAX_CAUSES = 3  # named in the headline; more would hide the first, and the diagnosis lists them all
MAX_LOST_SHARE = 0.1  # of the pairs, above which the headline says so
CONTRADICTING = ("outlier", "ambiguous_leds", "unaligned")  # pairs that the files do not explain
SCOPE = "This covers the poses, directions and speeds that the session shows, and no others."
WORST_ERROR = phrases.worst_error("°")
# of sources that are no quantity to improve: what would make them smaller
IMPROVEMENTS = {
    "causes found": "what separates the causes found from the joints' errors (more pairs, in other "
    "postures)",
    "lack of fit": "what the errors follow beside the causes found",
    "autocorrelation": "the number of pairs that do not repeat each other's errors",
}
SINGULAR_NAMES = ("the robot base", "the measured point")


def headline(results: Results) -> Verdict:
    """Say the verdict, what to do about it, and the conditions it holds on."""
    results = from_first_pair(results)
    summary = results.summary
    tone = phrases.tone(summary.get("verdict"))
    sentence = {
        "conform": _conform,
        "nonconform": _nonconform,
        "undecided": _undecided,
        "none": _no_verdict,
    }[tone](results)
    if contradiction := contradiction_text(summary):
        sentence = (
            f"even though {contradiction}, {sentence}"
            if tone == "conform"
            else f"{contradiction}, and what follows may come from that and not from the robot: "
            f"{sentence}"
        )
    remarks = _remarks(results, tone, sentence)
    return Verdict(tone, LABELS[tone], fmt.capitalise(sentence), tuple(remarks))


def with_verdict(summary: dict[str, Any], verdict: str) -> list[dict[str, Any]]:
    """Select the joints with a verdict."""
    return [joint for joint in (summary.get("joints") or []) if joint.get("verdict") == verdict]


def tolerance_text(summary: dict[str, Any], chosen: list[dict[str, Any]]) -> str:
    """Say the tolerance of some joints, where they share one."""
    values = {fmt.finite(joint.get("tolerance_deg")) for joint in chosen} - {None}
    if len(values) != 1:
        return "their tolerances" if summary else ""
    return f"±{fmt.exact_number(values.pop())}°"


def _conform(results: Results) -> str:
    chosen = results.summary.get("joints") or []
    each = [fmt.finite(joint.get("conformance_probability")) for joint in chosen]
    least = min((p for p in each if p is not None), default=None)
    bound = tolerance_text(results.summary, chosen)
    lost = lost_pairs_text(results.summary) or contradiction_text(results.summary)
    where = "at every pose that was measured" if lost else "at every pose of this session"
    sentence = f"every joint's error stays within {bound} {where}"
    if least is not None:
        level = min(int(least * 1000) / 10, 99.9)  # rounded down: never claim more than was found
        sentence += f", each with a probability of at least {fmt.number(level, 1)} %"
    found = results.summary.get("diagnosis") or []
    if not found:
        return (
            f"{sentence}."
            if lost or _led_remark(results.summary)
            else f"{sentence}; nothing needs to be done."
        )
    sure = [entry for entry in found if entry.get("kind") != "ambiguous"]
    if contradiction_text(results.summary) or not sure:  # causes may be the pictures' doing
        return f"{sentence}."
    return f"{sentence}; yet {_findings(sure)}."


def _nonconform(results: Results) -> str:
    summary = results.summary
    failing = with_verdict(summary, "nonconform")
    if contradiction_text(summary):  # causes may be the pictures' doing
        return _exceeding(summary, failing) + "."
    guilty = {joint.get("joint") for joint in failing} | {None}
    causes = [
        entry
        for entry in (summary.get("diagnosis") or [])
        if entry.get("kind") != "ambiguous"
        and (not failing or entry.get("joint") in guilty or entry.get("kind") == "dh")
    ]
    if causes:
        return f"{_findings(causes)}."
    unclear = [e for e in (summary.get("diagnosis") or []) if e.get("kind") == "ambiguous"]
    what = _exceeding(summary, failing)
    if unclear:
        rivals = session_causes.rivals(unclear[0], " or ")
        return (
            f"{what}; the data do not say whether by {rivals}: {session_causes.remedy(unclear[0])}."
        )
    return f"{what}, and no single cause accounts for it: look at the errors over time below."


def _findings(causes: list[dict[str, Any]]) -> str:
    """Say the first causes, and what to do about each."""
    return "; ".join(session_causes.finding(entry) for entry in causes[:MAX_CAUSES])


def lost_pairs_text(summary: dict[str, Any]) -> str:
    """Say how many pairs are not counted, and why, where they are many; empty: they are few."""
    pairs = summary.get("pairs") or {}
    recorded, measured = (fmt.finite(pairs.get(key)) for key in ("recorded", "measured"))
    if recorded is None or measured is None or measured >= (1 - MAX_LOST_SHARE) * recorded:
        return ""
    rejected = (pairs.get("rejected") or {}).items()
    why = [f"{fmt.lookup_label(phrases.STATUSES, status)}: {count}" for status, count in rejected]
    return (
        f"{recorded - measured:.0f} of {recorded:.0f} pairs are not counted ({'; '.join(why)}), "
        "and nothing is said of their poses."
    )


def contradiction_text(summary: dict[str, Any]) -> str:
    """Say that the pictures contradict the files that they are measured by; empty: they agree."""
    pictures = summary.get("pictures") or {}
    led = pictures.get("displaced_led")
    if led and not led.get("left_out"):
        return _displaced_led_text(led)
    contradict = bool(pictures.get("contradict")) or _most_lost_contradict(summary)
    return "the pictures contradict rig.toml or marker.toml" * contradict


def _led_remark(summary: dict[str, Any]) -> str:
    """Say that LEDs are not in their places, and no figure rests on those; empty: they are."""
    pictures = summary.get("pictures") or {}
    led = pictures.get("displaced_led") or {}
    if led.get("left_out"):
        return f"{_displaced_led_text(led)}: no figure rests on it."
    if not (shifts := pictures.get("led_shifts")):
        return ""
    most = fmt.number(float(np.linalg.norm(shifts["shift_mm"], axis=1).max()), 2)
    return (
        f"The LEDs are up to {most} mm from where marker.toml puts them beside each other: all "
        "figures rest on their places in the pictures."
    )


def _displaced_led_text(led: dict[str, Any]) -> str:
    length = float(np.linalg.norm(led["displacement_mm"]))
    amount = fmt.with_uncertainty(length, led.get("expanded_uncertainty_mm"), "mm", False)
    when = " in the last pairs" if led.get("last_pairs_only") else ""
    return f"LED {led.get('name')} is seen {amount} from its place in marker.toml{when}"


def _most_lost_contradict(summary: dict[str, Any]) -> bool:
    """Tell whether many pairs are lost, half of them or more as no pose explains their LEDs."""
    pairs = summary.get("pairs") or {}
    rejected = pairs.get("rejected") or {}
    contradicting = sum(int(rejected.get(status) or 0) for status in CONTRADICTING)
    contradicting -= int(pairs.get("repeated") or 0)  # a camera's doing
    lost = sum(int(count or 0) for count in rejected.values())
    return bool(lost_pairs_text(summary)) and 2 * contradicting >= lost > 0


def _exceeding(summary: dict[str, Any], failing: list[dict[str, Any]]) -> str:
    if failing:
        worst = max(failing, key=lambda j: abs(fmt.finite(j.get("worst_error_deg")) or 0.0))
        text, factor = WORST_ERROR(worst), phrases.coverage([worst])
        verb = "exceed" if len(failing) > 1 else "exceeds"
        names = fmt.joint_names([joint.get("joint") for joint in failing])
        return (
            f"{names} {verb} {tolerance_text(summary, failing)} (largest error: {text}, {factor})"
        )
    pose = []
    for name, unit in (("position", "mm"), ("orientation", "deg")):
        entry = summary.get(name) or {}
        if entry.get("verdict") == "nonconform":
            limit = fmt.exact_number(entry.get(f"tolerance_{unit}"))
            sign = "°" if unit == "deg" else f" {unit}"
            u = fmt.expanded(entry.get(f"worst_error_standard_uncertainty_{unit}"))
            size = fmt.with_uncertainty(entry.get(f"worst_error_{unit}"), u, sign.strip(), False)
            largest = "" if size == fmt.DASH else f" (largest error: {size}, k = 2)"
            pose.append(f"the flange's {name} error exceeds {limit}{sign}{largest}")
    return fmt.join_words(pose) or "the tolerance is exceeded"


def _undecided(results: Results) -> str:
    summary = results.summary
    open_joints = with_verdict(summary, "undecided")
    if not open_joints:
        names = [n for n in ("position", "orientation")
                 if (summary.get(n) or {}).get("verdict") == "undecided"]  # fmt: skip
        subject = f"the flange's {fmt.join_words(names)}" if names else "the robot"
        improvement = _first_improvement(results, [])
        return f"the instrument cannot tell whether {subject} conforms; {improvement}."
    names_text = fmt.joint_names([joint.get("joint") for joint in open_joints])
    verb = "stay" if len(open_joints) > 1 else "stays"
    return (
        f"the instrument cannot tell whether {names_text} {verb} within "
        f"{tolerance_text(summary, open_joints)}; {_first_improvement(results, open_joints)}."
    )


def _first_improvement(results: Results, open_joints: list[dict[str, Any]]) -> str:
    """Say what would have to improve first; the reason that bars most comes first."""
    if any(j.get("reason") == "pairs_lost" for j in open_joints):
        return "most pairs were lost: first find out why"
    unseen = [j for j in open_joints if j.get("reason") == "not_observable"]
    if unseen:
        freed = hiding_parameter(results, unseen[0])[1]
        return (
            f"an offset of {fmt.joint_names([j.get('joint') for j in unseen])} cannot show: {freed}"
        )
    by_reason = {
        reason: [j.get("joint") for j in open_joints if j.get("reason") == reason]
        for reason in (
            "clock_ambiguous", "lack_of_fit", "not_detectable", "uncertainty_too_large",
        )
    }  # fmt: skip
    if by_reason["clock_ambiguous"]:
        return "first give the clock offset, or record the readings' arrival times"
    if by_reason["lack_of_fit"]:
        return (
            f"the errors of {fmt.joint_names(by_reason['lack_of_fit'])} follow no known curve: "
            "first find out why in the errors over time"
        )
    names = by_reason["not_detectable"] or by_reason["uncertainty_too_large"]
    source = _largest_source(results, names or [j.get("joint") for j in open_joints])
    if source:
        return f"what would have to improve first is {source}"
    return "a smaller uncertainty is needed first"


def is_hidden(joint: dict[str, Any]) -> bool:
    """Tell whether a constant offset of a joint could not have shown, however large."""
    share = fmt.finite(joint.get("visible_fraction"))
    return joint.get("reason") == "not_observable" or (
        share is not None and share < phrases.MAX_HIDDEN_SHARE
    )


def _encoder_based_text(results: Results) -> str:
    """Name what was found through the robot's own encoders; empty: nothing was."""
    rig, marker = results.setup.get("rig") or {}, results.setup.get("marker") or {}
    body = "the measured point" if "point_mm" in marker else "the LED positions"
    found = (("the robot base", rig.get("base_source")), (body, marker.get("source")))
    return fmt.join_words([name for name, source in found if source == "motion"])


def _hidden_sentences(results: Results) -> list[str]:
    """Say of which joints an offset cannot show, and why; joints of one reason together."""
    groups: dict[str, list[Any]] = {}
    for joint in results.summary.get("joints") or []:
        if is_hidden(joint):
            groups.setdefault(hiding_parameter(results, joint)[0], []).append(joint.get("joint"))
    return [
        f"A constant offset of {fmt.joint_names(names)} cannot show here: {why}."
        for why, names in groups.items()
    ]


def hiding_parameter(results: Results, joint: dict[str, Any]) -> tuple[str, str]:
    """Say what takes in an offset of a joint, and what would free it."""
    summary, fitted = results.summary, _encoder_based_text(results)
    before, since = (
        fmt.finite(joint.get(f"visible_fraction{when}")) for when in ("", "_since_registration")
    )
    if before is not None and before < phrases.MAX_HIDDEN_SHARE:
        if fitted and (since is None or since >= phrases.MAX_HIDDEN_SHARE):
            verb = "was" if fitted in SINGULAR_NAMES else "were"
            return (
                f"{fitted} {verb} found through the same encoders",
                f"first give {fitted} by a fixture, or from another registration",
            )
        if (summary.get("clock") or {}).get("observable") is False:
            return (
                "the motion does not separate it from an offset of the encoder clock",
                "first give the clock offset, or move at varied speeds in both directions",
            )
    for entry in summary.get("combinations") or []:
        if entry.get("why") == "singularity" and joint.get("joint") in (entry.get("joints") or []):
            label = fmt.text_or_dash(entry.get("label"))
            return (
                f"near a singularity only the sum {label} is determined",
                "first record poses away from the singularity",
            )
    return (
        "the measured poses do not determine it",
        "first record other poses, or more points of the flange",
    )


def _largest_source(results: Results, names: list[Any]) -> str:
    budget = results.table("budget")
    if not {"joint", "source", "standard_uncertainty_deg"} <= set(budget.columns):
        return ""
    rows = budget[budget["joint"].isin(names)].dropna(subset=["standard_uncertainty_deg"])
    if rows.empty:
        return ""
    largest = rows.sort_values("standard_uncertainty_deg", ascending=False, kind="stable").iloc[0]
    amount = fmt.quantity(float(largest["standard_uncertainty_deg"]), "°")
    source = str(largest["source"]).replace("_", " ")
    joint = f"joint {largest['joint']}'s standard uncertainty"
    if source in IMPROVEMENTS:
        return f"{IMPROVEMENTS[source]}: this part of {joint} is {amount}"
    return f"{source}, which alone makes {amount} of {joint}"


def _no_verdict(results: Results) -> str:
    sentence = "no tolerance was given, so there is no verdict"
    every = results.summary.get("joints") or []
    if any(fmt.finite(joint.get("tolerance_deg")) is not None for joint in every):
        sentence = "a tolerance was given, but there is nothing that could be judged by it"
    known = [joint for joint in every if fmt.finite(joint.get("mean_error_deg")) is not None]
    if not known:
        return f"{sentence}."
    worst = max(known, key=lambda j: abs(float(j["mean_error_deg"])))
    amount = fmt.with_uncertainty(
        worst["mean_error_deg"], worst.get("expanded_uncertainty_deg"), "°"
    )
    if fmt.finite(worst.get("coverage_factor")) is not None:
        amount = f"{amount} ({phrases.coverage([worst])})"
    return f"{sentence}; the largest mean error is that of joint {worst.get('joint')}, {amount}."


def _remarks(results: Results, tone: str, sentence: str) -> list[str]:
    """Say what the verdict rests on and leaves open, but not again what its sentence says."""
    summary = results.summary
    remarks = list(filter(None, [lost_pairs_text(summary)]))
    if remark := _led_remark(summary):
        remarks.append(remark)
    if tone == "nonconform":
        failing, open_joints = with_verdict(summary, tone), with_verdict(summary, "undecided")
        if (exceeding := _exceeding(summary, failing)) not in sentence:
            remarks.append(fmt.capitalise(exceeding) + ".")
        if open_joints:
            names = fmt.joint_names([joint.get("joint") for joint in open_joints])
            remarks.append(
                f"Whether {names} conform{'' if len(open_joints) > 1 else 's'} is undecided."
            )
    if tone in ("nonconform", "undecided"):
        remarks += _reason_sentences(summary)
    remarks += _hidden_sentences(results)
    uncounted = (summary.get("budget") or {}).get("uncounted") or []
    if uncounted:
        exact = [fmt.text_or_dash(name) for name in uncounted]
        remarks.append(
            f"Taken as exact, as their uncertainty is not stated: {fmt.join_words(exact)}. "
            f"{'Every figure' if tone == 'none' else 'The verdict'} holds on that condition."
        )
    return remarks if tone == "none" else [*remarks, SCOPE]


def _reason_sentences(summary: dict[str, Any]) -> list[str]:
    """List the joints of each reason for which the verdict stays open, but what cannot show."""
    groups: dict[str, list[Any]] = {}
    for joint in with_verdict(summary, "undecided"):
        if joint.get("reason") != "not_observable":
            groups.setdefault(str(joint.get("reason") or ""), []).append(joint.get("joint"))
    return [
        f"{fmt.joint_names(names, capital=True)}: {fmt.lookup_label(phrases.REASONS, reason)}."
        for reason, names in groups.items()
        if reason
    ]
