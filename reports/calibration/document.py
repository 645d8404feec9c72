"""What the report of a calibration from boards says, in which order."""

from functools import partial
from typing import Any

from reports.calibration.certificate import certificate
from reports.calibration.rig import (
    accuracy,
    figure_block,
    improvement,
    parameters,
    stereo,
)
from reports.calibration.words import CalibrationNotes
from reports.check import document as check_document
from reports.document import blocks as doc
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


def document(results: Results) -> doc.Document:
    """Lay out the whole report; that of an interim check where the results are one's."""
    summary = results.summary
    if summary.get("method") == "check":
        return check_document.document(results)
    return doc.lay_out(
        title="Calibration of two cameras from boards",
        subtitle=doc.described(summary, "a set of pictures"),
        footer=f"{doc.software(summary)} · calibration",
        sections=doc.answer_and_evidence(results, certificate, EVIDENCE),
    )


def fit(results: Results) -> doc.Section:
    """Say how well every view fits."""
    blocks: list[doc.Block] = []
    if len(results.table("views")):
        blocks.append(_pair_table(results))
    blocks += [figure_block(results, "views"), figure_block(results, "vectors")]
    return doc.Section("fit", "Reprojection", tuple(blocks))


def _pair_table(results: Results) -> doc.Table:
    views = {(r["camera"], r["frame"]): r for r in records(results.table("views"))}
    boards = {r["frame"]: r for r in records(results.table("boards"))}
    entries = [
        {**boards.get(frame, {}), "frame": frame}
        | {camera: views.get((camera, frame), {}) for camera in ("left", "right")}
        for frame in sorted({frame for _, frame in views})
    ]
    tilt = partial(number, decimals=0, signed=True)
    columns = (
        doc.Column("Pair", "r", lambda e: str(e["frame"])),
        doc.Column("Distance [mm]", "r", doc.field("distance_mm", number, 0)),
        doc.Column("Tilt, horizontal axis [°]", "r", doc.field("about_horizontal_deg", tilt)),
        doc.Column("Tilt, vertical axis [°]", "r", doc.field("about_vertical_deg", tilt)),
        doc.Column("Left corners", "r", lambda e: _corner_count(e["left"])),
        doc.Column("Left rms [px]", "r", lambda e: number(e["left"].get("rms_px"))),
        doc.Column("Right corners", "r", lambda e: _corner_count(e["right"])),
        doc.Column("Right rms [px]", "r", lambda e: number(e["right"].get("rms_px"))),
        doc.Column("Remark", "l", _view_remark, wide=True),
    )
    title = "Every pair: how the board stood, and how well its corners fit in either camera."
    return doc.tabulate(title, columns, entries, CalibrationNotes.PAIRS)


def _corner_count(view: dict[str, Any]) -> str:
    corners, refused = count(view.get("corners")), finite(view.get("refused"))
    return f"{corners} (−{refused:.0f})" if refused else corners


def _view_remark(entry: dict[str, Any]) -> doc.Cell:
    poor = [camera for camera in ("left", "right") if entry[camera].get("poor")]
    return doc.Cell(f"stands out: {join_words(poor)}", "undecided") if poor else doc.Cell("fits")


def coverage(results: Results) -> doc.Section:
    """Show what the boards covered, and say what they did not."""
    gaps = [text_or_dash(sentence) for sentence in results.summary.get("gaps") or []]
    text: doc.Block = (
        doc.Bullets(tuple(gaps), "warning") if gaps else doc.Paragraph(CalibrationNotes.COVERED)
    )
    figures = (figure_block(results, name) for name in ("stances", "scene"))
    return doc.Section("coverage", "Coverage, and what to add", (text, *figures))


def rectified_pair(results: Results) -> doc.Section:
    """Show one pair rectified."""
    return doc.Section("rectified", "Rectification", (figure_block(results, "rectified"),))


def conditions(results: Results) -> doc.Section:
    """Say what the calibration was made from."""
    setup, summary = results.setup, results.summary
    board = setup.get("board") or {}
    size, fit = setup.get("image_size_px"), summary.get("reprojection") or {}
    kind = "chessboard"
    if board.get("markers"):
        kind = f"ChArUco, {board['markers']}, markers of {exact_number(board.get('marker_mm'))} mm"
    size_text = f"{' × '.join(count(v) for v in size)} px" if isinstance(size, list) else DASH
    facts = doc.Facts(
        (
            ("Board", kind),
            ("Inner corners", f"{count(board.get('columns'))} × {count(board.get('rows'))}"),
            ("Square", f"{exact_number(board.get('square_mm'))} mm"),
            ("Image size", size_text),
            ("Corners' noise over what was stated", quantity(fit.get("noise_factor"), "times")),
            ("Degrees of freedom", count(fit.get("degrees_of_freedom"))),
            ("Software", doc.software(summary)),
        )
    )
    return doc.Section(
        "conditions", "Board, pictures and software", (facts, *doc.provenance(summary))
    )


EVIDENCE = (
    coverage,
    accuracy,
    improvement,
    fit,
    rectified_pair,
    stereo,
    parameters,
    conditions,
)
