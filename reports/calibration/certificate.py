"""Page one of a calibration's report: what a point is worth, where that holds, what to do."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from reports.calibration.rig import (
    distance_columns,
    figure_block,
    format_distance,
    format_with_uncertainty,
    main_improvement,
    working_distance_entry,
)
from reports.document import blocks as doc
from reports.document import charts
from reports.document import formatting as fmt
from reports.results import Results

Cells = NDArray[np.bool_]
VALIDITY = (
    "Both figures hold for one LED whose centre is known to {} px in either image, in the frame "
    "of the rig. They are predicted from the fit; no independent length was measured."
)
EXACT_SQUARE = (
    "The stated size of a square, which is taken as exact: every length scales with it. Measure "
    "the printed board with a ruler."
)
FIXED_BASES = "The pan axes: the bases stood still, so all holds at these pan readings only."
LATER = (
    "What happens after the pictures were taken: a camera that is knocked shows in "
    "verify calibrate check."
)


def certificate(results: Results) -> doc.Section:
    """Say all that a reader needs who reads one page."""
    summary = results.summary
    doubts = [fmt.text_or_dash(sentence) for sentence in summary.get("doubts") or []]
    gaps = [fmt.text_or_dash(sentence) for sentence in summary.get("gaps") or []]
    limits = coverage_limits(results)
    label = "The rig is calibrated"
    if doubts or gaps:
        label += ", with doubts" if doubts else ", for part of the field"
    verdict = doc.Verdict(
        tone="undecided" if doubts or gaps else "conform",
        label=label,
        sentence=" ".join([_accuracy_text(summary), *limits]),
        remarks=(*doubts, VALIDITY.format(fmt.exact_number(summary.get("spot_px")))),
    )
    entries: list[dict[str, Any]] = summary.get("accuracy") or []
    blocks: list[doc.Block] = [
        verdict,
        doc.Facts(tuple(_identification(summary)), columns=2),
        figure_block(results, "coverage"),
    ]
    if entries:
        blocks.append(_point_table(entries))
    improvement = fmt.capitalise(main_improvement(summary))
    blocks.append(doc.remedies([*gaps, improvement], _unchecked(summary)))
    return doc.Section("verdict", "Verdict", tuple(blocks))


def _accuracy_text(summary: dict[str, Any]) -> str:
    entry = working_distance_entry(summary)
    depth, lateral = (fmt.expanded(entry.get(f"total_{part}_mm")) for part in ("depth", "lateral"))
    if depth is None or lateral is None:
        return "The accuracy of a point is not known."
    return (
        f"A point {format_distance(entry)} away is known to ±{fmt.quantity(depth, 'mm')} in depth "
        f"and ±{fmt.quantity(lateral, 'mm')} across (k = 2)."
    )


def coverage_limits(results: Results) -> list[str]:
    """Say in sentences where in the pictures, and at which distances, no board was seen."""
    bare = {side: _bare_cells(results, side) for side in ("left", "right")}
    shares = {side: float(cells.mean()) for side, cells in bare.items() if cells.size}
    sentences = []
    if any(shares.values()):
        parts = [
            f"{fmt.percent(share)} of the {side} image" for side, share in shares.items() if share
        ]
        sentences.append(  # the advice names the regions, by the corners in each
            f"No corner lies in {fmt.join_words(parts)}: the lens is extrapolated there."
        )
    elif shares:
        sentences.append("Corners lie all over both images.")
    distance = charts.column(results.table("boards"), "distance_mm")
    if np.isfinite(distance).any():
        near, far = (f"{edge / 1e3:.2f} m" for edge in (np.nanmin(distance), np.nanmax(distance)))
        sentences.append(f"No board was nearer than {near} or farther than {far}.")
    return sentences


def _bare_cells(results: Results, side: str) -> Cells:
    """The cells of an image that hold no corner, (rows, columns) of bool; empty: not known."""
    table = results.table("coverage")
    own = table[np.array(charts.texts(table, "camera")) == side]
    if not len(own):
        return np.zeros((0, 0), dtype=bool)
    counts = own.pivot_table(index="y_px", columns="x_px", values="corners")
    return np.asarray(counts.to_numpy() == 0, dtype=np.bool_)


def _identification(summary: dict[str, Any]) -> list[tuple[str, str]]:
    pairs, fit = summary.get("pairs") or {}, summary.get("reprojection") or {}
    sides = [fmt.quantity(fit.get(f"{side}_rms_px"), "px") for side in ("left", "right")]
    corners = f"{fmt.count(pairs.get('corners'))}, {fmt.count(pairs.get('refused'))} rejected"
    baseline = format_with_uncertainty(summary.get("stereo") or {}, "baseline", "mm")
    return [
        ("Pictures", fmt.text_or_dash((summary.get("source") or {}).get("path"))),
        ("Pairs used", fmt.count(pairs.get("used"))),
        ("Corners used", corners),
        ("Reprojection rms", f"{sides[0]} left, {sides[1]} right"),
        ("Baseline (k = 2)", baseline if baseline == fmt.DASH else f"{baseline} mm"),
        ("Bases", "turned between pairs" if summary.get("turning") else "fixed"),
    ]


def _point_table(entries: list[dict[str, Any]]) -> doc.Table:
    keys = {
        "Across [mm]": "total_lateral_mm",
        "In depth [mm]": "total_depth_mm",
        "Largest in the field [mm]": "worst_total_mm",
    }
    title = "U (k = 2) of one LED's position: in the middle of the field, and the largest in it."
    return doc.tabulate(title, distance_columns(keys), entries)


def _unchecked(summary: dict[str, Any]) -> list[str]:
    square = summary.get("square") or {}
    exact = square.get("stated_standard_uncertainty_mm") is None
    return [
        *([EXACT_SQUARE] if exact else []),
        *([] if summary.get("turning") else [FIXED_BASES]),
        LATER,
    ]
