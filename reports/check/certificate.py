"""Page one of an interim check's report: whether the calibration holds, and what to do.

All three figures are in one unit, millimetres per metre: what a known length of a metre is off by,
what a point a metre away is off by, and what a point a metre from the middle of the picture is.
"""

from typing import Any

from reports.check import figures as check_figures
from reports.check.figures import per_metre
from reports.document import blocks as doc
from reports.document import formatting as fmt
from reports.results import Results

VERDICTS = {
    "held": ("conform", "The calibration holds"),
    "not_held": ("nonconform", "The calibration does not hold"),
}
FIGURE_NAMES = {
    "scale": "Scale of known lengths",
    "vertical": "Height between the images",
    "roll": "Roll between the images",
}
READINGS = {  # of a figure: what it means where it is positive, and negative
    "scale": ("lengths come out too long", "lengths come out too short"),
    "vertical": ("the right image lies too low", "the right image lies too high"),
    "roll": ("the right image is turned clockwise", "the right image is turned anticlockwise"),
}
UNSTATED = "No uncertainty is stated for {}: taken as exact, and the verdict rests on that."
UNIT = (
    "mm/m: millimetres per metre. Scale: of a known length. Height: of the distance, by how much "
    "the right camera's line of sight passes below the point. Roll: of the distance from the "
    "middle of the picture. Allowed: what noise exceeds in one check in twenty, all figures "
    "together."
)
UNSEEN = (
    "A turn or shift of both cameras together: it leaves every length as it is, and moves the "
    "robot's place in the rig. Register again where that may have happened."
)
RECALIBRATE = (
    "Do not measure with this rig. Find out which camera has moved, fix it, and calibrate again; "
    "then register the robot again."
)


def certificate(results: Results) -> doc.Section:
    """Say all that a reader needs who reads one page."""
    summary = results.summary
    tone, label = VERDICTS.get(
        str(summary.get("verdict")), ("none", "Not known whether the calibration holds")
    )
    exact = [fmt.text_or_dash(source) for source in summary.get("uncounted") or []]
    remarks = [UNSTATED.format(fmt.join_words(exact))] if exact else []
    verdict = doc.Verdict(tone, label, _verdict_text(summary), tuple(remarks))
    pairs, source = summary.get("pairs") or {}, summary.get("source") or {}
    left_out = [fmt.count(frame) for frame in pairs.get("left_out") or []]
    rms = fmt.quantity((summary.get("reprojection") or {}).get("rms_px"), "px")
    facts = (
        ("Pictures", fmt.text_or_dash(source.get("path"))),
        ("Pairs used", fmt.count(pairs.get("used"))),
        ("Pairs left out", fmt.join_words(left_out) or "none"),
        ("Reprojection rms", rms),
    )
    figure = doc.Figure(
        "figures",
        "The three figures with U (k = 2), in millimetres per metre; beyond the dotted limits the "
        "calibration does not hold.",
        "A point with an upright bar for each figure, between the two limits that are allowed.",
    )
    drawing = check_figures.figures(results)
    blocks: list[doc.Block] = [
        verdict,
        doc.Facts(facts, columns=2),
        doc.block_or_paragraph(figure, drawing, "The figures are not known."),
    ]
    if summary.get("figures"):
        blocks.append(_figure_table(summary))
    held = summary.get("verdict") == "held"
    led, beyond = summary.get("displaced_led"), _beyond(summary)
    remedy = "Measure: nothing needs to be done." if held else RECALIBRATE
    if led and not beyond:
        remedy = "Do not measure with this marker.toml: fix the LED, or measure its place again."
    elif not held and exact:
        remedy += f" If no camera has moved, check {fmt.join_words(exact)} first."
    blocks.append(doc.remedies((remedy,), _unchecked(summary)))
    return doc.Section("verdict", "Verdict", tuple(blocks))


def _tested(summary: dict[str, Any]) -> list[dict[str, Any]]:
    return [e for e in summary.get("figures") or [] if fmt.finite(e.get("z")) is not None]


def _beyond(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """The figures beyond their limit; none where that is not known."""
    limit = fmt.finite(summary.get("limit"))
    return [e for e in _tested(summary) if limit is not None and abs(e["z"]) > limit]


def _verdict_text(summary: dict[str, Any]) -> str:
    entries, beyond = _tested(summary), _beyond(summary)
    if fmt.finite(summary.get("limit")) is None or not entries:
        return "Nothing was tested."
    if (led := summary.get("displaced_led")) and not beyond:
        return fmt.text_or_dash(led)
    if not beyond:
        largest = max(entries, key=lambda entry: abs(entry["z"]))
        return (
            f"All {fmt.count(len(entries))} figures lie within what is allowed. Nearest to its "
            f"limit: {_reading(summary, largest)}."
        )
    return fmt.capitalise(
        f"{'; '.join(_reading(summary, entry) for entry in beyond)}. That is more than the "
        "uncertainty explains: calibrate again before measuring."
    )


def _reading(summary: dict[str, Any], entry: dict[str, Any]) -> str:
    """Say one figure: lengths come out too long, by 0.52 ± 0.28 mm/m (k = 2), ± 0.33 allowed."""
    value, u = per_metre(summary, entry)
    name = str(entry.get("figure"))
    high, low = READINGS.get(name, (name, name))
    if value is None:
        return high if entry["z"] > 0 else low
    amount = fmt.with_uncertainty(abs(value), fmt.expanded(u), "mm/m", signed=False)
    allowed = fmt.significant(float(summary["limit"]) * (u or 0.0))
    return f"{high if value > 0 else low}, by {amount} (k = 2), ±{allowed} mm/m allowed"


def _figure_table(summary: dict[str, Any]) -> doc.Table:
    limit = fmt.finite(summary.get("limit"))

    def value(entry: dict[str, Any]) -> str:
        figure, u = per_metre(summary, entry)
        return fmt.with_uncertainty(figure, fmt.expanded(u))

    def allowed(entry: dict[str, Any]) -> str:
        u = per_metre(summary, entry)[1]
        return fmt.DASH if u is None or limit is None else f"±{fmt.significant(limit * u)}"

    columns = (
        doc.Column("Figure", "l", lambda e: fmt.lookup_label(FIGURE_NAMES, e.get("figure"))),
        doc.Column("Value ± U [mm/m]", "r", value),
        doc.Column("Allowed [mm/m]", "r", allowed),
        doc.Column("Verdict", "l", lambda e: _figure_verdict(fmt.finite(e.get("z")), limit)),
    )
    title = "The figures, all pairs together, k = 2."
    return doc.tabulate(title, columns, summary["figures"], UNIT)


def _figure_verdict(z: float | None, limit: float | None) -> doc.Cell:
    if z is None or limit is None:
        return doc.Cell("not tested", "none")
    return doc.Cell("within", "conform") if abs(z) <= limit else doc.Cell("beyond", "nonconform")


def _unchecked(summary: dict[str, Any]) -> list[str]:
    tested = {entry.get("figure") for entry in _tested(summary)}
    missing = [name for key, name in FIGURE_NAMES.items() if key not in tested]
    nothing = f"{fmt.join_words(missing)}: the pictures do not show it." if missing else ""
    return [*([nothing] if nothing else []), UNSEEN]
