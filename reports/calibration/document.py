"""What the report of a calibration from boards says, in which order."""

from functools import partial
from typing import Any

from reports.calibration.rig import (
    accuracy,
    figure_block,
    format_distance,
    improvement,
    main_improvement,
    parameters,
    stereo,
    working_distance_entry,
)
from reports.calibration.words import CalibrationNotes
from reports.check import document as check_document
from reports.document.blocks import (
    Block,
    Bullets,
    Cell,
    Column,
    Document,
    Facts,
    Paragraph,
    Section,
    Table,
    Verdict,
    described,
    field,
    lay_out,
    provenance,
    software,
    tabulate,
)
from reports.document.charts import records
from reports.document.formatting import (
    DASH,
    count,
    exact_number,
    finite,
    join_words,
    number,
    quantity,
    text_or_dash,
)
from reports.results import Results

COVERAGE_FACTOR = 2.0  # coverage factor of the figures in the headline
VALIDITY = (
    "Both hold for one LED whose centre is known to {} px in either image, in the frame of the "
    "rig, and within the field and the distances that the boards covered."
)


def document(results: Results) -> Document:
    """Lay out the whole report; that of an interim check where the results are one's."""
    summary = results.summary
    if summary.get("method") == "check":
        return check_document.document(results)
    return lay_out(
        title="Calibration of two cameras from boards",
        subtitle=described(summary, "a set of pictures"),
        footer=f"{software(summary)} · calibration",
        sections=(section(results) for section in SECTIONS),
    )


def verdict(results: Results) -> Section:
    """Open with what the calibration is worth and what to improve first."""
    summary = results.summary
    pairs, fit = summary.get("pairs") or {}, summary.get("reprojection") or {}
    source = summary.get("source") or {}
    doubts = [text_or_dash(sentence) for sentence in summary.get("doubts") or []]
    block = Verdict(
        tone="undecided" if doubts else "conform",
        label="The rig is calibrated, with doubts" if doubts else "The rig is calibrated",
        sentence=_headline(summary),
        remarks=(*doubts, VALIDITY.format(exact_number(summary.get("spot_px")))),
    )
    corners = f"{count(pairs.get('corners'))}, {count(pairs.get('refused'))} refused"
    left, right = (quantity(fit.get(f"{side}_rms_px"), "px") for side in ("left", "right"))
    facts = Facts(
        (
            ("Pictures", text_or_dash(source.get("path"))),
            ("Pairs used", count(pairs.get("used"))),
            ("Corners used", corners),
            ("Reprojection rms", f"{left} left, {right} right"),
            ("Corners' noise over what was stated", quantity(fit.get("noise_factor"), "times")),
            ("Degrees of freedom", count(fit.get("degrees_of_freedom"))),
        )
    )
    return Section("verdict", "Verdict", (block, facts))


def _headline(summary: dict[str, Any]) -> str:
    pairs, fit = summary.get("pairs") or {}, summary.get("reprojection") or {}
    entry = working_distance_entry(summary)
    sentence = (
        f"Calibrated from {count(pairs.get('used'))} pairs with an rms of "
        f"{quantity(fit.get('rms_px'), 'px')}. "
    )
    depth, lateral = (finite(entry.get(f"total_{part}_mm")) for part in ("depth", "lateral"))
    if depth is not None and lateral is not None:
        sentence += (
            f"A point {format_distance(entry)} away is known to "
            f"±{quantity(COVERAGE_FACTOR * depth, 'mm')} in depth and "
            f"±{quantity(COVERAGE_FACTOR * lateral, 'mm')} across (k = 2). "
        )
    return sentence + main_improvement(summary)


def fit(results: Results) -> Section:
    """Say how well every view fits."""
    blocks: list[Block] = []
    if len(results.table("views")):
        blocks.append(_pair_table(results))
    blocks += [figure_block(results, "views"), figure_block(results, "vectors")]
    return Section("fit", "Reprojection", tuple(blocks))


def _pair_table(results: Results) -> Table:
    views = {(r["camera"], r["frame"]): r for r in records(results.table("views"))}
    boards = {r["frame"]: r for r in records(results.table("boards"))}
    entries = [
        {**boards.get(frame, {}), "frame": frame}
        | {camera: views.get((camera, frame), {}) for camera in ("left", "right")}
        for frame in sorted({frame for _, frame in views})
    ]
    tilt = partial(number, decimals=0, signed=True)
    columns = (
        Column("Pair", "r", lambda e: str(e["frame"])),
        Column("Distance [mm]", "r", field("distance_mm", number, 0)),
        Column("Tilt, horizontal axis [°]", "r", field("about_horizontal_deg", tilt)),
        Column("Tilt, vertical axis [°]", "r", field("about_vertical_deg", tilt)),
        Column("Left corners", "r", lambda e: _corner_count(e["left"])),
        Column("Left rms [px]", "r", lambda e: number(e["left"].get("rms_px"))),
        Column("Right corners", "r", lambda e: _corner_count(e["right"])),
        Column("Right rms [px]", "r", lambda e: number(e["right"].get("rms_px"))),
        Column("Remark", "l", _view_remark, wide=True),
    )
    title = "Every pair: how the board stood, and how well its corners fit in either camera."
    return tabulate(title, columns, entries, CalibrationNotes.PAIRS)


def _corner_count(view: dict[str, Any]) -> str:
    corners, refused = count(view.get("corners")), finite(view.get("refused"))
    return f"{corners} (−{refused:.0f})" if refused else corners


def _view_remark(entry: dict[str, Any]) -> Cell:
    poor = [camera for camera in ("left", "right") if entry[camera].get("poor")]
    return Cell(f"stands out: {join_words(poor)}", "undecided") if poor else Cell("fits")


def coverage(results: Results) -> Section:
    """Show what the boards covered, and say what they did not."""
    gaps = [text_or_dash(sentence) for sentence in results.summary.get("gaps") or []]
    text: Block = Bullets(tuple(gaps), "warning") if gaps else Paragraph(CalibrationNotes.COVERED)
    figures = (figure_block(results, name) for name in ("coverage", "stances", "scene"))
    return Section("coverage", "Coverage, and what to add", (text, *figures))


def rectified_pair(results: Results) -> Section:
    """Show one pair rectified."""
    return Section("rectified", "Rectification", (figure_block(results, "rectified"),))


def conditions(results: Results) -> Section:
    """Say what the calibration was made from."""
    setup, summary = results.setup, results.summary
    board = setup.get("board") or {}
    size = setup.get("image_size_px")
    kind = "chessboard"
    if board.get("markers"):
        kind = f"ChArUco, {board['markers']}, markers of {exact_number(board.get('marker_mm'))} mm"
    size_text = f"{' × '.join(count(v) for v in size)} px" if isinstance(size, list) else DASH
    facts = Facts(
        (
            ("Board", kind),
            ("Inner corners", f"{count(board.get('columns'))} × {count(board.get('rows'))}"),
            ("Square", f"{exact_number(board.get('square_mm'))} mm"),
            ("Image size", size_text),
            ("Bases", "turned between pairs" if summary.get("turning") else "fixed"),
            ("Software", software(summary)),
        )
    )
    return Section("conditions", "Board, pictures and software", (facts, *provenance(summary)))


SECTIONS = (
    verdict,
    parameters,
    stereo,
    fit,
    coverage,
    rectified_pair,
    accuracy,
    improvement,
    conditions,
)
