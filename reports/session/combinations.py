"""Sums of joint errors known well and badly; the smallest fault of each kind that shows."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.document.charts import Array, records, square
from reports.results import Results
from reports.session import causes, phrases

MIN_RELATIVE_WEIGHT = 0.1  # of the largest weight: less is left out of a sum
MIN_JOINTS = 2  # joints


def combination_blocks(summary: dict[str, Any]) -> list[doc.Block]:
    """Set sums that are known well beside their members and the sum that is known worst."""
    entries = summary.get("joints") or []
    u = np.array([_float_or_nan(joint.get("standard_uncertainty_deg")) for joint in entries])
    mean = np.array([_float_or_nan(joint.get("mean_error_deg")) for joint in entries])
    covariance = _covariance(summary.get("joint_error_correlation"), u)
    if covariance is None:
        return []
    names = [fmt.text_or_dash(joint.get("joint")) for joint in entries]
    determined = np.flatnonzero(np.isfinite(np.diag(covariance)))
    part = covariance[np.ix_(determined, determined)]
    if len(determined) < MIN_JOINTS or not np.isfinite(part).all():
        return []
    vectors = np.linalg.eigh(part)[1]
    k = phrases.sum_factor(entries)
    factor = fmt.exact_number(round(k, 2))
    sums = [c for c in summary.get("combinations") or [] if c.get("why") == "well_known"]
    rows = [
        doc.row(
            fmt.text_or_dash(c.get("label")).replace("-", fmt.MINUS),
            fmt.with_uncertainty(c.get("mean_error_deg"), k * c["standard_uncertainty_deg"]),
            factor,
            "axes are parallel",
        )
        for c in sums
        if fmt.finite(c.get("standard_uncertainty_deg")) is not None
    ]
    members = {joint for c in sums for joint in c.get("joints") or []}
    for place, name in enumerate(names):
        joint = entries[place]
        if joint.get("joint") in members and np.isfinite(u[place]):
            rows.append(
                doc.row(
                    f"q{name}",
                    phrases.with_expanded("mean_error_deg", "standard_uncertainty_deg")(joint),
                    phrases.coverage([joint]).removeprefix("k = "),
                    "a member by itself",
                )
            )
    sizes: list[float] = []
    for which, why in ((0, "known best of all sums"), (-1, "known worst of all sums")):
        exact = vectors[:, which] / vectors[np.argmax(np.abs(vectors[:, which])), which]
        # the figures are those of the sum that is named, not of the one beside it
        weights = np.where(np.abs(exact) > MIN_RELATIVE_WEIGHT, np.round(exact, 2), 0.0)
        label = _combination_name(weights, [names[k] for k in determined])
        sizes.append(math.sqrt(max(float(weights @ part @ weights), 0.0)))
        value = fmt.with_uncertainty(weights @ mean[determined], k * sizes[-1])
        rows.append(doc.row(label, value, factor, why))
    return [
        doc.Table(
            "Sums of the joints' mean errors, those known well beside those known badly.",
            "lrrl",
            ("Sum", "Mean error ± U [°]", "k", "Why it is given"),
            tuple(rows),
            (_uncertainty_ratio_text(*sizes),),
        )
    ]


def _uncertainty_ratio_text(best: float, worst: float) -> str:
    ratio = worst / best if best > 0 else None
    return (
        f"The worst known sum is {fmt.quantity(ratio, '')} times as uncertain as the best known "
        "one: single joints are to be read together with their correlation. Weights under a tenth "
        "of the largest are left out."
    )


def _float_or_nan(value: Any) -> float:
    figure = fmt.finite(value)
    return float("nan") if figure is None else figure


def _covariance(rows: Any, u: Array) -> Array | None:
    correlation = square(rows, len(u))
    return correlation * np.outer(u, u) if correlation.size else None


def _combination_name(weights: Array, names: list[str]) -> str:
    terms = [
        f"{'+' if w > 0 else '−'}{'' if abs(abs(w) - 1) < 0.005 else f'{abs(w):.2f}·'}q{name}"
        for w, name in zip(weights, names, strict=True)
        if w
    ]
    return "".join(terms).removeprefix("+")


COLUMNS = (
    ("offset", "Offset [°]"),
    ("gain", "Gain [%]"),
    ("backlash", "Backlash [°]"),
    ("once", "Eccentricity [°]"),
    ("waves", "Waves [°]"),
    ("compliance", "Compliance [°/m]"),
    ("latency", "Latency [ms]"),
    ("drift", "Drift [°/h]"),
    ("step", "Step [°]"),
)
TABLE_NOTE = (
    "Before the slash: the smallest fault that the diagnosis would detect; after it: the smallest "
    "that it would also identify among all faults it knows, in four of five such sessions, all "
    "faults tried at once: a little more than where one offset alone is noticed. "
    "A dash: nothing shows, or it was not tried with this motion."
)
FAULT_NOTE = (
    "Eccentricity: one wave per turn, at the worst phase; tried where a joint turns more "
    "than 60°. Waves: the worst number of waves per turn among those that the range shows. "
    "Compliance: error a metre of horizontal lever, tried where the lever varies by half. Latency: "
    "readings that lag behind the other joints', tried where the speed varies. Step: an offset "
    "that changes in the middle of the session."
)


def detectable(results: Results) -> doc.Section:
    """Say what could not show, then how small a fault of each kind could have been."""
    table = results.table("detectable")
    if table.empty:
        text = "Not known: these results were made without it."
        return doc.Section(
            "detectable", "What this session can show", (doc.Paragraph(text, "note"),)
        )
    own, common = table[table["joint"].notna()], table[table["joint"].isna()]
    hidden = _hidden_sentences(own)
    blocks: tuple[doc.Block, ...] = (
        doc.Bullets(hidden)
        if hidden
        else doc.Paragraph("An offset, a gain and backlash of every joint could have shown."),
        _joint_table(own[own["kind"] != "dh"]),
        _other_table(pd.concat([common, own[own["kind"] == "dh"]])),
    )
    return doc.Section("detectable", "What this session can show", blocks)


def _hidden_sentences(own: pd.DataFrame) -> tuple[str, ...]:
    every = sorted(own["joint"].astype(int).unique().tolist())
    sentences = []
    for kind, text in (
        ("offset", "A constant offset of {joints} cannot show."),
        ("gain", "A gain of {joints} cannot show: it hardly moved, or what was fitted took it in."),
        ("backlash", "Backlash of {joints} cannot show: it moved one way only."),
    ):
        visible = (
            own[(own["kind"] == kind) & own["detectable"].notna()]["joint"].astype(int).tolist()
        )
        missing = [joint for joint in every if joint not in visible]
        if missing:
            sentences.append(text.format(joints=fmt.joint_names(missing)))
    return tuple(sentences)


def _joint_table(own: pd.DataFrame) -> doc.Table:
    faults = records(own)

    def cell_of(kind: str) -> Callable[[int], str]:
        return lambda joint: _format_cell(
            [e for e in faults if e["joint"] == joint and _column_of(e) == kind],
            {"gain": 100.0, "latency": 1e3}.get(kind, 1.0),  # in percent, in ms
        )

    columns = [
        doc.Column("Joint", "l", lambda joint: f"q{joint}"),
        *(doc.Column(head, "r", cell_of(kind)) for kind, head in COLUMNS),
    ]
    joints = sorted(own["joint"].astype(int).unique().tolist())
    title = "The smallest fault of each joint that would be detected / identified."
    return doc.tabulate(title, columns, joints, TABLE_NOTE, FAULT_NOTE)


def _column_of(entry: dict[str, Any]) -> str:
    """The column in which a fault stands."""
    if entry["kind"] == "eccentricity":
        return "once" if entry["per_turn"] == 1 else "waves"
    return str(entry["kind"])


def _format_cell(entries: list[dict[str, Any]], factor: float) -> str:
    """`detected / identified`, the worst of several."""
    known = [value for e in entries if (value := fmt.finite(e["detectable"])) is not None]
    if not known:
        return fmt.DASH
    separable = [_float_or_nan(e["separable"]) for e in entries]
    worst = math.nan if any(map(math.isnan, separable)) else factor * max(separable)
    return f"{fmt.significant(factor * max(known))} / {fmt.significant(worst)}"


def _other_table(entries: pd.DataFrame) -> doc.Table:
    columns = (
        doc.Column("Fault", "l", _fault_name),
        doc.Column("Detected", "r", doc.field("detectable", fmt.significant)),
        doc.Column("Identified", "r", doc.field("separable", fmt.significant)),
        doc.Column("Unit", "l", lambda e: fmt.lookup_label(fmt.UNITS, e["unit"])),
    )
    title = "The smallest common fault and link error that would be detected / identified."
    note = "Base and LED body: moved along or turned about one axis alone."
    return doc.tabulate(title, columns, records(entries), note)


def _fault_name(entry: dict[str, Any]) -> str:
    joint = fmt.finite(entry["joint"])
    parameter = entry["parameter"] if isinstance(entry["parameter"], str) else None
    number = None if joint is None else math.floor(joint)
    name = causes.cause_name({"kind": entry["kind"], "joint": number, "parameter": parameter})
    return f"{name}, {parameter}" if number is None and parameter is not None else name
